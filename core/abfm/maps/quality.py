"""How good a map is: geodesic errors against a known one; or how far its points came from the
surface, and how many faces it folds.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.geodesics import path_length
from abfm.calculus.operators import edge_lengths
from abfm.errors import ParameterError
from abfm.maps.distortion import Distortion, SurfaceMap
from abfm.maps.point_maps import PointMap
from abfm.maps.surface_points import vertex_points
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray, IntArray

ERROR_BOUNDS = (0.05, 0.1, 0.25)  # errors whose shares a report gives, in sqrt(area)
# A map has faults beyond distances from the surface, in sqrt(area), or a share of folded faces.
# Of 30 flows of known smooth fields on five surfaces every one beyond the first had points more
# than 0.16 from the ends of exact flow lines; every one beyond the second was wrong by 0.03 on
# average; those within all three by at most 0.022, the others by up to 0.13.
DISTANCE_MAX = 0.1
RMS_DISTANCE_MAX = 0.02
FOLDED_SHARE_MAX = 0.1
_ASKED_VERTICES_MAX = 10_000  # vertices that go there and back
RETURN_DISTANCE_MAX = 1.0  # edges from where they were that 5% of the vertices may come back


@dataclass(frozen=True, eq=False)
class MapAccuracy:
    """Geodesic distances (S,) between images and true images, over the square root of the surface's
    area, and the vertices (S,), ascending, that they are of.
    """

    vertices: IntArray
    errors: FloatArray

    @property
    def mean(self) -> float:
        return float(self.errors.mean())

    @property
    def median(self) -> float:
        return float(np.median(self.errors))

    @property
    def maximum(self) -> float:
        return float(self.errors.max())

    def share_under(self, bound: ArrayLike) -> FloatArray:
        """Return the share of vertices with an error of at most ``bound``, in its shape."""
        at_most = self.errors <= np.asarray(bound, dtype=np.float64)[..., None]
        return np.asarray(at_most.sum(axis=-1) / len(self.errors))

    def report(self) -> str:
        """Return the numbers in a line."""
        shares = (
            f"{100 * self.share_under(bound):.1f} % under {bound:g}" for bound in ERROR_BOUNDS
        )
        return (
            f"geodesic error: mean {self.mean:.4f}, median {self.median:.4f}, largest "
            f"{self.maximum:.4f}; {', '.join(shares)}"
        )


def map_accuracy(points: PointMap, truth: ArrayLike | None = None, most: int = 1000) -> MapAccuracy:
    """Measure a map against a known one (V,), by default each vertex to the one with its number, by
    `path_length`. Of more vertices than ``most``, so many drawn at random (always the same ones)
    are measured: on 12,000 vertices each takes about 10 ms.
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
    places = zip(expected[chosen], points.faces[chosen], points.barycentric[chosen], strict=True)
    return MapAccuracy(chosen, np.array([_distance(unit, *place) for place in places]))


def _distance(mesh: TriangleMesh, vertex: int, face: int, barycentric: FloatArray) -> float:
    """Return the distance along the surface from a vertex to a point in a face: the smaller of a
    linear interpolation between corners, which in flat places is never too short, and a way over
    one.
    """
    corners = mesh.faces[face]
    place = barycentric @ mesh.vertices[corners]
    straight = float(np.linalg.norm(place - mesh.vertices[vertex]))
    if vertex in corners:
        return straight
    used = barycentric > 0
    to_corners = np.array([path_length(mesh, vertex, int(corner)) for corner in corners[used]])
    over_corners = to_corners + np.linalg.norm(mesh.vertices[corners[used]] - place, axis=1)
    return max(straight, min(float(barycentric[used] @ to_corners), float(over_corners.min())))


@dataclass(frozen=True)
class MapQuality:
    """Numbers that tell a map from none: how far its points were from the surface before they were
    brought onto it, in sqrt(area), and the share of the faces, 0 to 1, that it turns over.
    """

    largest_distance: float
    rms_distance: float
    folded: float

    @property
    def faults(self) -> str:
        """Name what exceeds its bound, in a few words; empty where nothing does."""
        wrong = []
        if self.largest_distance > DISTANCE_MAX or self.rms_distance > RMS_DISTANCE_MAX:
            wrong.append(
                f"points up to {self.largest_distance:.3g} sqrt(area) off the surface (RMS "
                f"{self.rms_distance:.3g})"
            )
        if self.folded > FOLDED_SHARE_MAX:
            wrong.append(f"{100 * self.folded:.0f}% of the faces folded")
        return " and ".join(wrong)

    def report(self) -> str:
        """Return the numbers in a line."""
        return (
            f"off the surface: largest {self.largest_distance:.3g}, RMS {self.rms_distance:.3g} "
            f"sqrt(area); folded: {100 * self.folded:.1f} % of the faces"
        )


def map_quality(points: PointMap) -> MapQuality:
    """Measure how far a map leaves its codomain and how many faces it folds."""
    distances = points.distances / points.codomain.length_scale
    rms, folded = np.sqrt(np.mean(distances**2)), points.distortion().flipped.mean()
    return MapQuality(float(distances.max()), float(rms), float(folded))


class RoundTrip(NamedTuple):
    """How far from where they were vertices come back, in edges, each in the mean of its own."""

    median: float
    p95: float  # percentile

    def report(self) -> str:
        """Return the numbers in a line."""
        return f"there and back: median {self.median:.2g}, 95% {self.p95:.2g} edges from the start"


def round_trip(there: PointMap, back: SurfaceMap) -> RoundTrip:
    """Measure how far each vertex is from where a map, and then a way back for points, such as
    `PointMap.at` of another one, bring it; on large meshes 10,000 vertices, evenly chosen.
    """
    mesh, count = there.domain, len(there.faces)
    ends, lengths = mesh.edges.ravel(), np.repeat(edge_lengths(mesh), 2)
    edges = np.bincount(ends, lengths, count) / np.bincount(ends, minlength=count)
    asked = np.linspace(0, count - 1, min(count, _ASKED_VERTICES_MAX)).astype(np.int64)
    off = back(there.points[asked]).distances_from(mesh.vertices[asked]) / edges[asked]
    median, p95 = np.percentile(off, (50, 95))
    return RoundTrip(float(median), float(p95))


@dataclass(frozen=True)
class FlowMapQuality:
    """What is told of the map of a flow and its inverse: what it does to faces, and whether points
    come back, which they do not where the field gathers many into less than rounding tells apart.
    """

    distortion: Distortion
    round_trip: RoundTrip

    @property
    def warning(self) -> str | None:
        """Say why this is no map, and what helps; None where nothing exceeds its bound."""
        folded, off = self.distortion.flipped.mean(), self.round_trip.p95
        wrong = [f"{100 * folded:.0f}% of the faces are folded"] * bool(folded > FOLDED_SHARE_MAX)
        if off > RETURN_DISTANCE_MAX:
            wrong.append(f"5% of the vertices come back {off:.2g} edges from where they were")
        if not wrong:
            return None
        advice = "a shorter time, a larger alpha or a finer mesh helps"
        return f"this map is not to be trusted: {' and '.join(wrong)}; {advice}"

    def report(self) -> str:
        """Return the numbers in two lines."""
        return f"{self.distortion.report()}\n{self.round_trip.report()}"
