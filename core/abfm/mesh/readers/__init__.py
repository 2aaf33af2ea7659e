"""One reader per file format: a path in, vertices and triangles as the file has them out.

They are our own, but for glTF and GIFTI, because they keep the file's vertex numbers and refuse files that are cut off.
"""
