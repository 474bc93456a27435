"""Foundations: checks of input, files, tables, memory, threads, and compilation with numba."""
