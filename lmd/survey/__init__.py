"""Survey: a map of tags from their detections in images, by bundle adjustment (`lmd.adjust`).

Modules in the order of a survey, each with its result:

- `survey` calls all steps in order; its `Survey` is the result.
- `keyframes` selects the frames of a video; `knowledge` collects what the user knows: plan, fixed tags, points, boards,
  odometry.
- `initialisation` finds rough poses of tags and frames, group by group.
- `turns` finds tags that hang rotated by quarter turns, and detections whose corners are in another order.
- `groups` joins groups that no image connects, by the motion between frames.
- `gauge` moves all poses into one world frame.
- `faults` finds tags that were moved, hang twice, or have a wrong size or id; `held_out` localises frames by a map from
  the others.
- `results` makes tables and files, `terminal` makes text.
"""
