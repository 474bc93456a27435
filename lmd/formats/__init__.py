"""Files of other programs: camera calibrations, trajectories, tag maps, detections, rooms."""
