"""What a problem is about: cameras and rigs, how they move and look, tags and where they hang, what counts as seen."""
