"""Optimisers: each maximises a `CoverageProblem` within an exact budget."""
