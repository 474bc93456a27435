"""Synthetic images of rooms with tags, and the exact projection they are checked against."""
