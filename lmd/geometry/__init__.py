"""Frames, rotations and rigid motions."""
