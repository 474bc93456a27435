"""Bundle adjustment: poses that fit corners, for a survey and for localisation.

Modules from the ground up:

- `sightings` converts detections to measurements; `intrinsics` has cameras and shifts of corners.
- `corners` has reprojection errors, their Jacobians, noise, outliers, robust weights and losses, and resection.
- `prior` has priors of tags, of sheets with several tags and of mounts; `motion` links frames.
- `adjustment` minimises the loss; `frames` eliminates the frames, alone or linked, and has their covariances.
- `candidates` has poses from single sightings. `drive` estimates the spread of a motion, and the smoothest poses.
- `estimate` adjusts without outliers, and has covariances: with or without the `gauge`, and for errors that are
  correlated in time. `refinement` adds cameras, shifts of corners, shapes and sizes of tags as unknowns.
- `faults` finds tags that were moved, ids of two tags, and wrong sizes.
- `tables` formats results: table rows, figures and lines of text.
"""
