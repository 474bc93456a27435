"""Bundle adjustment: poses that fit corners, for a survey and for localisation.

Modules from the ground up:

- `sightings` converts detections to measurements; `intrinsics` has cameras and shifts of corners.
- `corners` has reprojection errors, their Jacobians, noise, outliers, robust weights and losses, and resection.
- `prior` has priors of tags, of sheets with several tags and of mounts; `motion` links frames.
- `adjustment` minimises the loss; `frames` eliminates the frames, alone or linked, and has their covariances.
- `candidates` has poses from single sightings. `drive` estimates the spread of a motion, and finds the smoothest poses.
- `estimate` is an adjustment without outliers, with covariances, free of the `gauge` or not, and with errors that are
  correlated in time. `refinement` adds cameras, shifts of corners, shapes and sizes of tags as unknowns.
- `faults` finds tags that hang twice, that were moved, or that have another size.
- `tables` has rows, figures and lines of text.
"""
