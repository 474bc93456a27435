"""Sweeps: each job runs in its own process; one parent run and a table cover all jobs; an interrupted sweep can
continue.
"""
