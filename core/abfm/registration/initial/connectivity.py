"""The initial map of two surfaces with the same faces: vertex i to vertex i."""

import numpy as np

from abfm.errors import AbfmError
from abfm.maps.point_maps import PointMap
from abfm.mesh import TriangleMesh


def same_connectivity(a: TriangleMesh, b: TriangleMesh) -> PointMap:
    """Return the map that takes each vertex of B to the one of A with its number.

    Faces may stand in another order, start at another corner, or look to the other side.

    Raises
    ------
    AbfmError
        If the two have different numbers of vertices, or faces between other vertices.
    """
    why = _difference(a, b)
    if why:
        raise AbfmError(
            f"A and B do not have the same connectivity: {why}; expected the same faces between "
            "the same vertices: choose another initial map"
        )
    return PointMap.of_vertices(b, a)


def _difference(a: TriangleMesh, b: TriangleMesh) -> str:
    """Say how the connectivity differs; nothing where it does not."""
    for what in ("vertices", "faces"):
        counts = len(getattr(a, what)), len(getattr(b, what))
        if counts[0] != counts[1]:
            return f"A has {counts[0]} {what}, and B has {counts[1]}"
    of_a, of_b = np.sort(a.faces, axis=1), np.sort(b.faces, axis=1)
    known = set(map(tuple, of_a.tolist()))
    other = [face for face in map(tuple, of_b.tolist()) if face not in known]
    if not other:
        return ""
    example = ", ".join(map(str, b.vertex_ids[list(other[0])].tolist()))
    return (
        f"{len(other)} of {len(of_b)} faces of B are none of A's (for example the one between "
        f"vertices {example})"
    )
