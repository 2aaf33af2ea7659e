"""Vertices that are drawn once for every smooth side of a crease, which stays sharp."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from abfm.mesh import TriangleMesh, per_mesh
from abfm.mesh.topology import connected, edge_slots
from abfm.types import IntArray

# degrees between the normals at an edge
_FLAT, _CREASED, _HALF_SHARP, _SHARP = 1.0, 25.0, 20.0, 40.0
_MOST = 0.5  # of the edges


@dataclass(frozen=True, eq=False)
class DrawnMesh:
    """A mesh as it is drawn."""

    origin: IntArray  # (D,): the mesh's vertex that each drawn vertex stands for
    faces: IntArray  # (F, 3): in the mesh's order, of drawn vertices

    def values(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return values (V, ...) of vertices as (D, ...); the same array if nothing is split."""
        return values if len(self.origin) == len(values) else values[self.origin]


@per_mesh
def drawn_mesh(mesh: TriangleMesh) -> DrawnMesh:
    """Split the vertices of a mesh along its creases.

    A shape has creases if more of its edges are sharp than half sharp. Where most are half sharp,
    as on coarse meshes of bodies and on folded cortices, the sharp ones are no creases but bends,
    and nothing is split. Where most edges lie in planes, as on mechanical parts, the half sharp
    ones are creases, too.
    """
    first, second = edge_slots(mesh.face_edges, len(mesh.edges)).T
    (f, c), (g, k) = (np.divmod(slots[second >= 0], 3) for slots in (first, second))
    a, b, d = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    normals = np.cross(b - a, d - a)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    cosines = (normals[f] * normals[g]).sum(axis=1)
    of_planes = (cosines > np.cos(np.radians(_FLAT))).mean() >= _MOST
    smooth = cosines > np.cos(np.radians(_CREASED if of_planes else _SHARP))
    bends = (
        not of_planes
        and (~smooth).sum() <= (smooth & (cosines < np.cos(np.radians(_HALF_SHARP)))).sum()
    )
    if bends or smooth.all():
        return DrawnMesh(np.arange(len(mesh.vertices)), mesh.faces)
    f, c, g, k = f[smooth], c[smooth], g[smooth], k[smooth]
    here = np.concatenate([3 * f + (c + 1) % 3, 3 * f + (c + 2) % 3])
    there = np.concatenate([3 * g + (k + 2) % 3, 3 * g + (k + 1) % 3])
    groups = connected(mesh.faces.size, np.stack([here, there], axis=1))
    _, corners, numbers = np.unique(groups, return_index=True, return_inverse=True)
    return DrawnMesh(mesh.faces.ravel()[corners], numbers.reshape(-1, 3))
