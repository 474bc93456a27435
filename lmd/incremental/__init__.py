"""Incremental evaluation: after the move of one landmark, counts and probabilities are updated instead of recomputed.

The updated values equal recomputed values exactly.
"""
