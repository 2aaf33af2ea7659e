"""The initial map of two surfaces, as the best of several candidates.

Every candidate is relaxed on a thousand vertices of either surface (`reversible`) and compared by
what it costs then (`map_cost`): relaxation removes what is arbitrary in how a candidate was made,
and keeps which limb goes where. Where it hardly moves the best one, that one's own map on all
vertices is more accurate and is taken; else the relaxed one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from abfm.errors import AbfmError
from abfm.maps.functional_maps import nearest
from abfm.maps.point_maps import PointMap
from abfm.maps.sphere_embedding import sphere_embedding
from abfm.maps.spherical import SphereLayout
from abfm.maps.surface_points import project_onto_surface
from abfm.mesh import TriangleMesh
from abfm.registration.correspondence import Candidate
from abfm.registration.initial.alignment import MotionKind, align, closest_after_alignment
from abfm.registration.initial.discontinuous_maps import make_continuous
from abfm.registration.initial.landmark_pairs import Landmarks
from abfm.registration.initial.map_input import Initial, MapInput
from abfm.registration.initial.searching import extremities
from abfm.registration.initial.searching.coarse_shape import CoarseShape, coarse_shape, ranks
from abfm.registration.initial.searching.map_cost import MapCost, map_cost
from abfm.registration.initial.searching.reversible import TwoWayMap, relax, two_way_map
from abfm.registration.initial.spectral import SpectralSearch
from abfm.registration.initial.sphere_maps import (
    LANDMARK_WEIGHT,
    LANDMARKS_MIN,
    sphere_of,
    turned,
)
from abfm.registration.initial.sphere_rotations import (
    SphereFunctions,
    rotation_by_functions,
    rotation_by_landmarks,
)
from abfm.types import FloatArray, IntArray
from abfm.workers.control import checkpoint
from abfm.workers.progress import step

KINDS = ("spectral", "extremities", "embedding", "closest", "landmarks")
_VERTICES = 1000
_SCREENED_VERTICES = 400
_PENALTIES = np.geomspace(0.05, 10, 12)
_SCREENING_PENALTIES = np.geomspace(0.05, 10, 6)
_POLISHING_PENALTIES = np.geomspace(0.5, 10, 6)
_TURNS = 2  # at each penalty
_DESCRIPTOR_WEIGHT = 0.2  # while relaxing
_POLISHING_DESCRIPTOR_WEIGHT = 0.05
_MATCHINGS = 48
_RELAXED_MATCHINGS = 4
_SPECTRAL_MAPS = 3
_FUNCTION_WEIGHT_MAX = 2.0  # of all given functions, next to five descriptors of weight 1
_DISTRIBUTION_GAP = 0.15  # deviations between distributions at which a function counts 1 / e
_LANDMARK_WIDTH = 0.15  # sqrt(area) around landmarks that move with them
_MIRROR_COST = 0.5  # of maps onto the mirror image if either side may be right
_SAME_PLACE = 0.05  # sqrt(area), mean distance between images of maps to the same places
_OTHER_PLACE = 0.1  # the same of maps to different places
_SAME_SURFACE = 0.01  # sqrt(area), RMS distance of aligned surfaces that are one
_COST_TIE = 0.1  # difference of costs
_COST_MAX = 4.5  # of a plausible map
_SIDE_MIN = 0.5


def is_searched(candidates: Sequence[Candidate]) -> bool:
    """Return whether a map was found between two shapes, by one of `KINDS`."""
    return any(each.name.partition(":")[0] in KINDS for each in candidates[:1])


class Pair(NamedTuple):
    """Two coarse surfaces, with the functions and landmarks that maps between them keep."""

    a: CoarseShape
    b: CoarseShape
    descriptors: tuple[FloatArray, FloatArray]  # (V_A, C) and (V_B, C)
    weights: FloatArray  # (C,)
    places: tuple[IntArray, IntArray]  # (L,) vertices of landmarks
    place_weights: FloatArray  # (L,), of sum 1

    def relax(self, start: TwoWayMap, penalties: FloatArray, keep: float, turns: int) -> TwoWayMap:
        scale = np.sqrt(self.weights)
        on_a, on_b = (values * scale for values in self.descriptors)
        return relax(
            self.a, self.b, start, (on_a, on_b), weight=keep, penalties=penalties, turns=turns
        )

    def cost(self, found: TwoWayMap) -> MapCost:
        return map_cost(self.a, self.b, found, self.descriptors, self.weights)

    def of_shape(self) -> Pair:
        """Return the surfaces without given functions."""
        count = self.a.descriptors.shape[1]
        on_a, on_b = self.descriptors
        return self._replace(
            descriptors=(on_a[:, :count], on_b[:, :count]), weights=self.weights[:count]
        )

    def landmark_cost(self, found: TwoWayMap) -> float:
        on_a, on_b = self.places
        if not len(on_a):
            return 0.0
        gaps = self.a.distances[on_a, found.there[on_b]]
        return LANDMARK_WEIGHT * float(self.place_weights @ gaps)

    def distance(self, one: TwoWayMap, other: TwoWayMap) -> float:
        """Return the mean distance between the images of two maps, in sqrt(area)."""
        return float(self.b.areas @ self.a.distances[one.there, other.there])


class Start(NamedTuple):
    """A candidate: the word of its kind, its side, its vertex of A for each of B on coarse meshes,
    and its own map on all vertices, if there is one.
    """

    kind: str
    side: int
    at: Callable[[Pair], IntArray]
    own: Callable[[], Initial] | None = None
    is_exact: bool = False  # of one surface that stands elsewhere

    @property
    def name(self) -> str:
        return self.kind if self.side > 0 else f"{self.kind}:mirror"


class Relaxed(NamedTuple):
    """A candidate after relaxation."""

    start: Start
    found: TwoWayMap
    cost: float
    parts: MapCost
    moved: float  # mean distance from where it was before, in sqrt(area)


def search_initial_map(
    given: MapInput, kinds: Sequence[str] = KINDS, sides: Sequence[int] = (1, -1)
) -> Initial:
    """Return the best map of candidates of some kinds and sides (1, or -1 for the mirror image).

    Raises
    ------
    AbfmError
        If no kind applies to the surfaces.
    """
    search = _Search(given)
    with step("comparing initial maps") as done:
        fine = search.pair(_VERTICES)
        starts, refused = _starts(search, kinds, sides)
        if not starts:
            raise AbfmError("; ".join(refused))
        done(0.4)
        chosen = _screened(search.pair(_SCREENED_VERTICES), starts)
        done(0.6)
        tried = []
        for number, start in enumerate(chosen):
            tried.append(_relaxed(fine, start, both_sides=len(sides) > 1))
            done(0.6 + 0.3 * (number + 1) / len(chosen))
        tried.sort(key=lambda each: each.cost)
    best = _most_accurate(fine, tried)
    if best.start.own is not None and best.moved <= _SAME_PLACE:
        found = best.start.own()
    else:
        found = make_continuous(given, search.polished(best))
    return Initial(
        found.correspondence.with_candidates(_listed(best, tried)),
        found.notes,
        tuple(_doubts(fine, best, tried)),
    )


class _Search:
    """What candidates are made of, each computed when first needed."""

    def __init__(self, given: MapInput) -> None:
        self.given = given

    def pair(self, count: int) -> Pair:
        a, b = coarse_shape(self.given.a, count), coarse_shape(self.given.b, count)
        on_a, on_b, weights = _functions(self.given, a, b)
        places, counts = _places(self.given, a, b)
        return Pair(
            a,
            b,
            (np.hstack([a.descriptors, on_a]), np.hstack([b.descriptors, on_b])),
            np.concatenate([np.ones(a.descriptors.shape[1]), weights]),
            places,
            counts,
        )

    @cached_property
    def spectral(self) -> SpectralSearch:
        given = self.given
        pair = self.pair(_VERTICES)
        first = pair.a.descriptors.shape[1]
        scale = np.sqrt(pair.weights[first:])
        if not scale.any():
            return SpectralSearch(given.a, given.b, given.landmarks)
        on_a, on_b = (values[:, first:] * scale for values in pair.descriptors)
        functions = shape_values(pair.a, given.a, on_a), shape_values(pair.b, given.b, on_b)
        return SpectralSearch(given.a, given.b, given.landmarks, functions)

    def polished(self, best: Relaxed) -> PointMap:
        """Return the relaxed map on all vertices of B, through its landmarks."""
        pair, given = self.pair(_VERTICES), self.given
        found = pair.relax(
            best.found, _POLISHING_PENALTIES, _POLISHING_DESCRIPTOR_WEIGHT, 2 * _TURNS
        )
        images = _through_landmarks(pair, found.images)
        on_b = shape_values(pair.b, given.b, images)
        on_a = shape_values(pair.a, given.a, pair.a.coordinates)
        # a tree, as the matrix of all distances of two fine meshes takes too much memory
        return PointMap.of_vertices(given.b, given.a, KDTree(on_a).query(on_b)[1])


def shape_values(shape: CoarseShape, mesh: TriangleMesh, values: FloatArray) -> FloatArray:
    """Interpolate values (V, C) of a coarse shape to the vertices of its fine mesh."""
    return project_onto_surface(shape.mesh, mesh.normalized().vertices).pull_back(values)


def _functions(
    given: MapInput, a: CoarseShape, b: CoarseShape
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the given functions on coarse surfaces, (V_A, C) and (V_B, C), by rank, and their
    weights (C,): less the more their distributions differ, and in all not too much.
    """
    if given.f is None or given.g is None:
        return np.zeros((len(a.areas), 0)), np.zeros((len(b.areas), 0)), np.zeros(0)
    on_a, on_b = a.sampled(given.a, given.f.T), b.sampled(given.b, given.g.T)
    counts = np.ones(len(given.f)) if given.weights is None else given.weights / given.weights.max()
    weights = counts * _likeness(on_a, on_b, a.areas, b.areas)
    weights *= min(1.0, _FUNCTION_WEIGHT_MAX / max(weights.sum(), _FUNCTION_WEIGHT_MAX))
    return ranks(on_a, a.areas), ranks(on_b, b.areas), weights


def _likeness(
    on_a: FloatArray, on_b: FloatArray, areas_a: FloatArray, areas_b: FloatArray
) -> FloatArray:
    """Return how similar the distributions of functions (V_A, C) and (V_B, C) are, (C,), 0 to 1, by
    the Wasserstein distance of their values less their means over their deviations.
    """
    # late, as it takes half a second to load
    from scipy.stats import wasserstein_distance

    def standardised(values: FloatArray, areas: FloatArray) -> FloatArray:
        values = values - areas @ values
        deviations = np.sqrt(areas @ values**2)
        return np.divide(values, deviations, out=np.zeros_like(values), where=deviations > 0)

    columns = zip(standardised(on_a, areas_a).T, standardised(on_b, areas_b).T, strict=True)
    gaps = [wasserstein_distance(f, g, areas_a, areas_b) for f, g in columns]
    return np.asarray(np.exp(-np.array(gaps) / _DISTRIBUTION_GAP))


def _places(
    given: MapInput, a: CoarseShape, b: CoarseShape
) -> tuple[tuple[IntArray, IntArray], FloatArray]:
    """Return the coarse vertices nearest to landmarks, and what each counts."""
    marks = given.landmarks
    if marks is None:
        none = np.zeros(0, dtype=np.int64)
        return (none, none), np.zeros(0)
    on_a, on_b = (
        np.asarray(KDTree(shape.mesh.vertices).query(points.positions / mesh.length_scale)[1])
        for shape, points, mesh in ((a, marks.a, given.a), (b, marks.b, given.b))
    )
    return (on_a, on_b), marks.weights / marks.weights.sum()


def _through_landmarks(pair: Pair, images: FloatArray) -> FloatArray:
    """Return images (V_B, 8) moved smoothly so that landmarks lie at their places."""
    on_a, on_b = pair.places
    if not len(on_a):
        return images
    gaps = pair.a.coordinates[on_a] - images[on_b]
    near = np.exp(-((pair.b.distances[:, on_b] / _LANDMARK_WIDTH) ** 2) / 2)
    moves, *_ = np.linalg.lstsq(near[on_b] + 1e-6 * np.eye(len(on_b)), gaps, rcond=None)
    return np.asarray(images + near @ moves)


def _starts(
    search: _Search, kinds: Sequence[str], sides: Sequence[int]
) -> tuple[list[Start], list[str]]:
    """Return the candidates of some kinds and sides, and why there are none of others."""
    found: list[Start] = []
    refused: list[str] = []
    for kind in kinds:
        for side in sides:
            checkpoint()
            try:
                found += _MAKERS[kind](search, side)
            except AbfmError as error:
                refused.append(f"{kind}: {error}")
    return found, list(dict.fromkeys(refused))


def _spectral_starts(search: _Search, side: int) -> Iterator[Start]:
    given, spectral = search.given, search.spectral
    ranked = spectral.ranked(side)
    own_side = [C for C in ranked if side * spectral.side(C) > 0]
    for C in (own_side or ranked)[:_SPECTRAL_MAPS]:

        def at(pair: Pair, C: FloatArray = C) -> IntArray:
            return spectral.nearest(C, pair.a.mesh.vertices, pair.b.mesh.vertices)

        def own(C: FloatArray = C) -> Initial:
            return make_continuous(given, spectral.finished(C)[0])

        yield Start("spectral", side, at, own)


def _extremity_starts(search: _Search, side: int) -> Iterator[Start]:
    pair = search.pair(_VERTICES)
    ends = extremities.extremities(pair.a), extremities.extremities(pair.b)
    if min(map(len, ends)) < extremities.ENDS_MIN:
        raise AbfmError(
            f"A has {len(ends[0])} and B {len(ends[1])} ends of limbs; expected at least "
            f"{extremities.ENDS_MIN} on both"
        )
    for on_a, on_b in extremities.matchings(pair.a, pair.b, *ends, _MATCHINGS):
        places = pair.a.mesh.vertices[on_a], pair.b.mesh.vertices[on_b]
        yield Start("extremities", side, _by_places(places, side))


def _landmark_starts(search: _Search, side: int) -> Iterator[Start]:
    marks = search.given.landmarks
    if marks is None or len(marks) < LANDMARKS_MIN:
        raise AbfmError(
            f"{0 if marks is None else len(marks)} landmarks were given; expected "
            f"{LANDMARKS_MIN} or more"
        )

    def at(pair: Pair) -> IntArray:
        return extremities.map_by_vertices(pair.a, pair.b, *pair.places, side)

    yield Start("landmarks", side, at)


def _by_places(places: tuple[FloatArray, FloatArray], side: int) -> Callable[[Pair], IntArray]:
    """Return the map by distances to places in space at unit area, (L, 3) on A and on B."""

    def at(pair: Pair) -> IntArray:
        on_a, on_b = (
            np.asarray(KDTree(shape.mesh.vertices).query(points)[1])
            for shape, points in zip(pair[:2], places, strict=True)
        )
        return extremities.map_by_vertices(pair.a, pair.b, on_a, on_b, side)

    return at


def _closest_starts(search: _Search, side: int) -> Iterator[Start]:
    given = search.given
    kind: MotionKind = "similarity" if side > 0 else "mirror"
    pair = search.pair(_VERTICES)
    marks = None if given.landmarks is None else _moved(given.landmarks, pair)
    alignment = align(pair.a.mesh, pair.b.mesh, kind, marks)

    def at(pair: Pair) -> IntArray:
        places = alignment(pair.b.mesh.vertices)
        return np.asarray(KDTree(pair.a.mesh.vertices).query(places)[1])

    def own() -> Initial:
        points, _ = closest_after_alignment(given.a, given.b, kind, given.landmarks)
        return make_continuous(given, points)

    yield Start("closest", side, at, own, alignment.rms <= _SAME_SURFACE)


def _moved(marks: Landmarks, pair: Pair) -> Landmarks:
    """Return landmarks on the coarse surfaces."""
    a, b = (
        project_onto_surface(shape.mesh, points.positions / points.mesh.length_scale)
        for shape, points in ((pair.a, marks.a), (pair.b, marks.b))
    )
    return Landmarks(a, b, marks.weights, marks.names)


def _embedding_starts(search: _Search, side: int) -> Iterator[Start]:
    given, pair = search.given, search.pair(_VERTICES)
    mirror = np.array([side, 1, 1])
    on_a, on_b = (sphere_embedding(shape.mesh) for shape in pair[:2])
    layouts = SphereLayout(pair.a.mesh, on_a * mirror), SphereLayout(pair.b.mesh, on_b)
    if given.landmarks is not None and len(given.landmarks) >= LANDMARKS_MIN:
        rotation = rotation_by_landmarks(*layouts, _moved(given.landmarks, pair))
    else:
        sphere_a, sphere_b = (
            SphereFunctions(layout, values.T)
            for layout, values in zip(layouts, pair.descriptors, strict=True)
        )
        rotation = rotation_by_functions(sphere_a, sphere_b, pair.weights, is_rough=True)
    if rotation is not None:
        on_a = on_a @ np.diag(mirror) @ rotation.rotation.as_matrix().T

    def at(pair_: Pair) -> IntArray:
        places = [
            project_onto_surface(shape.mesh, own.mesh.vertices).pull_back(directions)
            for shape, own, directions in zip(pair[:2], pair_[:2], (on_a, on_b), strict=True)
        ]
        return nearest(places[1], places[0])

    def own() -> Initial:
        functions = [
            shape_values(shape, mesh, values).T
            for shape, mesh, values in zip(pair[:2], given[:2], pair.descriptors, strict=True)
        ]
        full = given._replace(f=functions[0], g=functions[1], weights=pair.weights)
        return turned(full, sphere_of(given.a), sphere_of(given.b), side < 0)

    yield Start("embedding", side, at, own)


_MAKERS: dict[str, Callable[[_Search, int], Iterable[Start]]] = {
    "spectral": _spectral_starts,
    "extremities": _extremity_starts,
    "embedding": _embedding_starts,
    "closest": _closest_starts,
    "landmarks": _landmark_starts,
}


def _screened(pair: Pair, starts: list[Start]) -> list[Start]:
    """Return candidates without matchings of extremities that cost much on few vertices."""
    costs: dict[int, float] = {}
    for number, start in enumerate(starts):
        if start.kind == "extremities":
            checkpoint()
            found = pair.relax(
                two_way_map(pair.a, pair.b, start.at(pair)),
                _SCREENING_PENALTIES,
                _DESCRIPTOR_WEIGHT,
                _TURNS,
            )
            parts = pair.cost(found)._replace(commutator=0.0)
            costs[number] = parts.total(start.side) + pair.landmark_cost(found)
    kept = []
    for side in (1, -1):
        own = [number for number in costs if starts[number].side == side]
        kept += sorted(own, key=lambda number: costs[number])[:_RELAXED_MATCHINGS]
    return [start for number, start in enumerate(starts) if number not in costs or number in kept]


def _relaxed(pair: Pair, start: Start, both_sides: bool) -> Relaxed:
    checkpoint()
    first = two_way_map(pair.a, pair.b, start.at(pair))
    found = pair.relax(first, _PENALTIES, _DESCRIPTOR_WEIGHT, _TURNS)
    parts = pair.cost(found)
    cost = parts.total(start.side) + pair.landmark_cost(found)
    if both_sides and start.side < 0:
        cost += _MIRROR_COST
    return Relaxed(start, found, cost, parts, pair.distance(first, found))


def _most_accurate(pair: Pair, tried: list[Relaxed]) -> Relaxed:
    """Return of the candidates that lead to the same places as the best one the most accurate one:
    an exact one, else one by eigenfunctions.
    """
    best = tried[0]
    alike = [
        each
        for each in tried
        if each.start.own is not None
        and each.cost < best.cost + _COST_TIE
        and each.start.side == best.start.side
        and pair.distance(best.found, each.found) <= _SAME_PLACE
    ]

    def rank(each: Relaxed) -> tuple[bool, bool, float]:
        return not each.start.is_exact, each.start.kind != "spectral", each.moved

    return min(alike, key=rank, default=best)


def _doubts(pair: Pair, best: Relaxed, tried: list[Relaxed]) -> list[str]:
    """Return why the best map may lead elsewhere."""
    found = []
    cost = pair.of_shape().cost(best.found).total(best.start.side)
    if cost > _COST_MAX or best.parts.side * best.start.side < _SIDE_MIN:
        found.append(
            f"no candidate for the initial map is plausible: the best one, {best.start.name}, has "
            f"a cost of {cost:.2f} (at most {_COST_MAX:g} for plausible ones)"
        )
    rival = next(
        (
            each
            for each in tried
            if each.start.side == best.start.side
            and pair.distance(best.found, each.found) > _OTHER_PLACE
        ),
        None,
    )
    if rival is not None and rival.cost < best.cost + _COST_TIE:
        found.append(
            f"another initial map that leads elsewhere is nearly as good ({best.start.name} "
            f"{best.cost:.2f}, {rival.start.name} {rival.cost:.2f}), as where front and back are "
            "alike: give landmarks that distinguish them"
        )
    return found


def _listed(best: Relaxed, tried: list[Relaxed]) -> tuple[Candidate, ...]:
    """Return the best of every name, the chosen one first."""
    found = {best.start.name: Candidate(best.start.name, best.cost)}
    for each in tried:
        found.setdefault(each.start.name, Candidate(each.start.name, each.cost))
    return tuple(found.values())
