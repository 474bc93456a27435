"""Detectors of fiducial tags, calibration of their limits, and comparison of predictions with detections."""
