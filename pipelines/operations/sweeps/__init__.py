"""Sweeps: several jobs, each in its own process, with one tracked parent run and one table for all jobs.

An interrupted sweep can be continued.
"""
