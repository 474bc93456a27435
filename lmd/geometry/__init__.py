"""Frames, rotations, rigid motions, cameras, lenses, projection, and pose estimation from one image."""
