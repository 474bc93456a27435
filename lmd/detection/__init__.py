"""Detectors of fiducial tags, calibration of a detector's limits, and comparison of predicted and actual detections."""
