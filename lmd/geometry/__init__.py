"""Frames, rotations, rigid motions and lenses."""
