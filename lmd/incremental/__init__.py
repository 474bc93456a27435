"""Moving one landmark at a time: exact counts and probabilities, updated instead of recomputed."""
