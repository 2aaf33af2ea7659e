"""Initial maps through spheres, after rotating A's sphere by functions or landmarks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from abfm.calculus.operators import vertex_areas
from abfm.maps.sphere_embedding import sphere_embedding
from abfm.maps.spherical import SphereLayout, sphere_directions
from abfm.mesh import per_mesh
from abfm.registration.correspondence import Candidate, Correspondence
from abfm.registration.initial.descriptors import dissimilarity
from abfm.registration.initial.map_input import Initial, MapInput
from abfm.registration.initial.sphere_rotations import (
    SphereFunctions,
    SphereRotation,
    rotation_by_functions,
    rotation_by_landmarks,
)
from abfm.types import FloatArray
from abfm.wording import counted

LANDMARKS_MIN = 3  # smallest number of landmarks that determine an initial map
LANDMARK_WEIGHT = 5.0  # cost of a mean landmark error of sqrt(area)
# Costs in units of correlation. Subjects on the same mesh are mostly aligned already, so another
# map must be clearly better than that by vertex numbers.
_ROTATION_COST = 0.4
_MIRROR_COST = 0.1
_RIVAL_RATIO = 0.9  # another rotation with this share of the best correlation is also good
_CORRELATION_MIN = 0.3  # least correlation of functions on corresponding spheres

sphere_of = per_mesh(sphere_embedding)  # cached with the mesh, for calls with other functions


def best_of_spheres(given: MapInput, sides: Sequence[int]) -> Initial:
    """Return the best initial map between two spheres.

    One candidate is the map by vertex numbers, if both spheres have the same faces. The others
    rotate sphere A to fit the functions or the landmarks, for each of the ``sides``: 1, or -1 for
    the mirror image. They are not searched if the cost of the map by vertex numbers is small.
    """
    found: list[tuple[str, Initial]] = []
    if 1 in sides and np.array_equal(given.a.faces, given.b.faces):
        same = Correspondence.of_same_faces(given.a, given.b)
        cost = _cost(given, same)
        if cost <= _ROTATION_COST:
            return Initial(same.with_candidates((Candidate("connectivity", cost),)))
        found.append(("connectivity", Initial(same)))
    directions = sphere_directions(given.a), sphere_directions(given.b)
    pairs = given.landmarks
    if given.f is not None and pairs is not None and len(pairs) >= LANDMARKS_MIN:
        without_functions = given._replace(f=None, g=None)
        for side in sides:
            name = "landmarks" if side > 0 else "landmarks:mirror"
            found.append((name, map_through_spheres(without_functions, *directions, side < 0)))
    for side in sides:
        name = "sphere" if side > 0 else "sphere:mirror"
        found.append((name, map_through_spheres(given, *directions, side < 0)))
    costs = [_cost(given, initial.correspondence) for _, initial in found]
    has_same_faces = found[0][0] == "connectivity"
    for number, (name, _) in enumerate(found):
        costs[number] += (has_same_faces and number > 0) * _ROTATION_COST
        costs[number] += name.endswith(":mirror") * _MIRROR_COST
    order = np.argsort(costs, kind="stable")
    candidates = tuple(Candidate(found[number][0], costs[number]) for number in order)
    best: Initial = found[int(order[0])][1]
    return best._replace(correspondence=best.correspondence.with_candidates(candidates))


def _cost(given: MapInput, found: Correspondence) -> float:
    """Return the cost of a map by functions and landmarks.

    The cost is 1 minus the mean absolute correlation of the functions, plus `LANDMARK_WEIGHT` times
    the mean error of the landmarks in sqrt(area).
    """
    cost, pairs = 0.0, given.landmarks
    if pairs is not None:
        gaps = found.points.at(pairs.b).distances_from(pairs.a.positions)
        mean = float(np.average(gaps, weights=pairs.weights))
        cost += LANDMARK_WEIGHT * mean / given.a.length_scale
    if given.f is None or given.g is None:
        return cost
    areas = vertex_areas(given.b)
    if given.mask_b is not None:
        areas = areas * given.mask_b
    if given.mask_a is not None:
        areas = areas * np.clip(found.transfer(given.mask_a), 0, None)
    if not areas.any():
        return cost + 1
    correlations = 1 - dissimilarity(found.transfer(given.f.T), given.g.T, areas / areas.sum())
    return cost + 1 - float(np.average(np.abs(correlations), weights=given.weights))


def map_through_spheres(
    given: MapInput, sphere_a: FloatArray, sphere_b: FloatArray, mirror: bool
) -> Initial:
    """Return the map through spheres (V_A, 3) and (V_B, 3), with the best rotation of A's sphere.

    With ``mirror`` A's sphere is reflected first.
    """
    sphere_a = sphere_a * [-1, 1, 1] if mirror else sphere_a
    layouts = SphereLayout(given.a, sphere_a), SphereLayout(given.b, sphere_b)
    notes = [
        f"the sphere of {name} has {counted(len(layout.folded), 'flipped face')}"
        for name, layout in zip("AB", layouts, strict=True)
        if len(layout.folded)
    ]
    best, warnings = _rotation(given, *layouts), list[str]()
    if best is not None:
        sphere_a = sphere_a @ best.rotation.as_matrix().T
        by_functions = f"; the correlation of the functions is {best.correlation:.2f}"
        reason = " to fit the landmarks" if np.isnan(best.correlation) else by_functions
        notes.append(f"sphere A was rotated by {best.degrees:.1f} degrees{reason}")
        warnings += _ambiguities(best)
    elif given.landmarks is not None and len(given.landmarks) >= LANDMARKS_MIN:
        notes.append(
            "sphere A was not rotated, as all landmarks are near one point or near two opposite "
            "points; use three landmarks in different directions"
        )
    found = Correspondence.through_sphere(given.a, given.b, sphere_a, sphere_b)
    return Initial(found, tuple(notes), tuple(warnings))


def _rotation(given: MapInput, a: SphereLayout, b: SphereLayout) -> SphereRotation | None:
    if given.f is not None and given.g is not None:
        weights = np.ones(len(given.f)) if given.weights is None else given.weights
        on_a = SphereFunctions(a, given.f, given.mask_a)
        on_b = SphereFunctions(b, given.g, given.mask_b)
        return rotation_by_functions(on_a, on_b, weights)
    pairs = given.landmarks
    return (
        None if pairs is None or len(pairs) < LANDMARKS_MIN else rotation_by_landmarks(a, b, pairs)
    )


def _ambiguities(found: SphereRotation) -> list[str]:
    warnings = []
    if found.correlation < _CORRELATION_MIN:
        warnings.append(
            f"the surfaces may not correspond: with the best rotation of the spheres the "
            f"correlation of the functions is {found.correlation:.2f}, below {_CORRELATION_MIN:g}"
        )
    if found.runner_up > _RIVAL_RATIO:
        warnings.append(
            "another rotation of sphere A fits the functions nearly as well as the best one. Use "
            "more functions, or another initial map, to distinguish the two"
        )
    return warnings
