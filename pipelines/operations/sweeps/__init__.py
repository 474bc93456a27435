"""Sweeps: each job in a process of its own, one parent run, a table, and continuation of an interrupted sweep."""
