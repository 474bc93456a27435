"""Localisation of recorded images in a map of tags, and changes of the map: a survey whose prior is the map.

Modules in the order of a localisation, each with its result:

- `localise` calls all steps in order; its `Localisation` is the result.
- `fixed_map` has the map: poses of the tags, with standard deviations.
- `images` finds rough poses of single images, and the reasons why images are refused.
- `changes` estimates all poses with the map as the prior (`lmd.adjust`), without tags that were moved, and finds new
  tags and tags that are gone.
- `results` makes tables and text.
"""
