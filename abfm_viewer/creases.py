"""Vertices that are drawn once for every smooth side of a crease: shading stays smooth, and creases sharp."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from abfm.face_flow import opposite_slots
from abfm.mesh import IntArray, TriangleMesh, per_mesh
from abfm.operators import face_normals

_HALF_SHARP, _SHARP = 20.0, 40.0  # degrees between the normals at an edge


@dataclass(frozen=True, eq=False)
class DrawnMesh:
    """A mesh as it is drawn.

    Attributes
    ----------
    origin : (D,) array of int
        The mesh's vertex that each drawn vertex stands for.
    faces : (F, 3) array of int
        In the mesh's order, of drawn vertices.
    """

    origin: IntArray
    faces: IntArray

    def values(self, values: NDArray[Any]) -> NDArray[Any]:
        """Values (V, ...) of vertices for what is drawn, (D, ...): the same array where nothing is split."""
        return values if len(self.origin) == len(values) else values[self.origin]


@per_mesh
def drawn_mesh(mesh: TriangleMesh) -> DrawnMesh:
    """Split the vertices of a mesh along its creases.

    A shape has creases if more of its edges are sharp than half sharp. Where most are half sharp, as on coarse meshes
    of bodies and on folded cortices, the sharp ones are no creases but bends, and nothing is split.
    """
    slots = opposite_slots(mesh)
    normals = face_normals(mesh)
    f, c = np.nonzero(slots >= 0)
    g, k = np.divmod(slots[f, c], 3)
    cosines = (normals[f] * normals[g]).sum(axis=1)
    smooth = cosines > np.cos(np.radians(_SHARP))
    if (~smooth).sum() <= (smooth & (cosines < np.cos(np.radians(_HALF_SHARP)))).sum():
        return DrawnMesh(np.arange(len(mesh.vertices)), mesh.faces)
    f, c, g, k = f[smooth], c[smooth], g[smooth], k[smooth]
    here = np.concatenate([3 * f + (c + 1) % 3, 3 * f + (c + 2) % 3])
    there = np.concatenate([3 * g + (k + 2) % 3, 3 * g + (k + 1) % 3])
    count = mesh.faces.size
    joined = sparse.coo_array((np.ones(len(here)), (here, there)), shape=(count, count))
    _, groups = connected_components(joined, directed=False)
    _, first, numbers = np.unique(groups, return_index=True, return_inverse=True)
    return DrawnMesh(mesh.faces.ravel()[first], numbers.reshape(-1, 3))
