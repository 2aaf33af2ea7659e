"""Readers of mesh files, one for each format; they raise a ValueError for invalid files.

The readers preserve the vertex numbers of the file, refuse truncated files, and limit memory and
time by the size of the file. Other libraries do not.
"""
