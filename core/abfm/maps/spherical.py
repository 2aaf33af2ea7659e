"""Maps between surfaces through a sphere that both are laid out on: exact inside faces, both ways.

A layout of a surface is a unit vector for each of its vertices; a point of a face lies in the
direction of the same combination of its corners' vectors (central projection).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from abfm.errors import AbfmError
from abfm.maps.point_maps import PointMap
from abfm.maps.surface_points import (
    ClosestPoints,
    SurfacePoints,
    cross,
    finite_points,
    scalar,
    vertex_points,
)
from abfm.mesh import TriangleMesh, per_mesh
from abfm.numerics.kernels import unfused_kernel
from abfm.types import FloatArray, IndexArray, IntArray
from abfm.workers.control import checkpoint

ROUNDNESS = 0.02  # of the radius: how far from a sphere its vertices may lie
_VOLUME_ROUNDING = -1e-14  # of a volume: rounding on the side of a face
# between a direction and the point that was found in it: more is in no face
_DIRECTION_ROUNDING = 1e-9
_COVERAGE_MIN = 0.25  # of the sphere, by a surface with holes
_ROUNDING = 1e-14  # of unit vectors
_CHUNK = 8192  # points between checkpoints


def sphere_directions(mesh: TriangleMesh) -> FloatArray:
    """Return the unit vectors (V, 3) of a mesh that is a sphere, from its centre.

    Raises
    ------
    AbfmError
        If the vertices are not on a sphere, to within 2% of its radius, or do not surround it.
    """
    directions = _directions(mesh)
    if isinstance(directions, str):
        raise AbfmError(directions)
    return directions.copy()  # the mesh keeps its own


def is_sphere(mesh: TriangleMesh) -> bool:
    """Tell whether the vertices of a mesh lie on a sphere around which its faces go once."""
    return not isinstance(_directions(mesh), str)


@per_mesh
def _directions(mesh: TriangleMesh) -> FloatArray | str:
    """Return the unit vectors, or why there are none."""
    x = mesh.vertices / mesh.length_scale
    rows = np.column_stack([2 * x, np.ones(len(x))])
    found = np.linalg.lstsq(rows, (x**2).sum(axis=1), rcond=None)[0]
    # a sphere around the origin, as neuroimaging has them, is not moved by its last digits
    centre = found[:3] if np.linalg.norm(found[:3]) > 1e-3 else np.zeros(3)
    offsets = x - centre
    radii = np.linalg.norm(offsets, axis=1)
    off = float(np.abs(radii / radii.mean() - 1).max())
    if not off <= ROUNDNESS:
        return (
            f"the mesh is no sphere: its vertices are up to {100 * off:.2g}% nearer to a centre or "
            f"farther than the mean, and {100 * ROUNDNESS:g}% are allowed; give a spherical mesh"
        )
    directions: FloatArray = offsets / radii[:, None]
    solid = float(solid_angles(directions[mesh.faces]).sum())
    turns = abs(solid) / (4 * np.pi)
    if not abs(turns - 1) < ROUNDNESS:
        return f"the mesh goes {turns:.3g} times around its centre; expected a whole sphere, once"
    return directions


def solid_angles(corners: FloatArray) -> FloatArray:
    """Return signed solid angles (F,) of triangles of unit vectors (F, 3, 3) [Van Oosterom,
    Strackee 1983].
    """
    a, b, c = (corners[:, k] for k in range(3))
    volume = (a * np.cross(b, c)).sum(axis=1)
    sides = 1 + (a * b).sum(axis=1) + (b * c).sum(axis=1) + (c * a).sum(axis=1)
    return np.asarray(2 * np.arctan2(volume, sides))


class Faces(NamedTuple):
    """A layout as kernels take it; a mirrored one has the sign -1."""

    corners: IntArray  # (F, 3)
    neighbours: IntArray  # (F, 3), `TriangleMesh.opposite_slots`
    directions: FloatArray  # (V, 3)
    sign: float


class SphereLayout:
    """A surface laid out on the unit sphere.

    Parameters
    ----------
    mesh : TriangleMesh
    directions : (V, 3) array
        Where its vertices lie, not zero; brought to length 1. A mirrored layout is allowed, and one
        with holes where the surface has them.

    Raises
    ------
    AbfmError
        If the directions do not fit the mesh or do not go around the sphere once.
    """

    def __init__(self, mesh: TriangleMesh, directions: ArrayLike) -> None:
        given = finite_points(directions)
        if len(given) != len(mesh.vertices):
            raise AbfmError(
                f"the sphere has {len(given)} vertices, and the surface {len(mesh.vertices)}: give "
                "a sphere with the surface's own vertices"
            )
        lengths = np.linalg.norm(given, axis=1)
        if not lengths.min() > 0:
            raise AbfmError("a vertex lies in the middle of the sphere: give unit vectors")
        lengths[np.abs(lengths - 1) < _ROUNDING] = 1  # so that files give the same bits again
        self.mesh, self.directions = mesh, given / lengths[:, None]
        angles = solid_angles(self.directions[mesh.faces])
        turns = angles.sum() / (4 * np.pi)
        least = _COVERAGE_MIN if mesh.is_boundary_vertex.any() else 1 - ROUNDNESS
        if not least < abs(turns) < 1 + ROUNDNESS:
            raise AbfmError(
                f"the layout goes {turns:.3g} times around the sphere; expected once: give a "
                "spherical mesh with the surface's faces"
            )
        self.sign = 1.0 if turns > 0 else -1.0
        """-1 for a mirrored layout."""
        self.folded: IntArray = np.flatnonzero(self.sign * angles <= 0)
        """Faces that lie the wrong way round, by number."""
        self._tree = KDTree(self.directions)
        self._first = vertex_points(mesh).faces

    def directions_of(self, points: SurfacePoints) -> FloatArray:
        """Return where points of the surface lie on the sphere, unit vectors (P, 3)."""
        corners = self.directions[self.mesh.faces[points.faces]]
        places = np.einsum("pc,pcx->px", points.barycentric, corners)
        return np.asarray(places / np.linalg.norm(places, axis=1)[:, None])

    def locate(self, directions: ArrayLike) -> SurfacePoints:
        """Return the points of the surface that lie in given directions (P, 3): the inverse of
        `directions_of`, but where faces lie the wrong way round. In a hole it is the closest point
        of the layout, which is on a boundary.
        """
        given = finite_points(directions)
        given = given / np.linalg.norm(given, axis=1)[:, None]
        faces = np.empty(len(given), dtype=np.int64)
        weights = np.empty((len(given), 3))
        own = Faces(self.mesh.faces, self.mesh.opposite_slots, self.directions, self.sign)
        for begin in range(0, len(given), _CHUNK):
            checkpoint()
            chunk = slice(begin, begin + _CHUNK)
            faces[chunk] = self._first[self._tree.query(given[chunk])[1]]
            walk(own, given[chunk], faces[chunk], weights[chunk])
        found = SurfacePoints(self.mesh, faces, weights)
        outside = np.linalg.norm(self.directions_of(found) - given, axis=1) > _DIRECTION_ROUNDING
        if not outside.any():
            return found
        near = ClosestPoints(self.mesh, self.directions).to(given[outside])
        faces[outside], weights[outside] = near.faces, near.barycentric
        return SurfacePoints(self.mesh, faces, weights)


def through_sphere(domain: SphereLayout, codomain: SphereLayout) -> PointMap:
    """Return the map that takes each point to the one in the same direction."""

    def carried(points: SurfacePoints) -> SurfacePoints:
        return codomain.locate(domain.directions_of(points))

    return PointMap.of_points(domain.mesh, codomain.locate(domain.directions), carried)


@unfused_kernel
def walk(own: Faces, points: FloatArray, faces: IndexArray, weights: FloatArray) -> None:
    """Find the faces (P,), given a first guess, and weights (P, 3) of directions (P, 3): from face
    to face over the side that the point is farthest behind; by all faces where that goes astray.
    """
    corners = own.corners
    volumes, best = np.empty(3), np.empty(3)
    limit = 100 + 4 * int(np.sqrt(corners.shape[0]))
    for p in range(faces.size):
        f, found = faces[p], False
        for _ in range(limit):
            side_volumes(own, points[p], f, volumes)
            c = volumes.argmin()
            if volumes[c] >= _VOLUME_ROUNDING:
                found = volumes.sum() > 0.0
                break
            slot = own.neighbours[f, c]
            if slot < 0:
                break
            f = slot // 3
        if not found:
            least = -np.inf
            for g in range(corners.shape[0]):
                side_volumes(own, points[p], g, volumes)
                total = volumes.sum()
                if total > 0.0 and volumes.min() / total > least:
                    least = volumes.min() / total
                    f = g
                    best[:] = volumes
            volumes[:] = best
        faces[p] = f
        total = 0.0
        for k in range(3):
            weights[p, k] = max(volumes[k], 0.0)
            total += weights[p, k]
        for k in range(3):
            weights[p, k] /= total


@unfused_kernel
def side_volumes(own: Faces, point: FloatArray, face: int, volumes: FloatArray) -> None:
    """Write the volumes (3,) that a point spans with each side of a face, of either sign: they are
    its barycentric weights, up to their sum.
    """
    for k in range(3):
        i, j = own.corners[face, (k + 1) % 3], own.corners[face, (k + 2) % 3]
        volumes[k] = own.sign * scalar(point, cross(own.directions[i], own.directions[j]))
