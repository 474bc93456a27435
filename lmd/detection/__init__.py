"""Detectors of fiducial tags, what they need of an image, and how well a prediction of it holds."""
