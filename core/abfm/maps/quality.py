"""Measures of the quality of maps.

The measures are geodesic errors relative to a known map, distances from the surface before
projection, folded faces, and errors of round trips.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.geodesics import path_length
from abfm.calculus.operators import edge_lengths
from abfm.errors import ParameterError
from abfm.maps.distortion import Distortion, Log2Statistics, SurfaceMap
from abfm.maps.point_maps import PointMap
from abfm.maps.surface_points import vertex_points
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray, IntArray
from abfm.wording import number_text, percents

# in sqrt(area); a report has the shares of vertices with errors up to these bounds
ERROR_BOUNDS = (0.05, 0.1, 0.25)
# A map has faults if one of the next three bounds is exceeded. They were chosen with 30 flows of
# known smooth fields on five surfaces. Every flow beyond the first bound had points with a distance
# above 0.16 from the ends of exact flow lines. Every flow beyond the second bound had a mean error
# of at least 0.03. Flows within all bounds had mean errors of at most 0.022, others of up to 0.13.
DISTANCE_MAX = 0.1  # sqrt(area), largest distance of an image from the surface
RMS_DISTANCE_MAX = 0.02  # sqrt(area), root mean square of these distances
FOLDED_SHARE_MAX = 0.1  # largest share of folded faces
_ROUND_TRIP_VERTICES_MAX = 10_000  # number of vertices measured by a round trip
_HEADS = ("mean", "median", "95%", "98%", "largest")  # columns of `quality_table`
RETURN_DISTANCE_MAX = 1.0  # mean edge lengths, for 95% of the vertices after a round trip


@dataclass(frozen=True, eq=False)
class MapAccuracy:
    """Geodesic errors of a map at some vertices: distances of their images from the true images."""

    vertices: IntArray  # (S,), measured vertices, ascending
    errors: FloatArray  # (S,), distances between images and true images, in sqrt(area)

    @property
    def mean(self) -> float:
        """Mean error, in sqrt(area)."""
        return float(self.errors.mean())

    @property
    def median(self) -> float:
        """Median error, in sqrt(area)."""
        return float(np.median(self.errors))

    @property
    def maximum(self) -> float:
        """Largest error, in sqrt(area)."""
        return float(self.errors.max())

    def share_under(self, bound: ArrayLike) -> FloatArray:
        """Return the share of vertices with errors up to each ``bound``, in sqrt(area)."""
        at_most = self.errors <= np.asarray(bound, dtype=np.float64)[..., None]
        return np.asarray(at_most.sum(axis=-1) / len(self.errors))

    def report(self) -> str:
        """Return the mean, median and largest error, and shares of vertices, in a line of text."""
        shares = (
            f"{100 * self.share_under(bound):.1f} % under {bound:g}" for bound in ERROR_BOUNDS
        )
        return (
            f"geodesic error in sqrt(area): mean {self.mean:.4f}, median {self.median:.4f}, "
            f"largest {self.maximum:.4f}; vertices: {', '.join(shares)}"
        )


def map_accuracy(
    points: PointMap, truth: ArrayLike | None = None, count_max: int = 1000
) -> MapAccuracy:
    """Measure the geodesic errors of a map.

    ``truth`` (V,) is the true vertex of the codomain for each vertex of the domain, by default the
    vertex with the same number. Distances are measured by `path_length`. If the domain has more
    than ``count_max`` vertices, this many are drawn at random, always the same ones. Each takes
    about 10 ms on 12,000 vertices.
    """
    count, mesh = len(points.faces), points.codomain
    expected = np.arange(len(mesh.vertices)) if truth is None else np.asarray(truth)
    if expected.shape != (count,):
        raise ParameterError(
            f"truth has shape {expected.shape}; expected ({count},), one vertex for each vertex of "
            "the domain"
        )
    if not count_max >= 1:
        raise ParameterError(f"count_max is {count_max}; expected at least 1 vertex to measure")
    vertex_points(mesh, expected)
    chosen = np.arange(count)
    if count > count_max:
        chosen = np.sort(np.random.default_rng(0).choice(count, count_max, replace=False))
    unit = mesh.normalized()
    places = zip(expected[chosen], points.faces[chosen], points.barycentric[chosen], strict=True)
    return MapAccuracy(chosen, np.array([_distance(unit, *place) for place in places]))


def _distance(mesh: TriangleMesh, vertex: int, face: int, barycentric: FloatArray) -> float:
    """Estimate the distance along the surface from a vertex to a point inside a face.

    The estimate is the smaller of two values, but at least the straight distance. One is
    interpolated between the distances of the face's corners. The other is the length of the
    shortest path through a corner. Neither is too short on flat parts.
    """
    corners = mesh.faces[face]
    point = barycentric @ mesh.vertices[corners]
    straight = float(np.linalg.norm(point - mesh.vertices[vertex]))
    if vertex in corners:
        return straight
    used = barycentric > 0
    to_corners = np.array([path_length(mesh, vertex, int(corner)) for corner in corners[used]])
    through_corners = to_corners + np.linalg.norm(mesh.vertices[corners[used]] - point, axis=1)
    return max(straight, min(float(barycentric[used] @ to_corners), float(through_corners.min())))


@dataclass(frozen=True)
class MapQuality:
    """Distances of a map's images from the codomain before projection, and its folded faces."""

    largest_distance: float  # in sqrt(area)
    rms_distance: float  # in sqrt(area)
    folded: float  # share of the faces, 0 to 1, that are flipped

    @property
    def faults(self) -> str:
        """Text about distances and folded faces that exceed their bounds; empty if none does."""
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
        """Return the distances and the share of folded faces as one line of text."""
        return (
            f"distance of images from the surface: largest {self.largest_distance:.3g}, RMS "
            f"{self.rms_distance:.3g} sqrt(area); folded: {100 * self.folded:.1f} % of the faces"
        )


def map_quality(points: PointMap) -> MapQuality:
    """Measure the distances of a map's images from its codomain, and its folded faces."""
    distances = points.distances / points.codomain.length_scale
    rms, folded = np.sqrt(np.mean(distances**2)), points.distortion().flipped.mean()
    return MapQuality(float(distances.max()), float(rms), float(folded))


class RoundTrip(NamedTuple):
    """Statistics of the distances between vertices and their images after a map and a map back.

    The unit of each distance is the mean length of the edges at the vertex.
    """

    median: float
    p95: float  # 95th percentile

    def report(self) -> str:
        """Return the median and the 95th percentile as one line of text."""
        return f"round-trip error: median {self.median:.2g}, 95% {self.p95:.2g} edge lengths"


def round_trip(points: PointMap, back: SurfaceMap) -> RoundTrip:
    """Measure how far vertices are displaced by a map, followed by a map back to the domain.

    ``back`` takes points of the codomain and returns points of the domain, such as
    `abfm.PointMap.at` of another map. On larger meshes 10,000 evenly chosen vertices are measured.
    """
    mesh, count = points.domain, len(points.faces)
    ends, lengths = mesh.edges.ravel(), np.repeat(edge_lengths(mesh), 2)
    edges = np.bincount(ends, lengths, count) / np.bincount(ends, minlength=count)
    sample = np.linspace(0, count - 1, min(count, _ROUND_TRIP_VERTICES_MAX)).astype(np.int64)
    errors = back(points.points[sample]).distances_from(mesh.vertices[sample]) / edges[sample]
    median, p95 = np.percentile(errors, (50, 95))
    return RoundTrip(float(median), float(p95))


@dataclass(frozen=True)
class FlowMapQuality:
    """Distortion of the map of a flow, and the error of its round trip.

    Points do not return to their original position if the field compresses many of them into a
    region that rounding does not resolve.
    """

    distortion: Distortion
    round_trip: RoundTrip

    @property
    def warning(self) -> str | None:
        """Warning with advice if many faces are folded or the round trip is inexact, or None."""
        folded, error = self.distortion.flipped.mean(), self.round_trip.p95
        wrong = [f"{100 * folded:.0f}% of the faces are folded"] * bool(folded > FOLDED_SHARE_MAX)
        if error > RETURN_DISTANCE_MAX:
            wrong.append(
                f"5% of the vertices return {error:.2g} or more edge lengths away from their start"
            )
        if not wrong:
            return None
        advice = "Use a shorter time, a larger alpha or a finer mesh"
        return f"this map is not reliable: {' and '.join(wrong)}. {advice}"

    def report(self) -> str:
        """Return the distortion and the round-trip error as two lines of text."""
        return f"{self.distortion.report()}\n{self.round_trip.report()}"


def quality_table(
    distortion: Distortion,
    back: RoundTrip,
    accuracy: MapAccuracy | None = None,
    title: str = "map of the flow:",
) -> list[str]:
    """Return distortion, round-trip errors and geodesic errors of a map as lines of a table."""
    rows = [
        ("areas, |log2 J|", _log2_row(distortion.log2_area)),
        ("shapes, |log2 R|", _log2_row(distortion.log2_shape)),
        ("round trip, edge lengths", (None, back.median, back.p95, None, None)),
    ]
    shares: list[str] = []
    if accuracy is not None:
        measured = accuracy.mean, accuracy.median, None, None, accuracy.maximum
        rows.append(("error, sqrt(area)", measured))
        for bound in ERROR_BOUNDS:
            within = percents(float(accuracy.share_under(bound)), ".3g")
            shares.append(f"{within} of the vertices have an error of at most {bound:g}")
    table = [(title, _HEADS), *((n, [number_text(x, ".3g") for x in row]) for n, row in rows)]
    return [
        *(f"{name:<24}{''.join(f'{cell:>10}' for cell in cells)}" for name, cells in table),
        *shares,
        f"folded faces: {distortion.folded:,} of {len(distortion.area):,}",
        "95%: largest value on 95% of the surface; |log2 J| is 1 where areas double or halve",
    ]


def _log2_row(found: Log2Statistics) -> tuple[float | None, ...]:
    return found.mean, None, found.p95, found.p98, found.maximum
