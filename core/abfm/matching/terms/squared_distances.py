"""Squared distances along a surface to some of its points, and their exact derivative.

Distances of vertices are lengths of straight lines over unfolded faces. A front propagates from the
point. In the unfolded plane of each face, the distances of two corners locate the point. Source:
[Novotni and Klein, Computing Geodesic Distances on Triangular Meshes, WSCG 2002].

Inside a face with corners ``c_i`` and weights ``b_i``, the squared distance is
``sum_i b_i d_i^2 - sum_(i<j) b_i b_j |c_i - c_j|^2``, the squared distance to a point in the plane.
It is exact near the point, which is therefore its only minimum, and continuous across edges.
"""

import heapq
import math

import numpy as np

from abfm.calculus.operators import hat_gradients
from abfm.maps.surface_points import SurfacePoints
from abfm.mesh import TriangleMesh
from abfm.numerics.kernels import kernel
from abfm.types import FloatArray, IndexArray
from abfm.workers.control import checkpoint
from abfm.workers.progress import step

_REDUCTION_MAX = 1 - 1e-12  # ratio of distances; smaller reductions are rounding errors


class SquaredDistances:
    """The squared distances from L points of a mesh to L fixed points, pair by pair."""

    def __init__(self, to: SurfacePoints) -> None:
        mesh = to.mesh
        corners = mesh.vertices[mesh.faces]
        sides = np.roll(corners, -1, axis=1) - np.roll(corners, 1, axis=1)
        self._squares = (sides**2).sum(axis=2)  # (F, 3), squared lengths of opposite edges
        at_corners = _at_corners(self._squares[to.faces], to.barycentric)
        self._at_vertices = np.full((len(to.faces), len(mesh.vertices)), np.inf)
        with step("measuring distances to landmarks", len(to.faces) * len(mesh.vertices)):
            around = _around(mesh)
            for face, first, row in zip(to.faces, at_corners, self._at_vertices, strict=True):
                checkpoint()
                row[mesh.faces[face]] = first
                propagate(mesh.faces, np.sqrt(self._squares), around, mesh.faces[face], row)
        self._at_vertices **= 2

    def at(self, points: SurfacePoints) -> FloatArray:
        """Return the squared distances (L,) of points to the fixed points; none is negative."""
        b, squares = points.barycentric, self._squares[points.faces]
        correction = (np.roll(b, -1, axis=1) * np.roll(b, 1, axis=1) * squares).sum(axis=1)
        return np.asarray((b * self._of_corners(points)).sum(axis=1) - correction)

    def slopes(self, points: SurfacePoints) -> FloatArray:
        """Return the derivatives (L, 2) of the squared distances when the points move.

        The derivatives are vectors in the frames of the faces of the points.
        """
        b, squares = points.barycentric, self._squares[points.faces]
        next_one, last_one = (np.roll(b, turn, axis=1) for turn in (-1, 1))
        others = next_one * np.roll(squares, 1, axis=1) + last_one * np.roll(squares, -1, axis=1)
        gradients = hat_gradients(points.mesh)[points.faces]
        by_weights = self._of_corners(points) - others
        return np.asarray(np.einsum("lc,lck->lk", by_weights, gradients))

    def _of_corners(self, points: SurfacePoints) -> FloatArray:
        return np.take_along_axis(self._at_vertices, points.mesh.faces[points.faces], axis=1)


def _at_corners(squares: FloatArray, b: FloatArray) -> FloatArray:
    """Return the distances of points to the corners of their faces, (L, 3).

    ``b`` (L, 3) are barycentric coordinates, and ``squares`` (L, 3) squared lengths of the opposite
    edges.
    """
    next_one, last_one = (np.roll(b, turn, axis=1) for turn in (-1, 1))
    others = next_one * np.roll(squares, 1, axis=1) + last_one * np.roll(squares, -1, axis=1)
    correction = (next_one * last_one * squares).sum(axis=1, keepdims=True)
    return np.asarray(np.sqrt(np.maximum(others - correction, 0)))


def _around(mesh: TriangleMesh) -> tuple[IndexArray, IndexArray]:
    """Return the face corners around each vertex: offsets (V + 1,) into a list (3 F,)."""
    order = np.argsort(mesh.faces, axis=None, kind="stable")
    counts = np.bincount(mesh.faces.ravel(), minlength=len(mesh.vertices))
    return np.concatenate([[0], np.cumsum(counts)]), order


@kernel
def propagate(
    faces: IndexArray,
    lengths: FloatArray,
    around: tuple[IndexArray, IndexArray],
    first: IndexArray,
    distances: FloatArray,
) -> None:
    """Propagate distances (V,) along the surface in place, from the vertices ``first``.

    Their distances are known; all others are infinite at the beginning.
    """
    starts, slots = around
    front = [(distances[v], v) for v in first]
    heapq.heapify(front)
    while len(front) > 0:
        reached, v = heapq.heappop(front)
        if reached > distances[v]:
            continue
        for place in range(starts[v], starts[v + 1]):
            f, c = slots[place] // 3, slots[place] % 3
            for turn in range(1, 3):  # the third corner, from v and one other
                k = (c + turn) % 3
                other, third = faces[f, 3 - c - k], faces[f, k]
                side_a, side_b, edge = lengths[f, 3 - c - k], lengths[f, c], lengths[f, k]
                found = reached + side_a
                if distances[other] < np.inf:
                    found = min(found, distances[other] + side_b)
                    found = min(
                        found, unfolded_distance(reached, distances[other], side_a, side_b, edge)
                    )
                if found < distances[third] * _REDUCTION_MAX:
                    distances[third] = found
                    heapq.heappush(front, (found, third))


@kernel
def unfolded_distance(a: float, b: float, side_a: float, side_b: float, edge: float) -> float:
    """Return the length of the straight line from a point to the third corner of a face.

    It is straight after unfolding the faces that it crosses into a plane. It crosses the edge
    between the other two corners, which has length ``edge``. These corners have distances a and b
    to the point, and ``side_a`` and ``side_b`` to the third corner. The result is infinite if the
    line misses the edge.
    """
    x = (a * a - b * b + edge * edge) / (2 * edge)
    depth = math.sqrt(max(a * a - x * x, 0.0))
    at = (side_a * side_a - side_b * side_b + edge * edge) / (2 * edge)
    height = math.sqrt(max(side_a * side_a - at * at, 0.0))
    if depth + height <= 0.0:
        return np.inf
    crossing = x + (at - x) * depth / (depth + height)
    if not 0.0 <= crossing <= edge:
        return np.inf
    return math.sqrt((at - x) ** 2 + (depth + height) ** 2)
