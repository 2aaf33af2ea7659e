"""Points spread evenly over a surface, in an order in which any first few are, too."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from abfm.calculus.operators import face_areas, face_normals
from abfm.maps.surface_points import SurfacePoints, points_by_area
from abfm.mesh import TriangleMesh, per_mesh
from abfm.numerics.kernels import kernel
from abfm.types import FloatArray, IndexArray, IntArray

SPACING_MIN = 0.014
"""How near to each other points may be, in square roots of the area."""
_CANDIDATES = 32_768  # 0.006 from each other on average, in these units
# cosine of normals: points that look away from each other are no neighbours
_OPPOSITE_COSINE = -0.5


@dataclass(frozen=True, eq=False)
class SpreadPoints:
    """Points (P,) of a surface, each of them the farthest one from those before it, and how far
    that is, ``gaps`` (P,), descending, in square roots of the area; infinite where none before it
    looks the same way. ``normals`` (P, 3) turn smoothly from face to face.
    """

    points: SurfacePoints
    gaps: FloatArray
    normals: FloatArray

    def with_spacing(self, spacing: float) -> SurfacePoints:
        """Return points no two of which are nearer than a spacing, in square roots of the area,
        while every place is about as near to one of them. The spacing is at least `SPACING_MIN`;
        points of a larger one are among those of a smaller one.
        """
        return self.points[np.arange(self.count(spacing))]

    def count(self, spacing: float) -> int:
        """Return how many points are `with_spacing`: the first ones."""
        return int(np.count_nonzero(self.gaps >= spacing))

    def thinned(self, order: IntArray, spacing: float) -> IntArray:
        """Return of points by number, (N,), one after the other those that are no nearer than a
        spacing to one that was taken before.
        """
        unit = self.points[order].positions / self.points.mesh.length_scale
        taken = np.empty(len(order), dtype=np.int64)
        return order[taken[: _first_come(unit, self.normals[order], spacing, taken)]]


@per_mesh
def spread_points(mesh: TriangleMesh) -> SpreadPoints:
    """Choose points of a surface one by one, each as far as can be from all before it: the farthest
    points of Gonzalez, Clustering to minimize the maximum intercluster distance, 1985, of points
    that are spread by area.

    Distances are those in space, as long as normals do not look away from each other: both sides of
    a thin part have points of their own. The same mesh always has the same ones, which turn, move
    and grow with it.
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
    """Return unit normals that turn smoothly from face to face: those of needles say nothing."""
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
    """Return the order (m,) in which places (n, 3) are chosen, by their numbers (n,), and their
    gaps (m,), down to `SPACING_MIN`. Number 0 is the first one.

    Places are sorted by their coordinate along an axis. No place is farther from the chosen ones
    than the next one is, so that this one comes nearer only to places within that distance.
    """
    order, gaps = np.empty(len(places), dtype=np.int64), np.empty(len(places))
    squares = np.full(len(places), np.inf)  # of distances to the nearest one chosen
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
def _first_come(places: FloatArray, normals: FloatArray, spacing: float, taken: IndexArray) -> int:
    """Write which of the places (n, 3) are taken; return how many these are."""
    count = 0
    for i in range(len(places)):
        is_free = True
        for k in range(count):
            square, cosine = 0.0, 0.0
            for x in range(3):
                square += (places[i, x] - places[taken[k], x]) ** 2
                cosine += normals[i, x] * normals[taken[k], x]
            # what is taken as it is has its gap to rounding alone
            if square < 0.999999 * spacing * spacing and cosine > _OPPOSITE_COSINE:
                is_free = False
                break
        if is_free:
            taken[count] = i
            count += 1
    return count
