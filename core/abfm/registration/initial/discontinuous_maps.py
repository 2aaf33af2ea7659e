"""Torn maps made continuous."""

from __future__ import annotations

from dataclasses import replace

from abfm.maps.continuous_map import continuous_map
from abfm.maps.point_maps import PointMap
from abfm.registration.correspondence import Correspondence
from abfm.registration.initial.map_input import Initial, MapInput

_SIDE_MIN = 0.5  # share of the area on one side, less that on the other one


def make_continuous(
    given: MapInput, points: PointMap, notes: tuple[str, ...] = (), warnings: tuple[str, ...] = ()
) -> Initial:
    """Return a map that may be torn, made continuous if neither surface has handles."""
    # between vertices as files keep it
    points = replace(points, interior_map=None)
    torn = Correspondence(points)
    distortion, faces = torn.distortion(), len(given.b.faces)
    share = (distortion.flipped | (distortion.area <= 0)).sum() / faces
    if share == 0:
        return Initial(torn, notes, warnings)
    torn_words = f"it turns over or collapses {100 * share:.2g}% of the faces"
    if given.a.genus or given.b.genus:
        return Initial(torn, (*notes, f"the initial map is torn: {torn_words}"), warnings)
    if torn.is_mirrored:
        points = points.onto_mirror()
    found = Correspondence.through_sphere(given.a, given.b, *continuous_map(points))
    notes = (*notes, f"the initial map was made continuous, as {torn_words}")
    kept = 1 - 2 * distortion.weights[distortion.flipped].sum() / distortion.weights.sum()
    if kept < _SIDE_MIN:
        notes = (*notes, f"it turns over {50 * (1 - kept):.2g}% of the area before that")
    return Initial(found, notes, warnings)
