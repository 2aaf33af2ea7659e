"""One reader per file format: a path in, vertices and triangles as the file has them out.

They are our own because they keep the file's vertex numbers, refuse files that are cut off, and
take no more memory and time than the length of the file allows. Each raises a ValueError that says
what is wrong with a file.
"""
