"""Initial map between meshes with the same connectivity: vertex i to vertex i."""

import numpy as np

from abfm.errors import AbfmError
from abfm.maps.point_maps import PointMap
from abfm.mesh import TriangleMesh


def same_connectivity(a: TriangleMesh, b: TriangleMesh) -> PointMap:
    """Return the map that takes each vertex of B to the vertex of A with the same number.

    Both meshes must have the same faces. Their order, first corners and orientation may differ.
    Raises AbfmError if the numbers of vertices differ, or a face connects other vertices.
    """
    difference = _difference(a, b)
    if difference:
        raise AbfmError(
            f"A and B do not have the same connectivity: {difference}; expected the same faces "
            "between the same vertices. Choose another initial map"
        )
    return PointMap.of_vertices(b, a)


def _difference(a: TriangleMesh, b: TriangleMesh) -> str:
    for name in ("vertices", "faces"):
        counts = len(getattr(a, name)), len(getattr(b, name))
        if counts[0] != counts[1]:
            return f"A has {counts[0]} {name}, and B has {counts[1]}"
    of_a, of_b = np.sort(a.faces, axis=1), np.sort(b.faces, axis=1)
    faces_of_a = set(map(tuple, of_a.tolist()))
    other = [face for face in map(tuple, of_b.tolist()) if face not in faces_of_a]
    if not other:
        return ""
    example = ", ".join(map(str, b.vertex_ids[list(other[0])].tolist()))
    return (
        f"{len(other)} of {len(of_b)} faces of B are not faces of A (for example the face with "
        f"vertices {example})"
    )
