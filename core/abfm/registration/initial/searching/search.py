"""The best of several candidates for the initial map of two surfaces.

Every candidate is relaxed on about a thousand vertices of both surfaces (`reversible`), and the
costs of the relaxed maps are compared (`map_cost`). Relaxation removes arbitrary differences
between methods and preserves the assignment of limbs. If it hardly moves the best candidate, the
candidate's original map on all vertices is more accurate and becomes the result. Otherwise the
relaxed map is the result.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property
from itertools import product
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
    map_through_spheres,
    sphere_of,
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
_FIXED_WORK = 12_000  # number of fine vertices that take as long as all coarse ones
_VERTICES = 1000  # vertices of the coarse surfaces
_SCREENED_VERTICES = 400  # vertices for the selection of matchings
_PENALTIES = np.geomspace(0.05, 10, 12)  # ascending penalties of a relaxation, see `relax`
_SCREENING_PENALTIES = np.geomspace(0.05, 10, 6)
_POLISHING_PENALTIES = np.geomspace(0.5, 10, 6)
_ITERATIONS = 2  # iterations of a relaxation at each penalty
_DESCRIPTOR_WEIGHT = 0.2  # weight of the descriptors in a relaxation
_POLISHING_DESCRIPTOR_WEIGHT = 0.05
_MATCHINGS_MAX = 48  # matchings of extremities that are compared
_RELAXED_MATCHINGS = 4  # best matchings that become candidates, for each side
_SPECTRAL_MAPS = 3
_FUNCTION_WEIGHT_MAX = 2.0  # summed over given functions; each of five descriptors has weight 1
_DISTRIBUTION_SCALE = 0.15  # Wasserstein distance that reduces a weight by a factor of e
_LANDMARK_WIDTH = 0.15  # sqrt(area), width of the region that moves with a landmark
_MIRROR_COST = 0.5  # added for mirrored maps if both sides are tried
_SAME_MAP_DISTANCE = 0.05  # sqrt(area), largest mean distance between images of equivalent maps
_OTHER_MAP_DISTANCE = 0.1  # sqrt(area), smallest mean distance between images of different maps
_SAME_SURFACE_DISTANCE = 0.01  # sqrt(area), RMS distance of identical surfaces after alignment
_COST_TIE = 0.1  # smaller differences of costs are not significant
_COST_MAX = 4.5  # largest cost of a plausible map
_SIDE_MIN = 0.5  # least `MapCost.side` of a plausible map


def is_searched(candidates: Sequence[Candidate]) -> bool:
    """Return whether the chosen candidate is by one of `KINDS`, methods for different shapes."""
    return any(each.name.partition(":")[0] in KINDS for each in candidates[:1])


class Pair(NamedTuple):
    """Two coarse surfaces with functions and landmarks on both."""

    a: CoarseShape
    b: CoarseShape
    descriptors: tuple[FloatArray, FloatArray]  # (V_A, C) and (V_B, C)
    weights: FloatArray  # (C,)
    landmarks: tuple[IntArray, IntArray]  # (L,), coarse vertices
    landmark_weights: FloatArray  # (L,), weights with the sum 1

    def relax(
        self, start: TwoWayMap, penalties: FloatArray, descriptor_weight: float, iterations: int
    ) -> TwoWayMap:
        scale = np.sqrt(self.weights)
        on_a, on_b = (values * scale for values in self.descriptors)
        return relax(
            self.a,
            self.b,
            start,
            (on_a, on_b),
            weight=descriptor_weight,
            penalties=penalties,
            iterations=iterations,
        )

    def cost(self, found: TwoWayMap) -> MapCost:
        """Return the cost of a map without the errors of landmarks."""
        return map_cost(self.a, self.b, found, self.descriptors, self.weights)

    def without_functions(self) -> Pair:
        (on_a, on_b), count = self.descriptors, self.a.descriptors.shape[1]
        descriptors = on_a[:, :count], on_b[:, :count]
        return self._replace(descriptors=descriptors, weights=self.weights[:count])

    def landmark_cost(self, found: TwoWayMap) -> float:
        """Return the mean landmark error of a map in sqrt(area), times `LANDMARK_WEIGHT`."""
        on_a, on_b = self.landmarks
        if not len(on_a):
            return 0.0
        gaps = self.a.distances[on_a, found.to_a[on_b]]
        return LANDMARK_WEIGHT * float(self.landmark_weights @ gaps)

    def distance(self, one: TwoWayMap, other: TwoWayMap) -> float:
        """Return the mean distance between the images of two maps, in sqrt(area)."""
        return float(self.b.areas @ self.a.distances[one.to_a, other.to_a])


class Start(NamedTuple):
    """A candidate for the initial map, before relaxation."""

    kind: str  # kind, one of `KINDS`
    side: int  # 1, or -1 for the mirror image
    coarse: Callable[[Pair], IntArray]  # returns the vertex of A for each of B on coarse meshes
    fine: Callable[[], Initial] | None = None  # returns the map on all vertices, if there is one
    is_exact: bool = False  # whether both surfaces are the same up to a motion

    @property
    def name(self) -> str:
        return self.kind if self.side > 0 else f"{self.kind}:mirror"


class Relaxed(NamedTuple):
    """A candidate for the initial map, after relaxation."""

    start: Start
    found: TwoWayMap  # map after relaxation
    cost: float  # cost by `parts` and landmarks, and of a mirrored map
    parts: MapCost
    moved: float  # mean distance between the maps before and after, in sqrt(area)


def search_initial_map(
    given: MapInput, kinds: Sequence[str] = KINDS, sides: Sequence[int] = (1, -1)
) -> Initial:
    """Return the best initial map of the given kinds and sides (1, or -1 for the mirror image).

    Raises AbfmError if no kind applies to the surfaces.
    """
    search = _Search(given)
    work = _FIXED_WORK + len(given.a.vertices) + len(given.b.vertices)
    with step("comparing initial maps", work) as done:
        fine = search.pair(_VERTICES)
        starts, refused = _starts(search, kinds, sides, lambda share: done(0.45 * share))
        if not starts:
            raise AbfmError("; ".join(refused))
        chosen = _screened(search.pair(_SCREENED_VERTICES), starts)
        done(0.65)
        tried = []
        for number, start in enumerate(chosen):
            tried.append(_relaxed(fine, start, both_sides=len(sides) > 1))
            done(0.65 + 0.15 * (number + 1) / len(chosen))
        tried.sort(key=lambda each: each.cost)
        best = _most_accurate(fine, tried)
        if best.start.fine is not None and best.moved <= _SAME_MAP_DISTANCE:
            found = best.start.fine()
        else:
            found = make_continuous(given, search.polished(best))
    correspondence = found.correspondence.with_candidates(_candidates(best, tried))
    return Initial(correspondence, found.notes, tuple(_warnings(fine, best, tried)))


class _Search:
    """Two surfaces with the data for all candidates, computed on first use."""

    def __init__(self, given: MapInput) -> None:
        self.given = given

    def pair(self, count: int) -> Pair:
        a, b = coarse_shape(self.given.a, count), coarse_shape(self.given.b, count)
        on_a, on_b, weights = _functions(self.given, a, b)
        landmarks, landmark_weights = _landmarks(self.given, a, b)
        descriptors = np.hstack([a.descriptors, on_a]), np.hstack([b.descriptors, on_b])
        weights = np.concatenate([np.ones(a.descriptors.shape[1]), weights])
        return Pair(a, b, descriptors, weights, landmarks, landmark_weights)

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
        """Relax the best map further; return it on all vertices of B, with exact landmarks."""
        pair, given = self.pair(_VERTICES), self.given
        found = pair.relax(
            best.found, _POLISHING_PENALTIES, _POLISHING_DESCRIPTOR_WEIGHT, 2 * _ITERATIONS
        )
        images = _through_landmarks(pair, found.images)
        on_b = shape_values(pair.b, given.b, images)
        on_a = shape_values(pair.a, given.a, pair.a.coordinates)
        # a tree, because the matrix of all distances of two fine meshes needs too much memory
        return PointMap.of_vertices(given.b, given.a, KDTree(on_a).query(on_b)[1])


def shape_values(shape: CoarseShape, mesh: TriangleMesh, values: FloatArray) -> FloatArray:
    """Interpolate values (V, C) of a coarse shape to the vertices of its fine mesh."""
    return project_onto_surface(shape.mesh, mesh.normalized().vertices).pull_back(values)


def _functions(
    given: MapInput, a: CoarseShape, b: CoarseShape
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the ranks of functions on coarse surfaces, (V_A, C) and (V_B, C), and weights (C,).

    Weights decrease with the difference of the distributions on A and B; their sum is limited.
    """
    if given.f is None or given.g is None:
        return np.zeros((len(a.areas), 0)), np.zeros((len(b.areas), 0)), np.zeros(0)
    on_a, on_b = a.sampled(given.a, given.f.T), b.sampled(given.b, given.g.T)
    relative = (
        np.ones(len(given.f)) if given.weights is None else given.weights / given.weights.max()
    )
    weights = relative * _similarity(on_a, on_b, a.areas, b.areas)
    weights *= min(1.0, _FUNCTION_WEIGHT_MAX / max(weights.sum(), _FUNCTION_WEIGHT_MAX))
    return ranks(on_a, a.areas), ranks(on_b, b.areas), weights


def _similarity(
    on_a: FloatArray, on_b: FloatArray, areas_a: FloatArray, areas_b: FloatArray
) -> FloatArray:
    """Return the similarity, 0 to 1, of the distributions of functions (V_A, C) and (V_B, C).

    The similarity decreases with the Wasserstein distance of the standardized values.
    """
    # imported here, as it takes half a second to load
    from scipy.stats import wasserstein_distance

    def standardized(values: FloatArray, areas: FloatArray) -> FloatArray:
        values = values - areas @ values
        deviations = np.sqrt(areas @ values**2)
        return np.divide(values, deviations, out=np.zeros_like(values), where=deviations > 0)

    columns = zip(standardized(on_a, areas_a).T, standardized(on_b, areas_b).T, strict=True)
    gaps = [wasserstein_distance(f, g, areas_a, areas_b) for f, g in columns]
    return np.asarray(np.exp(-np.array(gaps) / _DISTRIBUTION_SCALE))


def _landmarks(
    given: MapInput, a: CoarseShape, b: CoarseShape
) -> tuple[tuple[IntArray, IntArray], FloatArray]:
    """Return the coarse vertices nearest to landmarks, and the weights of the landmarks."""
    pairs = given.landmarks
    if pairs is None:
        none = np.zeros(0, dtype=np.int64)
        return (none, none), np.zeros(0)
    on_a, on_b = (
        np.asarray(KDTree(shape.mesh.vertices).query(points.positions / mesh.length_scale)[1])
        for shape, points, mesh in ((a, pairs.a, given.a), (b, pairs.b, given.b))
    )
    return (on_a, on_b), pairs.weights / pairs.weights.sum()


def _through_landmarks(pair: Pair, images: FloatArray) -> FloatArray:
    """Move images (V_B, 8) smoothly so that landmarks of B are mapped to those of A."""
    on_a, on_b = pair.landmarks
    if not len(on_a):
        return images
    gaps = pair.a.coordinates[on_a] - images[on_b]
    near = np.exp(-((pair.b.distances[:, on_b] / _LANDMARK_WIDTH) ** 2) / 2)
    moves, *_ = np.linalg.lstsq(near[on_b] + 1e-6 * np.eye(len(on_b)), gaps, rcond=None)
    return np.asarray(images + near @ moves)


def _starts(
    search: _Search, kinds: Sequence[str], sides: Sequence[int], done: Callable[[float], None]
) -> tuple[list[Start], list[str]]:
    """Return the candidates of the given kinds and sides, and the reasons for missing kinds."""
    found: list[Start] = []
    refused: list[str] = []
    for number, (kind, side) in enumerate(product(kinds, sides), 1):
        checkpoint()
        try:
            found += _MAKERS[kind](search, side)
        except AbfmError as error:
            refused.append(f"{kind}: {error}")
        done(number / (len(kinds) * len(sides)))
    return found, list(dict.fromkeys(refused))


def _spectral_starts(search: _Search, side: int) -> Iterator[Start]:
    given, spectral = search.given, search.spectral
    ranked = spectral.ranked(side)
    on_side = [C for C in ranked if side * spectral.side(C) > 0]
    for C in (on_side or ranked)[:_SPECTRAL_MAPS]:

        def coarse(pair: Pair, C: FloatArray = C) -> IntArray:
            return spectral.nearest(C, pair.a.mesh.vertices, pair.b.mesh.vertices)

        def fine(C: FloatArray = C) -> Initial:
            return make_continuous(given, spectral.finished(C)[0])

        yield Start("spectral", side, coarse, fine)


def _extremity_starts(search: _Search, side: int) -> Iterator[Start]:
    pair = search.pair(_VERTICES)
    ends = extremities.extremities(pair.a), extremities.extremities(pair.b)
    if min(map(len, ends)) < extremities.ENDS_MIN:
        raise AbfmError(
            f"A has {len(ends[0])} ends of limbs, and B has {len(ends[1])}; expected at least "
            f"{extremities.ENDS_MIN} on both surfaces"
        )
    for on_a, on_b in extremities.matchings(pair.a, pair.b, *ends, _MATCHINGS_MAX):
        positions = pair.a.mesh.vertices[on_a], pair.b.mesh.vertices[on_b]
        yield Start("extremities", side, _by_positions(positions, side))


def _landmark_starts(search: _Search, side: int) -> Iterator[Start]:
    pairs = search.given.landmarks
    if pairs is None or len(pairs) < LANDMARKS_MIN:
        raise AbfmError(
            f"the number of landmarks is {0 if pairs is None else len(pairs)}; expected at least "
            f"{LANDMARKS_MIN}"
        )

    def coarse(pair: Pair) -> IntArray:
        return extremities.map_by_vertices(pair.a, pair.b, *pair.landmarks, side)

    yield Start("landmarks", side, coarse)


def _by_positions(
    positions: tuple[FloatArray, FloatArray], side: int
) -> Callable[[Pair], IntArray]:
    """Return a function that maps coarse surfaces by the distances to L matched points, (L, 3)."""

    def coarse(pair: Pair) -> IntArray:
        sides = zip(pair[:2], positions, strict=True)
        on_a, on_b = (np.asarray(KDTree(x.mesh.vertices).query(points)[1]) for x, points in sides)
        return extremities.map_by_vertices(pair.a, pair.b, on_a, on_b, side)

    return coarse


def _closest_starts(search: _Search, side: int) -> Iterator[Start]:
    given = search.given
    kind: MotionKind = "similarity" if side > 0 else "mirror"
    pair = search.pair(_VERTICES)
    landmarks = None if given.landmarks is None else _on_coarse(given.landmarks, pair)
    alignment = align(pair.a.mesh, pair.b.mesh, kind, landmarks)

    def coarse(pair: Pair) -> IntArray:
        positions = alignment(pair.b.mesh.vertices)
        return np.asarray(KDTree(pair.a.mesh.vertices).query(positions)[1])

    def fine() -> Initial:
        points, _ = closest_after_alignment(given.a, given.b, kind, given.landmarks)
        return make_continuous(given, points)

    yield Start("closest", side, coarse, fine, alignment.rms <= _SAME_SURFACE_DISTANCE)


def _on_coarse(landmarks: Landmarks, pair: Pair) -> Landmarks:
    a, b = (
        project_onto_surface(shape.mesh, points.positions / points.mesh.length_scale)
        for shape, points in ((pair.a, landmarks.a), (pair.b, landmarks.b))
    )
    return Landmarks(a, b, landmarks.weights, landmarks.names)


def _embedding_starts(search: _Search, side: int) -> Iterator[Start]:
    given, pair = search.given, search.pair(_VERTICES)
    mirror = np.array([side, 1, 1])
    on_a, on_b = (sphere_embedding(shape.mesh) for shape in pair[:2])
    layouts = SphereLayout(pair.a.mesh, on_a * mirror), SphereLayout(pair.b.mesh, on_b)
    if given.landmarks is not None and len(given.landmarks) >= LANDMARKS_MIN:
        rotation = rotation_by_landmarks(*layouts, _on_coarse(given.landmarks, pair))
    else:
        sides = zip(layouts, pair.descriptors, strict=True)
        sphere_a, sphere_b = (SphereFunctions(layout, values.T) for layout, values in sides)
        rotation = rotation_by_functions(sphere_a, sphere_b, pair.weights, is_rough=True)
    if rotation is not None:
        on_a = on_a @ np.diag(mirror) @ rotation.rotation.as_matrix().T

    def coarse(other: Pair) -> IntArray:
        places = [
            project_onto_surface(shape.mesh, coarser.mesh.vertices).pull_back(directions)
            for shape, coarser, directions in zip(pair[:2], other[:2], (on_a, on_b), strict=True)
        ]
        return nearest(places[1], places[0])

    def fine() -> Initial:
        sides = zip(pair[:2], given[:2], pair.descriptors, strict=True)
        f, g = (shape_values(shape, mesh, values).T for shape, mesh, values in sides)
        full = given._replace(f=f, g=g, weights=pair.weights)
        return map_through_spheres(full, sphere_of(given.a), sphere_of(given.b), side < 0)

    yield Start("embedding", side, coarse, fine)


_MAKERS: dict[str, Callable[[_Search, int], Iterable[Start]]] = {
    "spectral": _spectral_starts,
    "extremities": _extremity_starts,
    "embedding": _embedding_starts,
    "closest": _closest_starts,
    "landmarks": _landmark_starts,
}


def _screened(pair: Pair, starts: list[Start]) -> list[Start]:
    """Return the candidates, with only the best four matchings of extremities for each side."""
    costs: dict[int, float] = {}
    for number, start in enumerate(starts):
        if start.kind == "extremities":
            checkpoint()
            first = two_way_map(pair.a, pair.b, start.coarse(pair))
            found = pair.relax(first, _SCREENING_PENALTIES, _DESCRIPTOR_WEIGHT, _ITERATIONS)
            parts = pair.cost(found)._replace(commutator=0.0)
            costs[number] = parts.total(start.side) + pair.landmark_cost(found)
    best = []
    for side in (1, -1):
        on_side = [number for number in costs if starts[number].side == side]
        best += sorted(on_side, key=lambda number: costs[number])[:_RELAXED_MATCHINGS]
    return [start for number, start in enumerate(starts) if number not in costs or number in best]


def _relaxed(pair: Pair, start: Start, both_sides: bool) -> Relaxed:
    checkpoint()
    first = two_way_map(pair.a, pair.b, start.coarse(pair))
    found = pair.relax(first, _PENALTIES, _DESCRIPTOR_WEIGHT, _ITERATIONS)
    parts = pair.cost(found)
    cost = parts.total(start.side) + pair.landmark_cost(found)
    if both_sides and start.side < 0:
        cost += _MIRROR_COST
    return Relaxed(start, found, cost, parts, pair.distance(first, found))


def _most_accurate(pair: Pair, tried: list[Relaxed]) -> Relaxed:
    """Return the most accurate of the candidates whose maps nearly agree with the best one.

    A candidate by the alignment of congruent surfaces is preferred, then one by eigenfunctions.
    """
    best = tried[0]
    equivalent = [
        each
        for each in tried
        if each.start.fine is not None
        and each.cost < best.cost + _COST_TIE
        and each.start.side == best.start.side
        and pair.distance(best.found, each.found) <= _SAME_MAP_DISTANCE
    ]

    def rank(each: Relaxed) -> tuple[bool, bool, float]:
        return not each.start.is_exact, each.start.kind != "spectral", each.moved

    return min(equivalent, key=rank, default=best)


def _warnings(pair: Pair, best: Relaxed, tried: list[Relaxed]) -> list[str]:
    found = []
    cost = pair.without_functions().cost(best.found).total(best.start.side)
    if cost > _COST_MAX or best.parts.side * best.start.side < _SIDE_MIN:
        found.append(
            "no candidate for the initial map is plausible. The best one is by the method "
            f"{best.start.name}. Without the functions, it has a cost of {cost:.2f} (plausible: at "
            f"most {_COST_MAX:g}), or the wrong orientation on much of the surface"
        )

    def is_other(each: Relaxed) -> bool:
        return pair.distance(best.found, each.found) > _OTHER_MAP_DISTANCE

    same_side = [each for each in tried if each.start.side == best.start.side]
    rival = next(filter(is_other, same_side), None)
    if rival is not None and rival.cost < best.cost + _COST_TIE:
        found.append(
            f"a different map by the method {rival.start.name} is nearly as good (cost "
            f"{rival.cost:.2f}, chosen map {best.cost:.2f}), for example because front and back "
            "are similar. Use landmarks to distinguish them"
        )
    return found


def _candidates(best: Relaxed, tried: list[Relaxed]) -> tuple[Candidate, ...]:
    """Return the best candidate of each name, starting with the chosen one."""
    found = {best.start.name: Candidate(best.start.name, best.cost)}
    for each in tried:
        found.setdefault(each.start.name, Candidate(each.start.name, each.cost))
    return tuple(found.values())
