"""The map through spheres, A's turned so that functions or landmarks agree."""

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

LANDMARKS_MIN = 3
"""Number of landmarks without which they are no start."""
LANDMARK_WEIGHT = 5.0  # of a distance of sqrt(area) in the cost of a map
# correlations by which maps must be better than vertex numbers, and mirrored ones than others:
# subjects on one mesh are mostly aligned already
_TURN_COST = 0.4
_MIRROR_COST = 0.1
_RIVAL_RATIO = 0.9  # of a correlation, from which on another rotation is as good
_CORRELATION_MIN = 0.3  # of functions on spheres that correspond

sphere_of = per_mesh(sphere_embedding)  # kept, as functions may change


def best_of_spheres(given: MapInput, sides: Sequence[int]) -> Initial:
    """Return the best map of two spheres: by vertex numbers if they have the same faces, or by a
    rotation, of either side (1, or -1 for the mirror image). Rotations are not searched if none
    could be better than vertex numbers.
    """
    found: list[tuple[str, Initial]] = []
    if 1 in sides and np.array_equal(given.a.faces, given.b.faces):
        same = Correspondence.of_same_faces(given.a, given.b)
        cost = _cost(given, same)
        if cost <= _TURN_COST:
            return Initial(same.with_candidates((Candidate("connectivity", cost),)))
        found.append(("connectivity", Initial(same)))
    directions = sphere_directions(given.a), sphere_directions(given.b)
    marks = given.landmarks
    if given.f is not None and marks is not None and len(marks) >= LANDMARKS_MIN:
        for side in sides:
            name = "landmarks" if side > 0 else "landmarks:mirror"
            found.append((name, turned(given._replace(f=None, g=None), *directions, side < 0)))
    for side in sides:
        name = "sphere" if side > 0 else "sphere:mirror"
        found.append((name, turned(given, *directions, side < 0)))
    costs = [_cost(given, initial.correspondence) for _, initial in found]
    has_same_faces = found[0][0] == "connectivity"
    for number, (name, _) in enumerate(found):
        costs[number] += (has_same_faces and number > 0) * _TURN_COST
        costs[number] += name.endswith(":mirror") * _MIRROR_COST
    order = np.argsort(costs, kind="stable")
    candidates = tuple(Candidate(found[number][0], costs[number]) for number in order)
    best: Initial = found[int(order[0])][1]
    return best._replace(correspondence=best.correspondence.with_candidates(candidates))


def _cost(given: MapInput, found: Correspondence) -> float:
    """Return 1 less the mean correlation of the functions, of any sign, and the mean distance of
    landmarks from their places, in sqrt(area), times a weight.
    """
    cost, marks = 0.0, given.landmarks
    if marks is not None:
        gaps = found.points.at(marks.b).distances_from(marks.a.positions)
        mean = float(np.average(gaps, weights=marks.weights))
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
    alike = 1 - dissimilarity(found.transfer(given.f.T), given.g.T, areas / areas.sum())
    return cost + 1 - float(np.average(np.abs(alike), weights=given.weights))


def turned(given: MapInput, sphere_a: FloatArray, sphere_b: FloatArray, mirror: bool) -> Initial:
    """Return the map through spheres, A's (V_A, 3), maybe seen in a mirror, turned as it fits."""
    sphere_a = sphere_a * [-1, 1, 1] if mirror else sphere_a
    layouts = SphereLayout(given.a, sphere_a), SphereLayout(given.b, sphere_b)
    notes = [
        f"{len(layout.folded)} faces of sphere {name} lie the wrong way round"
        for name, layout in zip("AB", layouts, strict=True)
        if len(layout.folded)
    ]
    turned, warnings = _rotation(given, *layouts), list[str]()
    if turned is not None:
        sphere_a = sphere_a @ turned.rotation.as_matrix().T
        notes.append(_turned_words(turned))
        warnings += _ambiguities(turned)
    elif given.landmarks is not None and len(given.landmarks) >= LANDMARKS_MIN:
        notes.append(
            "sphere A was not turned: the landmarks are in one place, or in opposite ones; give "
            "three that are apart"
        )
    found = Correspondence.through_sphere(given.a, given.b, sphere_a, sphere_b)
    return Initial(found, tuple(notes), tuple(warnings))


def _rotation(given: MapInput, a: SphereLayout, b: SphereLayout) -> SphereRotation | None:
    if given.f is not None and given.g is not None:
        weights = np.ones(len(given.f)) if given.weights is None else given.weights
        on_a, on_b = (
            SphereFunctions(a, given.f, given.mask_a),
            SphereFunctions(b, given.g, given.mask_b),
        )
        return rotation_by_functions(on_a, on_b, weights)
    marks = given.landmarks
    return (
        None if marks is None or len(marks) < LANDMARKS_MIN else rotation_by_landmarks(a, b, marks)
    )


def _turned_words(turned: SphereRotation) -> str:
    note = f"sphere A was turned by {turned.degrees:.1f} degrees"
    if np.isnan(turned.correlation):
        return f"{note}, to the landmarks"
    return f"{note}: the functions correlate by {turned.correlation:.2f}"


def _ambiguities(turned: SphereRotation) -> list[str]:
    """Return why a rotation may be a wrong one."""
    warnings = []
    if turned.correlation < _CORRELATION_MIN:
        warnings.append(
            f"by the best rotation of the spheres the functions correlate by "
            f"{turned.correlation:.2f} only: the surfaces may not correspond"
        )
    if turned.runner_up > _RIVAL_RATIO:
        warnings.append(
            "another rotation is nearly as good: give more functions, or a map, to distinguish them"
        )
    return warnings
