"""Survey: a map of tags from their detections in images, by bundle adjustment (`lmd.adjust`).

Modules in the order of a survey:

- `survey` calls all steps in order; its `Survey` is the result.
- `keyframes` selects the frames of a video. `knowledge` holds the prior knowledge of the user: plan, fixed tags,
  measured points, printed boards, odometry.
- `start` finds rough poses of tags and frames, group by group; `groups` joins groups that no image connects, by the
  motion between frames.
- `world` moves all poses into one world frame, and compares tags with their prior poses, to find tags that hang rotated
  by quarter turns.
- `results` formats tables, files and text.
"""
