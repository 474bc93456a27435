"""What has nothing to do with tags: checks of input, files, tables, memory, threads, and how numba compiles."""
