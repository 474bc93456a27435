"""Synthetic images of rooms with tags."""
