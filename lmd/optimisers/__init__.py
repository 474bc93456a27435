"""Optimisers: each one maximises the fitness of a `Problem` with an exact budget of evaluations or time."""
