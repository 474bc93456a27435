"""What a deployment is for: the value of each position, and the fitness that optimisers climb."""
