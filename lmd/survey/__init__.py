"""Where tags hang, from photographs of them: bundle adjustment, what is wrong, and how good the map is."""
