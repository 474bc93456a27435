"""What a deployment is worth: off the grid, against bounds, as mounted, with losses; and which of several is best."""
