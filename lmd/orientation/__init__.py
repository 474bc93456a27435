"""Estimation of the probabilities of a camera's orientations from a recording, by the paper's Monte Carlo procedure."""
