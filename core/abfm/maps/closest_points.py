"""The closest points of a surface to points in space."""

from typing import TypeAlias

import igl
import numpy as np
from numpy.typing import ArrayLike

from abfm.errors import AbfmError
from abfm.maps.surface_points import SurfacePoints
from abfm.mesh import TriangleMesh
from abfm.numerics.kernels import kernel
from abfm.numerics.real_numbers import real_numbers
from abfm.types import FloatArray, IndexArray

Vector: TypeAlias = tuple[float, float, float]
# igl keeps the GIL for a whole query: about 15 ms each, so that a window stays alive
POINTS_PER_QUERY = 8192


def project_onto_surface(mesh: TriangleMesh, points: ArrayLike) -> SurfacePoints:
    """Find the closest point of the surface to each point.

    Exact up to rounding. Where several faces are equally close the choice is fixed, so that the
    same input gives the same output.

    Parameters
    ----------
    points : (P, 3) array
        Points in space, in the mesh's units.

    Raises
    ------
    AbfmError
        If the points are not (P, 3) or not finite.
    """
    return ClosestPoints(mesh).to(points)


class ClosestPoints:
    """A tree of boxes around the faces, for `project_onto_surface` that is asked often.

    Not kept with the mesh, as igl's trees must not live when the program ends.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        self._mesh, self._tree = mesh, igl.AABB()
        self._tree.init(mesh.vertices, mesh.faces)

    def to(self, points: ArrayLike) -> SurfacePoints:
        """Find the closest point of the surface to each point (P, 3)."""
        given, vertices, corners = finite_points(points), self._mesh.vertices, self._mesh.faces
        faces = np.empty(len(given), dtype=np.int64)
        barycentric = np.empty((len(given), 3))
        for start in range(0, len(given), POINTS_PER_QUERY):
            chunk = slice(start, start + POINTS_PER_QUERY)
            _, faces[chunk], closest = self._tree.squared_distance(vertices, corners, given[chunk])
            barycentric_weights(closest, faces[chunk], vertices, corners, barycentric[chunk])
        return SurfacePoints(self._mesh, faces, barycentric)


def finite_points(points: ArrayLike) -> FloatArray:
    """Return points in space as (P, 3).

    Raises
    ------
    AbfmError
        If they have another shape or are not finite.
    """
    given = real_numbers(points, "points", AbfmError)
    if given.ndim != 2 or given.shape[1] != 3:
        raise AbfmError(
            f"points have shape {given.shape}; expected (P, 3): give one row x, y, z per point"
        )
    bad = np.flatnonzero(~np.isfinite(given).all(axis=1))
    if len(bad):
        raise AbfmError(
            f"{len(bad)} of {len(given)} points are not finite (first: row {bad[0]}); expected "
            "finite coordinates: if they come from a flow, use a shorter time"
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
    """Compute barycentric weights (P, 3) of points (P, 3) that lie on these ``faces`` (P,) of a
    mesh, up to rounding.

    The best of four candidates, the three sides and the inside, by how close each really comes: on
    a needle or a cap the weights of the inside lose their digits, those of the sides never do.
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
def cross(a: FloatArray, b: FloatArray) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def scalar(a: FloatArray | Vector, b: FloatArray | Vector) -> float:
    product: float = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product
