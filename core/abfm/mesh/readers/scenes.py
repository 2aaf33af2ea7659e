"""Formats that trimesh reads: STL, and glTF scenes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from abfm.mesh.readers.contents import FileContents, merge_by_position
from abfm.mesh.topology import FloatArray, IntArray, edges_of_faces


def read_stl(path: Path) -> FileContents:
    """Triangles of a text or binary STL file. STL repeats the corners of every triangle: they are merged."""
    return merge_by_position(*_all_triangles(path))


def read_gltf(path: Path) -> FileContents:
    """All triangles of a glTF or GLB scene, transformed as it says.

    glTF repeats a vertex wherever texture or normal are discontinuous. Where that leaves cracks, vertices at the same
    position are merged.
    """
    vertices, faces, _ = split = FileContents(*_all_triangles(path))
    merged = merge_by_position(vertices, faces)
    return merged if _boundary_length(merged) < _boundary_length(split) else split


def _all_triangles(path: Path) -> tuple[FloatArray, IntArray]:
    import trimesh  # takes longer to import than all of this package

    mesh = trimesh.load_mesh(path, process=False)
    return np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64)


def _boundary_length(contents: FileContents) -> int:
    """Number of edges with a single face."""
    edges, face_edges = edges_of_faces(contents.faces, len(contents.vertices))
    return int(np.sum(np.bincount(face_edges.ravel(), minlength=len(edges)) == 1))
