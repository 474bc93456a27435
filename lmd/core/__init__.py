"""Foundations without tags: checks of input, files, tables, memory, threads, and compiling with numba."""
