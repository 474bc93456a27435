"""Comparison of the paper's tables and figures with the results of the stored sweeps."""
