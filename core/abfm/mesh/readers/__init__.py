"""One reader per file format: a path in, vertices and triangles as the file has them out."""
