"""Repair of discontinuous initial maps."""

from __future__ import annotations

from dataclasses import replace

from abfm.maps.continuous_map import continuous_map
from abfm.maps.point_maps import PointMap
from abfm.registration.correspondence import Correspondence
from abfm.registration.initial.map_input import Initial, MapInput

_SIDE_MIN = 0.5  # least share of the area with one orientation minus that with the other


def make_continuous(
    given: MapInput, points: PointMap, notes: tuple[str, ...] = (), warnings: tuple[str, ...] = ()
) -> Initial:
    """Return an initial map, made continuous if it flips or collapses faces.

    If a surface has handles, such a map stays unchanged, and a note reports this. The result also
    contains the given ``notes`` and ``warnings``.
    """
    # files store no map inside faces
    points = replace(points, interior_map=None)
    original = Correspondence(points)
    distortion, faces = original.distortion(), len(given.b.faces)
    share = (distortion.flipped | (distortion.area <= 0)).sum() / faces
    if share == 0:
        return Initial(original, notes, warnings)
    fault = f"it flips or collapses {100 * share:.2g}% of the faces"
    if given.a.genus or given.b.genus:
        return Initial(original, (*notes, f"the initial map is discontinuous: {fault}"), warnings)
    if original.is_mirrored:
        points = points.onto_mirror()
    found = Correspondence.through_sphere(given.a, given.b, *continuous_map(points))
    notes = (*notes, f"the initial map was made continuous, as {fault}")
    side = 1 - 2 * distortion.weights[distortion.flipped].sum() / distortion.weights.sum()
    if side < _SIDE_MIN:
        notes = (*notes, f"before that, it flips {50 * (1 - side):.2g}% of the area")
    return Initial(found, notes, warnings)
