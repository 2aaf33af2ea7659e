"""Vertices that are drawn once for every smooth side of a crease: shading stays smooth, and creases sharp."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from abfm.face_flow import opposite_slots
from abfm.mesh import FloatArray, IntArray, TriangleMesh
from abfm.operators import face_normals

SHARP = 40.0
"""Angle in degrees between the normals at an edge, from which it is a crease."""


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

    def values(self, values: FloatArray) -> FloatArray:
        """Values (V, ...) of vertices for what is drawn, (D, ...)."""
        return values[self.origin]


def drawn_mesh(mesh: TriangleMesh, degrees: float = SHARP) -> DrawnMesh:
    """Split the vertices of a mesh along its creases (made once per mesh)."""
    key = (__name__, degrees)
    if key not in mesh.cache:
        mesh.cache[key] = _split(mesh, degrees)
    found: DrawnMesh = mesh.cache[key]
    return found


def _split(mesh: TriangleMesh, degrees: float) -> DrawnMesh:
    slots = opposite_slots(mesh)
    normals = face_normals(mesh)
    f, c = np.nonzero(slots >= 0)
    g, k = np.divmod(slots[f, c], 3)
    smooth = (normals[f] * normals[g]).sum(axis=1) > np.cos(np.radians(degrees))
    if smooth.all():
        return DrawnMesh(np.arange(len(mesh.vertices)), mesh.faces)
    f, c, g, k = f[smooth], c[smooth], g[smooth], k[smooth]
    here = np.concatenate([3 * f + (c + 1) % 3, 3 * f + (c + 2) % 3])
    there = np.concatenate([3 * g + (k + 2) % 3, 3 * g + (k + 1) % 3])
    count = mesh.faces.size
    joined = sparse.coo_array((np.ones(len(here)), (here, there)), shape=(count, count))
    _, groups = connected_components(joined, directed=False)
    _, first, numbers = np.unique(groups, return_index=True, return_inverse=True)
    return DrawnMesh(mesh.faces.ravel()[first], numbers.reshape(-1, 3))
