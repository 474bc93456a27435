"""Rooms: the surfaces that carry landmarks, and where the camera may be."""
