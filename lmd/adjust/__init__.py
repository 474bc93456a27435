"""Bundle adjustment: poses of tags and cameras from detected corners, for `lmd.survey` and `lmd.localise`.

Modules from the ground up:

- `sightings` converts detections to measurements; `intrinsics` makes unknowns of the cameras' intrinsics and of the
  shifts of tag edges by blur.
- `corners` computes reprojection errors, their Jacobians and noise, robust weights and losses, finds outliers, and
  refines poses with fixed tags (resection).
- `prior` holds the priors on the poses of tags, of printed sheets with several tags, and of cameras on the body
  (*mounts*). `motion` predicts the pose of a frame relative to the previous frame; `links` compares this prediction
  with the estimated poses.
- `adjustment` minimises the loss; `frames` eliminates the frames' poses, independent or linked by motion, and computes
  their covariances.
- `candidates` proposes poses from single sightings. `drive` estimates the noise of a motion model (its *spread*), and
  the smoothest sequence of poses.
- `estimate` adjusts the poses without the outliers. Covariances account for errors that are correlated in time, and are
  given in the world frame or relative to the other tags (`gauge`). `refinement` adds more unknowns: intrinsics of
  cameras, shifts of corners, and shapes and sizes of tags.
- `faults` finds tags that were moved, ids that two tags share, and wrong tag sizes.
- `tables` formats results: table rows, metrics and lines of text.
"""
