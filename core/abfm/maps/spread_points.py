"""Points spread evenly over a surface, in an order in which any first few are, too."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from abfm.calculus.operators import face_areas, face_normals
from abfm.maps.surface_points import SurfacePoints, points_by_area
from abfm.mesh import TriangleMesh, per_mesh
from abfm.numerics.kernels import kernel
from abfm.types import FloatArray, IndexArray

NEAREST = 0.014
"""How near to each other points may be, in square roots of the area."""
_CANDIDATES = 32_768  # 0.006 from each other on average, in these units
_OPPOSITE = -0.5  # cosine of normals: points that look away from each other are no neighbours


@dataclass(frozen=True, eq=False)
class SpreadPoints:
    """Points (P,) of a surface, each of them the farthest one from those before it, and how far
    that is, ``gaps`` (P,), descending, in square roots of the area; infinite where none before it
    looks the same way.
    """

    points: SurfacePoints
    gaps: FloatArray

    def apart(self, spacing: float) -> SurfacePoints:
        """Return points no two of which are nearer than a spacing, in square roots of the area,
        while every place is about as near to one of them. The spacing is at least `NEAREST`; points
        of a larger one are among those of a smaller one.
        """
        return self.points[np.arange(np.count_nonzero(self.gaps >= spacing))]


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
    order, gaps = np.empty(_CANDIDATES, dtype=np.int64), np.empty(_CANDIDATES)
    normals = _smooth_normals(unit, candidates)
    count = farthest_first(candidates.positions, normals, NEAREST, order, gaps)
    chosen = candidates[order[:count]]
    return SpreadPoints(SurfacePoints(mesh, chosen.faces, chosen.barycentric), gaps[:count])


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
def farthest_first(
    places: FloatArray, normals: FloatArray, least: float, order: IndexArray, gaps: FloatArray
) -> int:
    """Write the order in which places (n, 3) are chosen, and their gaps, down to the ``least``;
    return how many these are.
    """
    squares = np.full(len(places), np.inf)  # of distances to the nearest one chosen
    chosen = 0
    for count in range(order.size):
        if squares[chosen] < least * least:
            return count
        order[count], gaps[count] = chosen, np.sqrt(squares[chosen])
        farthest, place, normal = 0, places[chosen], normals[chosen]
        squares[chosen] = 0.0
        for i in range(squares.size):
            square, cosine = 0.0, 0.0
            for x in range(3):
                square += (places[i, x] - place[x]) ** 2
                cosine += normals[i, x] * normal[x]
            if square < squares[i] and cosine > _OPPOSITE:
                squares[i] = square
            if squares[i] > squares[farthest]:
                farthest = i
        chosen = farthest
    return order.size
