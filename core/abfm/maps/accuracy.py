"""How far a point map is from a known one: geodesic errors, shares under a bound, a report."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.geodesics import path_length
from abfm.errors import ParameterError
from abfm.maps.point_maps import PointMap
from abfm.maps.surface_points import vertex_points
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray, IntArray

BOUNDS = (0.05, 0.1, 0.25)
"""Errors whose shares a report gives, in units of sqrt(area)."""


@dataclass(frozen=True, eq=False)
class MapAccuracy:
    """Errors of a map.

    Attributes
    ----------
    vertices : (S,) array of int
        The vertices that were measured, ascending: rows of the map.
    errors : (S,) array
        Geodesic distance between each one's image and its true image, over the square root of the
        surface's area.
    """

    vertices: IntArray
    errors: FloatArray

    @property
    def mean(self) -> float:
        """Mean error."""
        return float(self.errors.mean())

    @property
    def median(self) -> float:
        """Median error."""
        return float(np.median(self.errors))

    @property
    def maximum(self) -> float:
        """Largest error."""
        return float(self.errors.max())

    def share_under(self, bound: ArrayLike) -> FloatArray:
        """Return the share of vertices with an error of at most ``bound``, in its shape."""
        below = np.searchsorted(
            np.sort(self.errors), np.asarray(bound, dtype=np.float64), side="right"
        )
        return np.asarray(below / len(self.errors))

    def report(self) -> str:
        """Return the numbers in a line."""
        shares = ", ".join(
            f"{100 * self.share_under(bound):.1f} % under {bound:g}" for bound in BOUNDS
        )
        return (
            f"geodesic error: mean {self.mean:.4f}, median {self.median:.4f}, largest "
            f"{self.maximum:.4f}; {shares}"
        )


def map_accuracy(points: PointMap, truth: ArrayLike | None = None, most: int = 1000) -> MapAccuracy:
    """Measure a map against a known one.

    Distances are those of `abfm.calculus.geodesics.path_length`.

    Parameters
    ----------
    points : PointMap
        The map of V vertices.
    truth : (V,) array of int, optional
        The vertex of its codomain where each should go; by default the one with the same number.
    most : int
        Of more vertices than this, so many drawn at random (always the same ones) are measured: on
        12,000 vertices each takes about 10 ms.

    Raises
    ------
    AbfmError
        If ``truth`` does not fit ``points``, or the mesh has no geodesics between two of its
        vertices.
    """
    count, mesh = len(points.faces), points.codomain
    expected = np.arange(len(mesh.vertices)) if truth is None else np.asarray(truth)
    if expected.shape != (count,):
        raise ParameterError(
            f"truth has shape {expected.shape}; expected ({count},), a vertex for each row of the "
            "map"
        )
    if not most >= 1:
        raise ParameterError(f"{most} vertices are to be measured; expected at least 1")
    vertex_points(mesh, expected)
    chosen = np.arange(count)
    if count > most:
        chosen = np.sort(np.random.default_rng(0).choice(count, most, replace=False))
    unit = mesh.normalized()
    errors = [
        _distance(unit, int(expected[row]), int(points.faces[row]), points.barycentric[row])
        for row in chosen
    ]
    return MapAccuracy(chosen, np.array(errors))


def _distance(mesh: TriangleMesh, vertex: int, face: int, barycentric: FloatArray) -> float:
    """Return the distance along the surface from a vertex to a point in a face, at least the
    straight one in space.

    Distance is convex in flat places, so its linear interpolation between the corners is never too
    short, and neither is a way over a corner: the smaller of both.
    """
    corners = mesh.faces[face]
    place = barycentric @ mesh.vertices[corners]
    straight = float(np.linalg.norm(place - mesh.vertices[vertex]))
    if vertex in corners:
        return straight
    used = barycentric > 0
    to_corners = np.array([path_length(mesh, vertex, int(corner)) for corner in corners[used]])
    on = np.linalg.norm(mesh.vertices[corners[used]] - place, axis=1)
    return max(straight, min(float(barycentric[used] @ to_corners), float((to_corners + on).min())))
