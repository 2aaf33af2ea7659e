"""Meshes for drawing, with vertices split along sharp creases."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from abfm.mesh import TriangleMesh, per_mesh
from abfm.mesh.topology import connected, edge_slots
from abfm.types import IntArray

# angles between the normals at a flat, half-sharp or sharp edge
_FLAT_DEGREES = 1.0
_CREASE_DEGREES = 25.0
_HALF_SHARP_DEGREES = 20.0
_SHARP_DEGREES = 40.0
_FLAT_EDGES_SHARE = 0.5  # minimum share of flat edges of a mesh made of planes


@dataclass(frozen=True, eq=False)
class DrawnMesh:
    """A mesh for drawing, with one vertex for each smooth side of a crease."""

    origin: IntArray  # (D,): vertex of the mesh for each drawn vertex
    faces: IntArray  # (F, 3): faces of the mesh, with drawn vertices

    def values(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return values (V, ...) at the drawn vertices, (D, ...)."""
        return values if len(self.origin) == len(values) else values[self.origin]


@per_mesh
def drawn_mesh(mesh: TriangleMesh) -> DrawnMesh:
    """Split the vertices of a mesh along its creases.

    At a sharp edge, the normals of both faces differ by at least 40 degrees, at a half-sharp edge
    by 20 to 40 degrees. Sharp edges are creases if they outnumber half-sharp edges. Otherwise they
    are bends, as on coarse bodies and cortices. If most edges lie in planes, all edges of at least
    25 degrees are creases.
    """
    first, second = edge_slots(mesh.face_edges, len(mesh.edges)).T
    (f, c), (g, k) = (np.divmod(slots[second >= 0], 3) for slots in (first, second))
    a, b, d = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    normals = np.cross(b - a, d - a)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    cosines = (normals[f] * normals[g]).sum(axis=1)
    is_planar = (cosines > np.cos(np.radians(_FLAT_DEGREES))).mean() >= _FLAT_EDGES_SHARE
    smooth = cosines > np.cos(np.radians(_CREASE_DEGREES if is_planar else _SHARP_DEGREES))
    half_sharp = smooth & (cosines < np.cos(np.radians(_HALF_SHARP_DEGREES)))
    if smooth.all() or (not is_planar and (~smooth).sum() <= half_sharp.sum()):
        return DrawnMesh(np.arange(len(mesh.vertices)), mesh.faces)
    f, c, g, k = f[smooth], c[smooth], g[smooth], k[smooth]
    corners_of_f = np.concatenate([3 * f + (c + 1) % 3, 3 * f + (c + 2) % 3])
    corners_of_g = np.concatenate([3 * g + (k + 2) % 3, 3 * g + (k + 1) % 3])
    groups = connected(mesh.faces.size, np.stack([corners_of_f, corners_of_g], axis=1))
    _, corners, numbers = np.unique(groups, return_index=True, return_inverse=True)
    return DrawnMesh(mesh.faces.ravel()[corners], numbers.reshape(-1, 3))
