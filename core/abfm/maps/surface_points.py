"""Points of a surface by face and barycentric weights, and closest points."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import igl
import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.channels import channels
from abfm.calculus.operators import face_areas
from abfm.errors import AbfmError, ParameterError
from abfm.mesh import TriangleMesh
from abfm.mesh.face_sizes import twice_areas
from abfm.numerics.kernels import kernel
from abfm.numerics.real_numbers import real_numbers
from abfm.types import FloatArray, IndexArray, IntArray

Vector: TypeAlias = tuple[float, float, float]
# igl holds the GIL during a query. Queries of this size take about 15 ms, so a window stays alive
POINTS_PER_QUERY = 8192
_ROUNDING = 1e-9  # tolerance for barycentric weights
# fractional parts of their multiples are spread evenly over a square (Roberts' R2 sequence)
_SPREAD_FRACTIONS = np.array([0.7548776662466927, 0.5698402909980532])


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """P points of a surface, each given by a face and barycentric weights.

    Raises
    ------
    ParameterError
        If faces or weights do not fit the mesh.
    """

    mesh: TriangleMesh
    faces: IntArray  # (P,), the face of each point
    barycentric: FloatArray  # (P, 3), weights of its corners, not negative, with sum 1

    def __post_init__(self) -> None:
        faces = np.asarray(self.faces)
        weights = real_numbers(self.barycentric, "barycentric", ParameterError)
        if faces.ndim != 1 or faces.dtype.kind not in "iu" or weights.shape != (len(faces), 3):
            raise ParameterError(
                f"faces of points have shape {faces.shape} of {faces.dtype}, and barycentric "
                f"weights {weights.shape}; expected (P,) integers and (P, 3)"
            )
        last = len(self.mesh.faces) - 1
        if len(faces) and not (faces.min() >= 0 and faces.max() <= last):
            raise ParameterError(
                f"points have face numbers {faces.min()} to {faces.max()}; expected 0 to {last}"
            )
        off = np.abs(weights.sum(axis=1) - 1)
        if not ((weights >= -_ROUNDING).all() and (off <= _ROUNDING).all()):
            raise ParameterError(
                "points have barycentric weights that are negative or do not sum to 1; expected "
                "points inside faces"
            )
        object.__setattr__(self, "faces", faces.astype(np.int64, copy=False))
        object.__setattr__(self, "barycentric", weights)

    @cached_property
    def positions(self) -> FloatArray:
        """The points in space, (P, 3), in the mesh's units."""
        corners = self.mesh.vertices[self.mesh.faces[self.faces]]
        return np.asarray(np.einsum("pc,pcx->px", self.barycentric, corners))

    def __getitem__(self, rows: IntArray) -> SurfacePoints:
        return SurfacePoints(self.mesh, self.faces[rows], self.barycentric[rows])

    def pull_back(self, h: ArrayLike) -> FloatArray:
        """Interpolate a function (V,) or (V, C) linearly at the points; return (P,) or (P, C)."""
        at_corners = channels(self.mesh, h, "h")[:, self.mesh.faces[self.faces]]
        values: FloatArray = np.einsum("pc,kpc->pk", self.barycentric, at_corners)
        return values.reshape(-1, *np.shape(h)[1:])

    def nearest_vertices(self) -> IntArray:
        """Return, for each point, the vertex at the nearest corner of its face, shape (P,)."""
        corners = self.mesh.faces[self.faces]
        squared = ((self.mesh.vertices[corners] - self.positions[:, None]) ** 2).sum(axis=2)
        return np.take_along_axis(corners, squared.argmin(axis=1)[:, None], axis=1)[:, 0]

    def distances_from(self, positions: FloatArray) -> FloatArray:
        """Return the distances (P,) between the points and ``positions`` (P, 3), row by row."""
        return np.asarray(np.linalg.norm(positions - self.positions, axis=1))


def vertex_points(mesh: TriangleMesh, vertices: ArrayLike | None = None) -> SurfacePoints:
    """Return the vertices with indices (P,), by default all vertices, as surface points."""
    count = len(mesh.vertices)
    given = np.arange(count) if vertices is None else np.asarray(vertices)
    if given.ndim != 1 or given.dtype.kind not in "iu":
        raise AbfmError(
            f"vertices have shape {given.shape} of {given.dtype}; expected (P,) integers"
        )
    if len(given) and not 0 <= given.min() <= given.max() < count:
        raise AbfmError(f"vertices are {given.min()} to {given.max()}; expected 0 to {count - 1}")
    corner = np.empty(count, dtype=np.int64)
    corner[mesh.faces.ravel()] = np.arange(mesh.faces.size)
    faces, corners = np.divmod(corner[given], 3)
    return SurfacePoints(mesh, faces, np.eye(3)[corners])


def points_by_area(mesh: TriangleMesh, count: int) -> SurfacePoints:
    """Return ``count`` points of a surface, spread evenly by area, always the same ones."""
    before = np.cumsum(face_areas(mesh))
    at = (np.arange(count) + 0.5) / count * before[-1]
    faces = np.searchsorted(before, at).clip(max=len(before) - 1)
    u, v = (np.arange(1, count + 1)[:, None] * _SPREAD_FRACTIONS % 1).T
    beyond = u + v > 1
    u, v = np.where(beyond, 1 - u, u), np.where(beyond, 1 - v, v)
    return SurfacePoints(mesh, faces, np.stack([1 - u - v, u, v], axis=1))


def project_onto_surface(mesh: TriangleMesh, points: ArrayLike) -> SurfacePoints:
    """Return the surface point closest to each of the points in space (P, 3), in mesh units.

    If several faces are equally close, the result is deterministic.
    """
    return ClosestPoints(mesh).to(points)


class ClosestPoints:
    """A search tree of the faces of a mesh, to find surface points closest to points in space.

    With ``positions`` (V, 3) the vertices are moved there first, and faces without area are
    excluded. The tree is not cached with the mesh, because igl's trees must be deleted before the
    program ends.
    """

    def __init__(self, mesh: TriangleMesh, positions: FloatArray | None = None) -> None:
        self._mesh, self._tree, self._faces = mesh, igl.AABB(), None
        self._vertices, corners = mesh.vertices, mesh.faces
        if positions is not None:
            self._vertices = np.ascontiguousarray(positions)
            self._faces = np.flatnonzero(twice_areas(positions, corners) > 0)
            corners = corners[self._faces]
        self._tree.init(self._vertices, corners)
        self._corners = corners

    def to(self, points: ArrayLike) -> SurfacePoints:
        """Return the point of the mesh closest to each of the points in space (P, 3)."""
        given, vertices, corners = finite_points(points), self._vertices, self._corners
        faces = np.empty(len(given), dtype=np.int64)
        barycentric = np.empty((len(given), 3))
        for start in range(0, len(given), POINTS_PER_QUERY):
            chunk = slice(start, start + POINTS_PER_QUERY)
            _, faces[chunk], closest = self._tree.squared_distance(vertices, corners, given[chunk])
            barycentric_weights(closest, faces[chunk], vertices, corners, barycentric[chunk])
        return SurfacePoints(
            self._mesh, faces if self._faces is None else self._faces[faces], barycentric
        )


def finite_points(points: ArrayLike) -> FloatArray:
    """Check points in space and return them as an array (P, 3)."""
    given = real_numbers(points, "points", AbfmError)
    if given.ndim != 2 or given.shape[1] != 3:
        raise AbfmError(
            f"points have shape {given.shape}; expected (P, 3), one row x, y, z per point"
        )
    bad = np.flatnonzero(~np.isfinite(given).all(axis=1))
    if len(bad):
        raise AbfmError(
            f"{len(bad)} of {len(given)} points are not finite (first: row {bad[0]}); expected "
            "finite coordinates. If a flow computed them, use a shorter time"
        )
    return given


@kernel
def barycentric_weights(
    points: FloatArray,
    faces: IndexArray,
    vertices: FloatArray,
    corners: IndexArray,
    out: FloatArray,
) -> None:
    """Compute the barycentric weights (P, 3) of points in space that lie on ``faces`` (P,).

    Each result is the closest of four candidates: one on each side of the face, and one inside it.
    On slivers, the candidate inside is inaccurate.
    """
    sides, offsets, inside, tried = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(3)
    for p in range(faces.size):
        for k in range(3):
            for x in range(3):
                start = vertices[corners[faces[p], k], x]
                offsets[k, x] = points[p, x] - start
                sides[k, x] = vertices[corners[faces[p], (k + 1) % 3], x] - start
        normal = cross(sides[0], sides[1])
        for k in range(3):
            inside[(k + 2) % 3] = scalar(cross(sides[k], offsets[k]), normal)
        least = np.inf
        for candidate in range(4):
            if candidate < 3:
                side = sides[candidate]
                along = min(max(scalar(offsets[candidate], side) / scalar(side, side), 0.0), 1.0)
                tried[:] = 0.0
                tried[candidate], tried[(candidate + 1) % 3] = 1.0 - along, along
            elif inside.min() >= 0.0 and inside.sum() > 0.0:
                tried[:] = inside / inside.sum()
            gap = 0.0
            for x in range(3):
                gap += (offsets[0, x] - tried[1] * sides[0, x] + tried[2] * sides[2, x]) ** 2
            if gap < least:
                least = gap
                out[p] = tried


@kernel
def cross(a: FloatArray | Vector, b: FloatArray | Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def scalar(a: FloatArray | Vector, b: FloatArray | Vector) -> float:
    product: float = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product
