"""Frames, rotations, rigid motions, cameras, lenses, projection, and the pose from one image."""
