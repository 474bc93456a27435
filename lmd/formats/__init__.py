"""Readers and writers of other programs' files: camera calibrations, trajectories, tag maps, detections, rooms."""
