"""Maps between surfaces that are laid out on the same sphere.

A layout of a surface is a unit vector for each of its vertices. A point of a face lies in the
direction of the same combination of its corners' vectors (central projection). The maps are exact
inside faces in both directions.
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

ROUNDNESS = 0.02  # tolerance for spheres, relative to the radius
_VOLUME_ROUNDING = -1e-14  # smallest volume for a point on a side of a face
# if the direction of the closest point differs by more, a point is outside all faces
_DIRECTION_ROUNDING = 1e-9
_COVERAGE_MIN = 0.25  # smallest share of the sphere that a surface with holes may cover
_ROUNDING = 1e-14  # rounding errors of the lengths of unit vectors
_CHUNK = 8192  # number of points between two checks whether the task is paused or cancelled


def sphere_directions(mesh: TriangleMesh) -> FloatArray:
    """Return the unit vectors (V, 3) from the centre of a spherical mesh to its vertices.

    Raises an AbfmError if distances of the vertices from the centre differ by more than 2% from
    their mean. It is also raised if the faces do not cover the sphere once.
    """
    directions = _directions(mesh)
    if isinstance(directions, str):
        raise AbfmError(directions)
    return directions.copy()  # the original is cached with the mesh


def is_sphere(mesh: TriangleMesh) -> bool:
    """Return whether the vertices of a mesh lie on a sphere that its faces cover once."""
    return not isinstance(_directions(mesh), str)


@per_mesh
def _directions(mesh: TriangleMesh) -> FloatArray | str:
    x = mesh.vertices / mesh.length_scale
    rows = np.column_stack([2 * x, np.ones(len(x))])
    found = np.linalg.lstsq(rows, (x**2).sum(axis=1), rcond=None)[0]
    # spheres in neuroimaging are centred at the origin; rounding in the fit must not move them
    centre = found[:3] if np.linalg.norm(found[:3]) > 1e-3 else np.zeros(3)
    offsets = x - centre
    radii = np.linalg.norm(offsets, axis=1)
    off = float(np.abs(radii / radii.mean() - 1).max())
    if not off <= ROUNDNESS:
        return (
            f"the mesh is not a sphere: distances of its vertices from the centre differ by up to "
            f"{100 * off:.2g}% from the mean; expected at most {100 * ROUNDNESS:g}%. Use a "
            "spherical mesh"
        )
    directions: FloatArray = offsets / radii[:, None]
    solid = float(solid_angles(directions[mesh.faces]).sum())
    turns = abs(solid) / (4 * np.pi)
    if not abs(turns - 1) < ROUNDNESS:
        return (
            f"the mesh covers the sphere around its centre {turns:.3g} times; expected a complete "
            "sphere, covered once"
        )
    return directions


def solid_angles(corners: FloatArray) -> FloatArray:
    """Return the signed solid angles (F,) of triangles of unit vectors (F, 3, 3).

    The formula is that of [Van Oosterom, Strackee 1983].
    """
    a, b, c = (corners[:, k] for k in range(3))
    volume = (a * np.cross(b, c)).sum(axis=1)
    sides = 1 + (a * b).sum(axis=1) + (b * c).sum(axis=1) + (c * a).sum(axis=1)
    return np.asarray(2 * np.arctan2(volume, sides))


class Faces(NamedTuple):
    """The arrays of a `SphereLayout`, for compiled functions."""

    corners: IntArray  # (F, 3)
    neighbours: IntArray  # (F, 3), the mesh's ``opposite_slots``
    directions: FloatArray  # (V, 3)
    sign: float  # 1, or -1 for a mirrored layout


class SphereLayout:
    """A surface laid out on the unit sphere: a direction for each vertex.

    The directions (V, 3) are scaled to length 1. The layout may be mirrored, and may have holes if
    the surface has holes. Raises an AbfmError if the directions do not fit the mesh, are zero, or
    do not go around the sphere once.
    """

    def __init__(self, mesh: TriangleMesh, directions: ArrayLike) -> None:
        given = finite_points(directions)
        if len(given) != len(mesh.vertices):
            raise AbfmError(
                f"the sphere has {len(given)} vertices, but the surface has {len(mesh.vertices)}. "
                "Use the sphere that belongs to this surface"
            )
        lengths = np.linalg.norm(given, axis=1)
        if not lengths.min() > 0:
            raise AbfmError("a vertex lies at the centre of the sphere; expected unit vectors")
        lengths[np.abs(lengths - 1) < _ROUNDING] = 1  # directions from files keep all their bits
        self.mesh, self.directions = mesh, given / lengths[:, None]
        angles = solid_angles(self.directions[mesh.faces])
        turns = angles.sum() / (4 * np.pi)
        least = _COVERAGE_MIN if mesh.is_boundary_vertex.any() else 1 - ROUNDNESS
        if not least < abs(turns) < 1 + ROUNDNESS:
            raise AbfmError(
                f"the layout covers the sphere {turns:.3g} times; expected once. Use a spherical "
                "mesh with the faces of the surface"
            )
        self.sign = 1.0 if turns > 0 else -1.0
        """-1 for a mirrored layout."""
        self.folded: IntArray = np.flatnonzero(self.sign * angles <= 0)
        """Numbers of the faces that are flipped on the sphere."""
        self._tree = KDTree(self.directions)
        self._first = vertex_points(mesh).faces

    def directions_of(self, points: SurfacePoints) -> FloatArray:
        """Return the unit vectors (P, 3) of points of the surface on the sphere."""
        corners = self.directions[self.mesh.faces[points.faces]]
        positions = np.einsum("pc,pcx->px", points.barycentric, corners)
        return np.asarray(positions / np.linalg.norm(positions, axis=1)[:, None])

    def locate(self, directions: ArrayLike) -> SurfacePoints:
        """Return the P points of the surface that lie in given directions (P, 3).

        This method is the inverse of `directions_of` except at flipped faces. In a hole the result
        is the closest point of the layout, which is on a boundary.
        """
        given = finite_points(directions)
        given = given / np.linalg.norm(given, axis=1)[:, None]
        faces = np.empty(len(given), dtype=np.int64)
        weights = np.empty((len(given), 3))
        layout = Faces(self.mesh.faces, self.mesh.opposite_slots, self.directions, self.sign)
        for begin in range(0, len(given), _CHUNK):
            checkpoint()
            chunk = slice(begin, begin + _CHUNK)
            faces[chunk] = self._first[self._tree.query(given[chunk])[1]]
            walk(layout, given[chunk], faces[chunk], weights[chunk])
        found = SurfacePoints(self.mesh, faces, weights)
        outside = np.linalg.norm(self.directions_of(found) - given, axis=1) > _DIRECTION_ROUNDING
        if not outside.any():
            return found
        closest = ClosestPoints(self.mesh, self.directions).to(given[outside])
        faces[outside], weights[outside] = closest.faces, closest.barycentric
        return SurfacePoints(self.mesh, faces, weights)


def map_through_sphere(domain: SphereLayout, codomain: SphereLayout) -> PointMap:
    """Return the map from each point of the domain to the codomain's point in its direction."""

    def interior_map(points: SurfacePoints) -> SurfacePoints:
        return codomain.locate(domain.directions_of(points))

    return PointMap.of_points(domain.mesh, codomain.locate(domain.directions), interior_map)


@unfused_kernel
def walk(layout: Faces, points: FloatArray, faces: IndexArray, weights: FloatArray) -> None:
    """Find the points of a layout in the directions ``points``, which are unit vectors (P, 3).

    Write their faces to ``faces`` (P,), whose initial values are a first guess, and their
    barycentric weights to ``weights`` (P, 3). The search walks from face to face, each time across
    the side that the point is farthest behind. If the walk fails, all faces are tried.
    """
    corners = layout.corners
    volumes, best = np.empty(3), np.empty(3)
    limit = 100 + 4 * int(np.sqrt(corners.shape[0]))
    for p in range(faces.size):
        f, found = faces[p], False
        for _ in range(limit):
            side_volumes(layout, points[p], f, volumes)
            c = volumes.argmin()
            if volumes[c] >= _VOLUME_ROUNDING:
                found = volumes.sum() > 0.0
                break
            slot = layout.neighbours[f, c]
            if slot < 0:
                break
            f = slot // 3
        if not found:
            least = -np.inf
            for g in range(corners.shape[0]):
                side_volumes(layout, points[p], g, volumes)
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
def side_volumes(layout: Faces, point: FloatArray, face: int, volumes: FloatArray) -> None:
    """Write three volumes that are the barycentric weights of a point in a face, up to a factor.

    Each is six times the signed volume of a tetrahedron between the point, a side of the face and
    the centre of the sphere.
    """
    for k in range(3):
        i, j = layout.corners[face, (k + 1) % 3], layout.corners[face, (k + 2) % 3]
        volumes[k] = layout.sign * scalar(point, cross(layout.directions[i], layout.directions[j]))
