"""Command-line entry points: thin Hydra applications over `lmd`."""
