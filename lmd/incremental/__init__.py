"""Incremental evaluation: after the move of one landmark, only the affected counts and probabilities are updated.

The updated values equal recomputed values exactly.
"""
