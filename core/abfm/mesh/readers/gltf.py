"""glTF scenes, as text (.gltf, with its buffers beside it) and binary (.glb)."""

import json
from pathlib import Path

import numpy as np

from abfm.mesh.readers.contents import FileContents, merge_by_position
from abfm.mesh.topology import edges_of_faces


def read_gltf(path: Path) -> FileContents:
    """All triangles of a scene, transformed as it says.

    glTF repeats a vertex wherever texture or normal are discontinuous. Where that leaves cracks, vertices at the same
    position are merged.

    Raises
    ------
    ValueError
        If a text file is not JSON; trimesh may raise anything else.
    """
    import trimesh  # takes longer to import than all of this package

    if path.suffix.lower() == ".gltf":
        json.loads(path.read_bytes())  # trimesh would blame a missing file
    scene = trimesh.load_mesh(path, process=False)
    split = FileContents(np.asarray(scene.vertices, dtype=np.float64), np.asarray(scene.faces, dtype=np.int64))
    merged = merge_by_position(split.vertices, split.faces)
    return merged if _boundary_length(merged) < _boundary_length(split) else split


def _boundary_length(contents: FileContents) -> int:
    """Number of edges with a single face."""
    _, face_edges = edges_of_faces(contents.faces, len(contents.vertices))
    return int(np.sum(np.bincount(face_edges.ravel()) == 1))
