"""Figures of scenes, of studies and of optimisation runs; plotting libraries are imported only when a figure is
drawn.
"""
