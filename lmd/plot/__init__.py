"""Figures of scenes and of optimisation runs; plotting libraries load only when a figure is drawn."""
