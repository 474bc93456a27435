"""Estimation of an orientation PDF from recorded orientations by the paper's Monte Carlo procedure."""
