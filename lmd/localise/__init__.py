"""Localisation of recorded images in a map of tags, and changes of the map: a survey whose map is fixed.

Modules in the order of a localisation, each with its result:

- `localise` calls all steps in order; its `Localisation` is the result.
- `fixed_map` has the map: poses of the tags, with standard deviations.
- `image_poses` finds the pose of each image by itself, with its covariance, or the reason why it is refused;
  `image_noise` has the noise of its sightings, and `pose_errors` the covariance of its pose.
- `refined_optics` refines cameras by the drive, as a survey whose plan is the map.
- `smoothing` estimates all poses of a drive together, by the motion between its frames (`lmd.survey.motion`).
- `changes` finds tags that were moved since the map was made, and new ones, by their `displacement`; `vanished` tags
  that are gone.
- `results` makes tables and text.
"""
