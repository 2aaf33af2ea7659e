"""Points spread evenly over a surface, ordered so that every initial part is also spread evenly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from abfm.calculus.operators import face_areas, face_normals
from abfm.maps.surface_points import SurfacePoints, points_by_area
from abfm.mesh import TriangleMesh, per_mesh
from abfm.numerics.kernels import kernel
from abfm.types import FloatArray, IndexArray, IntArray

SPACING_MIN = 0.014  # smallest distance between two points, in sqrt(area)
_CANDIDATES = 32_768  # number of candidates, with a mean distance of 0.006 sqrt(area)
_OPPOSITE_COSINE = -0.5  # points whose normals have a smaller cosine are not neighbours


@dataclass(frozen=True, eq=False)
class SpreadPoints:
    """Points of a surface in an order in which each is the farthest from all points before it."""

    points: SurfacePoints  # (P,)
    # (P,), distances from the points before, descending, in sqrt(area); infinite if none before
    # has a similar normal
    gaps: FloatArray
    normals: FloatArray  # (P, 3), normals interpolated smoothly between faces

    def with_spacing(self, spacing: float) -> SurfacePoints:
        """Return the first points, as many as are at least ``spacing`` apart, in sqrt(area).

        Every point of the surface is within about the same distance of one of these points. The
        smallest possible spacing is ``SPACING_MIN``.
        """
        return self.points[np.arange(self.count(spacing))]

    def count(self, spacing: float) -> int:
        """Return the number of points that `with_spacing` returns."""
        return int(np.count_nonzero(self.gaps >= spacing))

    def thinned(self, order: IntArray, spacing: float) -> IntArray:
        """Select candidates at least ``spacing`` apart, in sqrt(area), and return their indices.

        The candidates, given by their indices ``order`` (N,), are tried in this order.
        """
        unit = self.points[order].positions / self.points.mesh.length_scale
        taken = np.empty(len(order), dtype=np.int64)
        return order[taken[: _select(unit, self.normals[order], spacing, taken)]]


@per_mesh
def spread_points(mesh: TriangleMesh) -> SpreadPoints:
    """Choose points of a surface one by one, each as far as possible from all points before it.

    The method is farthest-point sampling (Gonzalez, Clustering to minimize the maximum intercluster
    distance, 1985) of candidates that are spread by area. Distances are measured in space between
    points with similar normals, so both sides of a thin part have separate points. The result is
    deterministic, and moves, rotates and scales with the mesh.
    """
    unit = mesh.normalized()
    candidates = points_by_area(unit, _CANDIDATES)
    normals = _smooth_normals(unit, candidates)
    widest = int(np.argmax(np.ptp(candidates.positions, axis=0)))
    numbers = np.argsort(candidates.positions[:, widest], kind="stable")
    order, gaps = _farthest_first(candidates.positions[numbers], widest, normals[numbers], numbers)
    chosen = candidates[order]
    points = SurfacePoints(mesh, chosen.faces, chosen.barycentric)
    return SpreadPoints(points, gaps, normals[order])


def _smooth_normals(mesh: TriangleMesh, points: SurfacePoints) -> FloatArray:
    """Return unit normals at points, interpolated between vertices.

    Normals of the faces are not suitable, because those of slivers are random.
    """
    weighted = face_areas(mesh)[:, None] * face_normals(mesh)
    corners, count = mesh.faces.ravel(), len(mesh.vertices)
    at_vertices = [np.bincount(corners, np.repeat(w, 3), count) for w in weighted.T]
    found = points.pull_back(_unit(np.stack(at_vertices, axis=1)))
    return _unit(found)


def _unit(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300))


@kernel
def _farthest_first(
    places: FloatArray, axis: int, normals: FloatArray, numbers: IndexArray
) -> tuple[IndexArray, FloatArray]:
    """Order positions (n, 3) so that each is the farthest from all positions before it.

    Return the ``numbers`` of the first m positions, beginning with number 0, and their gaps (m,).
    A gap is the distance from the nearest position before; gaps descend to ``SPACING_MIN``.
    Positions are sorted along ``axis``, so that few are updated at a time.
    """
    order, gaps = np.empty(len(places), dtype=np.int64), np.empty(len(places))
    squares = np.full(len(places), np.inf)  # squared distances to the nearest chosen place
    chosen = int(np.argmin(numbers))
    for count in range(len(places)):
        farthest_square = squares[chosen]
        if farthest_square < SPACING_MIN * SPACING_MIN:
            return order[:count], gaps[:count]
        order[count], gaps[count] = numbers[chosen], np.sqrt(farthest_square)
        squares[chosen] = 0.0
        for side in range(2):
            for step in range(1, len(places) - chosen if side else chosen + 1):
                i = chosen + step if side else chosen - step
                if (places[i, axis] - places[chosen, axis]) ** 2 >= farthest_square:
                    break
                square, cosine = 0.0, 0.0
                for x in range(3):
                    square += (places[i, x] - places[chosen, x]) ** 2
                    cosine += normals[i, x] * normals[chosen, x]
                if square < squares[i] and cosine > _OPPOSITE_COSINE:
                    squares[i] = square
        chosen = 0
        for i in range(squares.size):
            if squares[i] > squares[chosen] or (
                squares[i] == squares[chosen] and numbers[i] < numbers[chosen]
            ):
                chosen = i
    return order, gaps


@kernel
def _select(places: FloatArray, normals: FloatArray, spacing: float, taken: IndexArray) -> int:
    """Select positions at least ``spacing`` apart from ``places`` (n, 3), in their order.

    Write their indices to ``taken``, and return their count. Positions with opposite normals, as on
    both sides of a thin part, may be closer.
    """
    count = 0
    for i in range(len(places)):
        is_free = True
        for k in range(count):
            square, cosine = 0.0, 0.0
            for x in range(3):
                square += (places[i, x] - places[taken[k], x]) ** 2
                cosine += normals[i, x] * normals[taken[k], x]
            # points selected before with this spacing may be closer by rounding
            if square < 0.999999 * spacing * spacing and cosine > _OPPOSITE_COSINE:
                is_free = False
                break
        if is_free:
            taken[count] = i
            count += 1
    return count
