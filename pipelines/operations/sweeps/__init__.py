"""Sweeps. Each job of a sweep runs in its own process; one tracked parent run and one table cover all jobs; an
interrupted sweep can be continued.
"""
