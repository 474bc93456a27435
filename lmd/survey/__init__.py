"""A survey: a map of tags from detections of them, by bundle adjustment.

Modules in the order of a survey, each with its result:

- `survey` calls all steps in order; its `Survey` is the result.
- `keyframes` selects the frames of a video; `sightings` converts detections to measurements of bundle adjustment.
- `prior` collects what the user knows: plan, fixed tags, points, odometry; `boards` are tags on printed sheets.
- `initialisation` finds rough poses of tags and frames, group by group, from `single_poses` by one sighting each.
- `turns` finds tags that hang turned, and corners in another order.
- `groups` joins groups that no image connects, by the `motion` between frames, whose constraints are `links`.
- `gauge` moves all poses into one world frame, and removes the choice of that frame from covariances.
- `residuals` has reprojection errors, Jacobians and robust weights; `schur` the normal equations without frames;
  `adjustment` minimises the robust loss; `linked` does so for frames that motion links.
- `map_estimate` is the map with covariances and outliers. `nuisances` refines it with `intrinsics`, shifts of corners,
  and shapes of tags; `resampling` finds errors that are alike in time, and localises held-out frames.
- `faults` finds tags that were moved, hang twice, or have a wrong size or id.
- `next_photographs` proposes further photographs; `results` has tables and files, `terminal` text; `audit` compares
  detections with a visibility model.
"""
