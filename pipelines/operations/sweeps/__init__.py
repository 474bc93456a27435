"""Sweeps: each job in its own process, one parent run, a table, and continuation of an interrupted sweep."""
