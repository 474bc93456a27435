"""Frames, rotations, rigid motions and lens distortion."""
