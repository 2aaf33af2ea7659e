"""Repair of discontinuous initial maps."""

from __future__ import annotations

from dataclasses import replace

from abfm.maps.continuous_map import continuous_map
from abfm.maps.point_maps import PointMap
from abfm.registration.correspondence import Correspondence
from abfm.registration.initial.map_input import Initial, MapInput

_FLIPPED_SHARE_MAX = 0.25  # share of the area; a note reports a larger share that was flipped


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
    faults = f"flipped or collapsed {100 * share:.2g}% of the faces"
    if given.a.genus or given.b.genus:
        note = f"the initial map remains discontinuous, as a surface has handles; it {faults}"
        return Initial(original, (*notes, note), warnings)
    if original.is_mirrored:
        points = points.onto_mirror()
    found = Correspondence.through_sphere(given.a, given.b, *continuous_map(points))
    flipped = distortion.weights[distortion.flipped].sum() / distortion.weights.sum()
    if flipped > _FLIPPED_SHARE_MAX:
        faults += f", with {100 * flipped:.2g}% of the area flipped"
    note = f"the initial map was made continuous; before, it {faults}"
    return Initial(found, (*notes, note), warnings)
