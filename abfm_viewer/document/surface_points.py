"""Conversion of points and landmarks between the classes of documents and those of the library."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import abfm
from abfm import TriangleMesh
from abfm.pages.front import triple
from abfm_viewer.document.document import SIDES, Landmark, Point


def surface_points(mesh: TriangleMesh, points: Sequence[Point]) -> abfm.maps.SurfacePoints:
    faces = np.array([point.face for point in points], dtype=np.int64)
    weights = np.array([point.barycentric for point in points], dtype=np.float64)
    return abfm.maps.SurfacePoints(mesh, faces, weights.reshape(-1, 3))


def points_of(found: abfm.maps.SurfacePoints) -> list[Point]:
    places = zip(found.faces.tolist(), found.barycentric, strict=True)
    return [Point(face, triple(weights)) for face, weights in places]


def landmark_pairs(
    a: TriangleMesh, b: TriangleMesh, pairs: Sequence[Landmark]
) -> abfm.registration.Landmarks | None:
    """Return landmarks of a document as an object of the library; None if there are none.

    All ``pairs`` must have points on both surfaces, ``a`` and ``b``.
    """
    if not pairs:
        return None
    on_a, on_b = (
        surface_points(mesh, [point for pair in pairs if (point := pair.point(side)) is not None])
        for mesh, side in zip((a, b), SIDES, strict=True)
    )
    weights = np.array([pair.weight for pair in pairs])
    return abfm.registration.Landmarks(on_a, on_b, weights, tuple(pair.name for pair in pairs))


def landmarks_of(given: abfm.registration.Landmarks) -> tuple[Landmark, ...]:
    """Return the library's landmarks as those of a document, without names that are numbers."""
    names = ("" if name == str(n) else name for n, name in enumerate(given.names))
    columns = points_of(given.a), points_of(given.b), given.weights.tolist(), names
    return tuple(map(Landmark, *columns))


def landmarks_of_match(match: abfm.Match) -> tuple[Landmark, ...]:
    """Return the landmarks of a match, with start and target points on its surface."""
    if (marks := match.problem.landmarks) is None:
        return ()
    starts, ends = points_of(marks.points(match.mesh)), points_of(marks.targets(match.mesh))
    return tuple(map(Landmark, starts, ends, marks.weights.tolist()))
