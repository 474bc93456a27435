"""Bundle adjustment: poses that fit corners, for a survey and for localisation.

Modules from the ground up:

- `sightings` converts detections to measurements; `intrinsics` has cameras and shifts of corners.
- `corners` has reprojection errors, their Jacobians, robust weights and losses, and resection. `noise` has the errors
  of corners beyond the detector's own, and outliers.
- Priors: `prior` of tags, `sheets` of tags that were printed together, `mounts` of cameras; `motion` between frames, by
  the constraints of `links`.
- `adjustment` minimises the loss; `frames` eliminates the frames, alone or linked, and has their covariances.
- `estimate` is an adjustment without outliers, with covariances, `gauge` free or not, and with errors that are
  correlated in time. `refinement` adds cameras, shifts of corners, shapes and sizes of tags as unknowns.
- `candidates` has poses from single sightings, `sequence` the smoothest of them. `second_places` finds tags that hang
  twice or were moved, `sizes` finds tags of another size.
"""
