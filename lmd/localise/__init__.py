"""Localisation of recorded images in a map of tags, and changes of the map: a survey with the map as its prior.

Modules in the order of a localisation:

- `localise` calls all steps in order; its `Localisation` is the result.
- `fixed_map` reads the map: poses of the tags, with standard deviations.
- `images` finds rough poses of single images, or reasons to refuse images.
- `changes` estimates all poses with the map as the prior (`lmd.adjust`), and finds new tags and moved tags, which lose
  their prior.
- `results` formats tables and text.
"""
