"""Optimisers: each maximises a `Problem` within an exact budget."""
