"""Points of a surface, and maps of its vertices to them: closest points, functions read there, and distortion.

A flow carries functions, not points. The coordinate functions carried for a time are the places that the vertices'
values came from, near the surface but not on it, so that `project_onto_surface` makes points of them.
"""

from dataclasses import dataclass
from typing import TypeAlias

import igl
import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.channels import channels
from abfm.calculus.operators import face_normals, hat_gradients
from abfm.errors import AbfmError
from abfm.mesh import TriangleMesh
from abfm.numerics.kernels import kernel
from abfm.real_numbers import real_numbers
from abfm.types import BoolArray, FloatArray, IndexArray, IntArray

Vector: TypeAlias = tuple[float, float, float]
POINTS_PER_QUERY = 8192  # igl keeps the GIL for a whole query: about 15 ms each, so that a window stays alive


@dataclass(frozen=True)
class SurfacePoints:
    """P points on a mesh."""

    faces: IntArray  # (P,), the face that holds each point
    barycentric: FloatArray  # (P, 3), weights of its corners, non-negative, summing to 1
    positions: FloatArray  # (P, 3), the points in space
    distances: FloatArray  # (P,), how far each given point was from the surface, in the mesh's units


@dataclass(frozen=True)
class Distortion:
    """What a piecewise linear map does to each of F faces; see `distortion`."""

    singular_values: FloatArray  # (F, 2), largest and smallest stretch ``s_1 >= s_2 >= 0``
    area: FloatArray  # (F,), ``s_1 s_2``: mapped area over area
    conformal: FloatArray  # (F,), ``s_1 / s_2 >= 1``; inf where a face collapses
    flipped: BoolArray  # (F,), True where the mapped face looks against the surface that it landed on


def project_onto_surface(mesh: TriangleMesh, points: ArrayLike) -> SurfacePoints:
    """Find the closest point of the surface to each point.

    Distances are exact up to rounding. Where several faces are equally close the choice is fixed, so that the same
    input gives the same output.

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
    """What `project_onto_surface` finds, for who asks often: it keeps the boxes around the faces that it looks in."""

    def __init__(self, mesh: TriangleMesh) -> None:
        self._mesh, self._tree = mesh, igl.AABB()
        self._tree.init(mesh.vertices, mesh.faces)

    def to(self, points: ArrayLike) -> SurfacePoints:
        """The closest point of the surface to each point."""
        given, vertices, corners = _finite_points(points), self._mesh.vertices, self._mesh.faces
        faces = np.empty(len(given), dtype=np.int64)
        barycentric = np.empty((len(given), 3))
        for start in range(0, len(given), POINTS_PER_QUERY):
            chunk = slice(start, start + POINTS_PER_QUERY)
            _, faces[chunk], closest = self._tree.squared_distance(vertices, corners, given[chunk])
            barycentric_weights(closest, faces[chunk], vertices, corners, barycentric[chunk])
        positions = np.einsum("pc,pcx->px", barycentric, vertices[corners[faces]])
        return SurfacePoints(faces, barycentric, positions, np.linalg.norm(given - positions, axis=1))


def vertex_points(mesh: TriangleMesh, vertices: ArrayLike) -> SurfacePoints:
    """Vertices (P,), by index, as points of the surface: a vertex-to-vertex map as the maps of this package are kept.

    Raises
    ------
    AbfmError
        If an index is not a whole number or not among the mesh's own vertices.
    """
    given = np.asarray(vertices)
    count = len(mesh.vertices)
    if given.ndim != 1 or given.dtype.kind not in "iu":
        raise AbfmError(f"vertices have shape {given.shape} of {given.dtype}; expected (P,) whole numbers")
    if len(given) and not 0 <= given.min() <= given.max() < count:
        raise AbfmError(f"vertices are {given.min()} to {given.max()}; expected 0 to {count - 1}")
    corner = np.empty(count, dtype=np.int64)
    corner[mesh.faces.ravel()] = np.arange(mesh.faces.size)
    faces, corners = np.divmod(corner[given], 3)
    return SurfacePoints(faces, np.eye(3)[corners], mesh.vertices[given], np.zeros(len(given)))


def pull_back(mesh: TriangleMesh, points: SurfacePoints, h: ArrayLike) -> FloatArray:
    """Evaluate a vertex function at points of the surface (linear inside each face).

    With ``points`` the flow map of every vertex this is ``h`` composed with the map, as point-to-point maps transfer
    functions; with ``h`` the positions of a second map it is the composition of both.

    Parameters
    ----------
    h : (V,) or (V, C) array

    Returns
    -------
    (P,) or (P, C) array

    Raises
    ------
    FunctionError
        If ``h`` does not fit the mesh.
    """
    at_corners = channels(mesh, h, "h")[:, mesh.faces[points.faces]]
    values: FloatArray = np.einsum("pc,kpc->pk", points.barycentric, at_corners)
    return values.reshape(-1, *np.shape(h)[1:])


def map_vertices_to_nearest(mesh: TriangleMesh, points: SurfacePoints) -> IntArray:
    """Round each point to the nearest corner of its face, (P,) vertex indices: a vertex-to-vertex map.

    Only the face's own corners are considered, so that a point on one side of a thin part stays on that side.
    """
    corners = mesh.faces[points.faces]
    squared = ((mesh.vertices[corners] - points.positions[:, None]) ** 2).sum(axis=2)
    return np.take_along_axis(corners, squared.argmin(axis=1)[:, None], axis=1)[:, 0]


def distortion(mesh: TriangleMesh, mapped_positions: ArrayLike, onto: TriangleMesh | None = None) -> Distortion:
    """Measure the distortion of the map that is linear on faces and takes each vertex to its mapped position.

    The Jacobian of a face, ``J = sum_i x_i (grad phi_i)^T`` with ``x_i`` the mapped corners, has the singular values
    ``s_1 >= s_2``. Area and angles are those of the flat mapped triangle in space, whose corners lie on the surface.
    A face counts as flipped where its mapped normal makes an obtuse angle with the surface's normal at the point
    closest to its mapped centroid; a collapsed face does not count. For flow maps the error is of first order in the
    edge length, that of the map itself of second.

    Parameters
    ----------
    mapped_positions : (V, 3) array
        Where the map takes each vertex, in the units of ``onto``; for a flow map the ``positions`` of its
        `SurfacePoints`.
    onto : TriangleMesh, optional
        The surface that the map leads to, by default the mesh itself.

    Raises
    ------
    AbfmError
        If the positions are not (V, 3) or not finite.
    """
    mapped = _finite_points(mapped_positions)
    if len(mapped) != len(mesh.vertices):
        raise AbfmError(f"{len(mapped)} mapped positions for {len(mesh.vertices)} vertices: give one row per vertex")
    corners = mapped[mesh.faces]
    other = mesh if onto is None else onto
    jacobian = np.einsum("fcx,fck->fxk", corners - corners[:, :1], hat_gradients(mesh))
    first, second = jacobian[..., 0], jacobian[..., 1]
    normal = np.cross(first, second)
    area = np.linalg.norm(normal, axis=1)
    a, b, c = (first * first).sum(axis=1), (first * second).sum(axis=1), (second * second).sum(axis=1)
    largest = np.sqrt(0.5 * (a + c + np.hypot(a - c, 2 * b)))
    smallest = np.minimum(np.divide(area, largest, out=np.zeros_like(area), where=largest > 0), largest)
    conformal = np.divide(largest, smallest, out=np.full_like(area, np.inf), where=smallest > 0)
    return Distortion(np.stack([largest, smallest], axis=1), area, conformal, turned_over(other, corners))


def turned_over(mesh: TriangleMesh, corners: FloatArray) -> BoolArray:
    """Whether flat triangles (S, 3, 3) with corners on a surface look against it where their middles are closest."""
    landed = project_onto_surface(mesh, corners.mean(axis=1))
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray((normals * face_normals(mesh)[landed.faces]).sum(axis=1) < 0)


def _finite_points(points: ArrayLike) -> FloatArray:
    given = real_numbers(points, "points", AbfmError)
    if given.ndim != 2 or given.shape[1] != 3:
        raise AbfmError(f"points have shape {given.shape}; expected (P, 3): give one row x, y, z per point")
    bad = np.flatnonzero(~np.isfinite(given).all(axis=1))
    if len(bad):
        raise AbfmError(
            f"{len(bad)} of {len(given)} points are not finite (first: row {bad[0]}); expected finite coordinates: "
            "if they come from a flow, use a shorter time"
        )
    return given


@kernel
def barycentric_weights(
    points: FloatArray, faces: IndexArray, vertices: FloatArray, corners: IndexArray, out: FloatArray
) -> None:
    """Barycentric weights (P, 3) of points (P, 3) that lie on these ``faces`` (P,) of a mesh, up to rounding.

    The best of four candidates, the three sides and the inside, by how close each really comes: on a needle or a cap
    the weights of the inside lose their digits, those of the sides never do.
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
