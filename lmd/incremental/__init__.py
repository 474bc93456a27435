"""Incremental evaluation: after the move of one landmark, counts and probabilities are updated instead of recomputed,
and equal the recomputed ones exactly.
"""
