"""One reader per file format: a path in, what the file has out, a ValueError where it is bad.

They are our own because they keep the file's vertex numbers, refuse files that are cut off, and
take no more memory and time than the length of the file allows.
"""
