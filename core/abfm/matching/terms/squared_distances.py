"""Squared distances along a surface to some of its points, and their exact derivative.

At vertices they are those of straight ways over unfolded faces: a front runs out from the point,
and each face takes its source, seen in its plane, from the distances of two corners [Novotni and
Klein, Computing Geodesic Distances on Triangular Meshes, WSCG 2002]. Inside a face with corners
``c_i`` and weights ``b_i`` the square is ``sum_i b_i d_i^2 - sum_(i<j) b_i b_j |c_i - c_j|^2``,
that of the distance to a point of its plane: exact near the point, so that it is least there alone,
and continuous over edges everywhere.
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

_GAIN_ROUNDING = 1 - 1e-12  # of a distance: a smaller gain is rounding


class SquaredDistances:
    """Those from any L points of a mesh to L given ones, each to its own."""

    def __init__(self, to: SurfacePoints) -> None:
        mesh = to.mesh
        corners = mesh.vertices[mesh.faces]
        sides = np.roll(corners, -1, axis=1) - np.roll(corners, 1, axis=1)
        self._squares = (sides**2).sum(axis=2)  # (F, 3), of the edges opposite corners
        at_corners = _at_corners(self._squares[to.faces], to.barycentric)
        self._at_vertices = np.full((len(to.faces), len(mesh.vertices)), np.inf)
        with step("measuring distances to landmarks", len(to.faces) * len(mesh.vertices)):
            around = _around(mesh)
            for face, first, row in zip(to.faces, at_corners, self._at_vertices, strict=True):
                checkpoint()
                row[mesh.faces[face]] = first
                spread(mesh.faces, np.sqrt(self._squares), around, mesh.faces[face], row)
        self._at_vertices **= 2

    def at(self, points: SurfacePoints) -> FloatArray:
        """Return the squares, (L,), not negative."""
        b, squares = points.barycentric, self._squares[points.faces]
        between = (np.roll(b, -1, axis=1) * np.roll(b, 1, axis=1) * squares).sum(axis=1)
        return np.asarray((b * self._of_corners(points)).sum(axis=1) - between)

    def slopes(self, points: SurfacePoints) -> FloatArray:
        """Return the derivatives by the points, (L, 2), in the frames of their faces."""
        b, squares = points.barycentric, self._squares[points.faces]
        next_one, last_one = (np.roll(b, turn, axis=1) for turn in (-1, 1))
        others = next_one * np.roll(squares, 1, axis=1) + last_one * np.roll(squares, -1, axis=1)
        gradients = hat_gradients(points.mesh)[points.faces]
        by_weights = self._of_corners(points) - others
        return np.asarray(np.einsum("lc,lck->lk", by_weights, gradients))

    def _of_corners(self, points: SurfacePoints) -> FloatArray:
        return np.take_along_axis(self._at_vertices, points.mesh.faces[points.faces], axis=1)


def _at_corners(squares: FloatArray, b: FloatArray) -> FloatArray:
    """Return the distances of points in faces to their corners, (L, 3)."""
    next_one, last_one = (np.roll(b, turn, axis=1) for turn in (-1, 1))
    others = next_one * np.roll(squares, 1, axis=1) + last_one * np.roll(squares, -1, axis=1)
    between = (next_one * last_one * squares).sum(axis=1, keepdims=True)
    return np.asarray(np.sqrt(np.maximum(others - between, 0)))


def _around(mesh: TriangleMesh) -> tuple[IndexArray, IndexArray]:
    """Return where each vertex's slots begin, (V + 1,), in all of them, (3 F,)."""
    order = np.argsort(mesh.faces, axis=None, kind="stable")
    counts = np.bincount(mesh.faces.ravel(), minlength=len(mesh.vertices))
    return np.concatenate([[0], np.cumsum(counts)]), order


@kernel
def spread(
    faces: IndexArray,
    lengths: FloatArray,
    around: tuple[IndexArray, IndexArray],
    first: IndexArray,
    distances: FloatArray,
) -> None:
    """Lower distances (V,), known at the first vertices, to those that run out from there."""
    starts, slots = around
    front = [(distances[v], v) for v in first]
    heapq.heapify(front)
    while len(front) > 0:
        reached, v = heapq.heappop(front)
        if reached > distances[v]:
            continue
        for place in range(starts[v], starts[v + 1]):
            f, c = slots[place] // 3, slots[place] % 3
            for turn in range(1, 3):  # v and one other corner tell the third
                k = (c + turn) % 3
                other, third = faces[f, 3 - c - k], faces[f, k]
                near, far, between = lengths[f, 3 - c - k], lengths[f, c], lengths[f, k]
                found = reached + near
                if distances[other] < np.inf:
                    found = min(found, distances[other] + far)
                    found = min(found, through(reached, distances[other], near, far, between))
                if found < distances[third] * _GAIN_ROUNDING:
                    distances[third] = found
                    heapq.heappush(front, (found, third))


@kernel
def through(a: float, b: float, near: float, far: float, between: float) -> float:
    """Return the length of the straight way to the third corner of a face over the edge of two that
    it is so far from, at distances a and b from the source; infinite if none leads over it.
    """
    x = (a * a - b * b + between * between) / (2 * between)
    depth = math.sqrt(max(a * a - x * x, 0.0))
    at = (near * near - far * far + between * between) / (2 * between)
    height = math.sqrt(max(near * near - at * at, 0.0))
    if depth + height <= 0.0:
        return np.inf
    crossing = x + (at - x) * depth / (depth + height)
    if not 0.0 <= crossing <= between:
        return np.inf
    return math.sqrt((at - x) ** 2 + (depth + height) ** 2)
