"""What leaves the house: tag maps for localisation stacks, and what has to be printed and mounted."""
