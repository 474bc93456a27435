"""Sweeps: each job in a process of its own, one parent run, a table, and going on where one was cut short."""
