"""Figures of scenes, of studies and of optimisation runs.

Plotting libraries are imported only when a figure is drawn.
"""
