"""Figures of scenes and of optimisation runs; plotting libraries are imported only when a figure is drawn."""
