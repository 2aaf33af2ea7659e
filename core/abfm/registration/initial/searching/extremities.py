"""Maps by the ends of limbs, which are matched by the distances between them.

The ends are vertices whose mean distance from all other points is a local maximum, such as hands,
feet and the head of a person. Every injection of the ends of one surface into those of the other is
rated by distances and by the area around each end. A map follows from the distances d_i to the ends
and from their brackets ``<n, grad d_i x grad d_j>``. Brackets change their sign under reflection.
They therefore distinguish front from back, unlike distances.
"""

from __future__ import annotations

from itertools import combinations, permutations

import numpy as np

from abfm.calculus.operators import averaging, gradient
from abfm.calculus.smoothing import smoothed
from abfm.maps.functional_maps import nearest
from abfm.registration.initial.searching.coarse_shape import CoarseShape
from abfm.types import FloatArray, IntArray

ENDS_MIN = 3  # smallest number of ends that determine a map
_ENDS_MAX = 6
_RADIUS = 0.25  # sqrt(area); an end has the largest mean distance within this radius
_AREA_RADII = (0.1, 0.2, 0.3, 0.45)  # sqrt(area), radii of the discs whose areas are compared
_AREA_OFFSET = 0.003  # share of the total area, added to areas before the logarithm
_AREA_WEIGHT = 0.5
_DISTANCE_OFFSET = 0.03  # sqrt(area), added to distances before inversion
_DISTANCE_WEIGHT = 0.7
_BRACKET_WEIGHT = 0.3
_BRACKET_SCALE = np.sqrt(0.003)  # sqrt(area), length over which brackets are smoothed


def extremities(shape: CoarseShape) -> IntArray:
    """Return at most six vertices at the ends of limbs, the one of largest mean distance first."""
    mean = shape.distances @ shape.areas
    around = shape.distances <= _RADIUS
    highest = np.where(around, mean, -np.inf).max(axis=1)
    found = np.flatnonzero(mean >= highest)
    return found[np.argsort(-mean[found], kind="stable")][:_ENDS_MAX]


def matchings(
    a: CoarseShape, b: CoarseShape, ends_a: IntArray, ends_b: IntArray, most: int
) -> list[tuple[IntArray, IntArray]]:
    """Return at most ``most`` matchings of ends of limbs, the best one first.

    A matching is a pair of arrays: vertices (L,) of A and the matched vertices (L,) of B.
    """
    if len(ends_a) > len(ends_b):
        return [(on_a, on_b) for on_b, on_a in matchings(b, a, ends_b, ends_a, most)]
    count = len(ends_a)
    if count < ENDS_MIN:
        return []
    chosen = np.array(list(permutations(range(len(ends_b)), count)))
    logs_a, logs_b = _log_distances(a, ends_a), _log_distances(b, ends_b)
    one, other = np.triu_indices(count, 1)
    gaps = np.abs(logs_a[one, other] - logs_b[chosen[:, one], chosen[:, other]]).mean(axis=1)
    around_a, around_b = _log_areas(a, ends_a), _log_areas(b, ends_b)
    gaps += _AREA_WEIGHT * np.abs(around_a - around_b[chosen]).mean(axis=(1, 2))
    order = np.argsort(gaps, kind="stable")[:most]
    return [(ends_a, ends_b[chosen[row]]) for row in order]


def map_by_vertices(
    a: CoarseShape, b: CoarseShape, on_a: IntArray, on_b: IntArray, side: int
) -> IntArray:
    """Return a vertex of A for each vertex of B, by the distances to L matched vertices.

    Vertex ``on_a[i]`` is matched with ``on_b[i]``. ``side`` is 1 for a map onto A, and -1 for a map
    onto the mirror image of A.
    """
    rows = [_rows(shape, vertices) for shape, vertices in ((a, on_a), (b, on_b))]
    (distances_a, brackets_a), (distances_b, brackets_b) = rows
    return nearest(
        np.hstack([distances_b, brackets_b]), np.hstack([distances_a, side * brackets_a])
    )


def _log_distances(shape: CoarseShape, ends: IntArray) -> FloatArray:
    mean = float(shape.areas @ shape.distances @ shape.areas)
    relative = shape.distances[np.ix_(ends, ends)] / mean
    return np.asarray(np.log(np.maximum(relative, np.finfo(float).tiny)))


def _log_areas(shape: CoarseShape, ends: IntArray) -> FloatArray:
    within = shape.distances[ends][:, None] <= np.array(_AREA_RADII)[:, None]
    return np.asarray(np.log(within @ shape.areas + _AREA_OFFSET))


def _rows(shape: CoarseShape, vertices: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return features of V vertices: distances (V, 2 L) and brackets (V, L (L - 1) / 2)."""
    distances = shape.distances[:, vertices]
    inverse = (distances + _DISTANCE_OFFSET) ** -2.0
    pairwise = shape.distances[np.ix_(vertices, vertices)]
    mean = pairwise[np.triu_indices(len(vertices), 1)].mean()
    scaled = [inverse / inverse.sum(axis=1, keepdims=True), _DISTANCE_WEIGHT * distances / mean]
    slopes = (gradient(shape.mesh) @ distances).reshape(-1, 2, len(vertices))
    slopes = slopes / np.maximum(np.linalg.norm(slopes, axis=1, keepdims=True), 1e-12)
    one, other = np.array(list(combinations(range(len(vertices)), 2))).T
    brackets = slopes[:, 0, one] * slopes[:, 1, other] - slopes[:, 1, one] * slopes[:, 0, other]
    at_vertices = averaging(shape.mesh) @ brackets
    return np.hstack(scaled), _BRACKET_WEIGHT * smoothed(shape.mesh, at_vertices, _BRACKET_SCALE)
