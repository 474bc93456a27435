"""Survey: a map of tags from their detections in images, by bundle adjustment.

Modules in the order of a survey, each with its result:

- `survey` calls all steps in order; its `Survey` is the result.
- `keyframes` selects the frames of a video; `sightings` converts detections to measurements of bundle adjustment.
- `prior` collects what the user knows: plan, fixed tags, points, odometry; `boards` are tags on printed sheets.
- `initialisation` finds rough poses of tags and frames, group by group, from the `single_poses` of a tag in one image.
- `turns` finds tags that hang rotated by quarter turns, and detections whose corners are in another order.
- `groups` joins groups that no image connects, by the `motion` between frames; `links` are the constraints by motion.
- `gauge` moves all poses into one world frame, and removes the choice of that frame from covariances.
- `residuals` has reprojection errors, Jacobians and robust weights, and `schur` has the normal equations from which
  frames are eliminated. `adjustment` minimises the robust loss; `linked_adjustment` does so for frames that motion
  links, by a `chain`, the factor of a band matrix.
- `map_estimate` is the map with covariances and outliers. `nuisances` refines the map together with `intrinsics`,
  shifts of corners and shapes of tags. `resampling` finds errors that are correlated in time, and localises held-out
  frames.
- `faults` finds tags that were moved, hang twice, or have a wrong size or id.
- `results` makes tables and files, `terminal` makes text; `audit` compares detections with a visibility model.
"""
