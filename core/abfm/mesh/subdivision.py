"""Midpoint subdivision: every face cut into four like it, on the same surface."""

import numpy as np
from numpy.typing import ArrayLike

from abfm.errors import MeshError
from abfm.mesh.triangle_mesh import TriangleMesh
from abfm.types import FloatArray


def subdivided(mesh: TriangleMesh) -> TriangleMesh:
    """Return the mesh with a vertex in the middle of every edge: V + E vertices, 4 F faces.

    The vertices stay, and edge e gets vertex ``V + e``. Face f becomes the faces ``4 f`` to
    ``4 f + 3``: those at its corners 0, 1 and 2, each with this corner in its place, and the middle
    one, whose corner c lies opposite the corner c of f. MeshError if parts have no area.
    """
    middles = mesh.face_edges + len(mesh.vertices)
    children = np.repeat(middles[:, None], 4, axis=1)
    for c in range(3):
        children[:, c, c] = mesh.faces[:, c]
        children[:, c, (c + 1) % 3] = middles[:, (c + 2) % 3]
        children[:, c, (c + 2) % 3] = middles[:, (c + 1) % 3]
    return TriangleMesh(interpolated(mesh, mesh.vertices), children.reshape(-1, 3))


def interpolated(mesh: TriangleMesh, values: ArrayLike) -> FloatArray:
    """Return a vertex function (V, ...) on the vertices of the subdivided mesh, (V + E, ...)."""
    given = np.asarray(values, dtype=np.float64)
    start, end = mesh.edges.T
    return np.concatenate([given, given[start] / 2 + given[end] / 2])


def times_subdivided(faces: int, mesh: TriangleMesh) -> int:
    """Return k for the faces of the mesh subdivided k times, 4^k of its own; MeshError if other."""
    k = max(faces // len(mesh.faces), 1).bit_length() // 2
    if faces != 4**k * len(mesh.faces):
        raise MeshError(
            f"{faces} faces; expected those of the mesh, {len(mesh.faces)}, or of its midpoint "
            f"subdivision, {4 * len(mesh.faces)}, {16 * len(mesh.faces)}, ..."
        )
    return k
