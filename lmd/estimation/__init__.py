"""Localisation with the landmarks a camera sees: trajectories, measurements, the observer and its rivals."""
