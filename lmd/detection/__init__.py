"""Detectors of fiducial tags, calibration of the detectors' limits, and comparison of predictions with detections."""
