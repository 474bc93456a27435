"""Incremental evaluation of moves of one landmark at a time: counts and probabilities are exact, but updated instead of
recomputed.
"""
