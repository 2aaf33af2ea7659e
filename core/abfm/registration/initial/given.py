"""What an initial map may be found by, and torn maps made continuous."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from abfm.maps.continuous_map import continuous_map
from abfm.maps.point_maps import PointMap
from abfm.mesh import TriangleMesh
from abfm.registration.correspondence import Correspondence
from abfm.registration.initial.landmark_pairs import Landmarks
from abfm.types import FloatArray

_SIDE_MIN = 0.5  # share of the area on one side, less that on the other one


class MapInput(NamedTuple):
    """Two surfaces, functions on both, (C, V_A) and (C, V_B), and how much what of them counts."""

    a: TriangleMesh
    b: TriangleMesh
    f: FloatArray | None = None
    g: FloatArray | None = None
    mask_a: FloatArray | None = None  # (V_A,)
    mask_b: FloatArray | None = None  # (V_B,)
    weights: FloatArray | None = None  # (C,)
    landmarks: Landmarks | None = None


class Initial(NamedTuple):
    """An initial map; notes and warnings are a line each.

    Notes report how it was found. Warnings report why it may lead elsewhere: what begins with such
    a map is not registered, see `Registration.verdict`.
    """

    correspondence: Correspondence
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def made_continuous(given: MapInput, points: PointMap, notes: tuple[str, ...] = ()) -> Initial:
    """Return a map that may be torn, made continuous if neither surface has handles."""
    # between vertices as files keep it
    points = replace(points, carried=None)
    torn = Correspondence(points)
    distortion, faces = torn.distortion(), len(given.b.faces)
    share = (distortion.flipped | (distortion.area <= 0)).sum() / faces
    if share == 0:
        return Initial(torn, notes)
    torn_words = f"it turns over or collapses {100 * share:.2g}% of the faces"
    if given.a.genus or given.b.genus:
        return Initial(torn, (*notes, f"the initial map is torn: {torn_words}"))
    if torn.is_mirrored:
        points = points.onto_mirror()
    found = Correspondence.through_sphere(given.a, given.b, *continuous_map(points))
    notes = (*notes, f"the initial map was made continuous, as {torn_words}")
    kept = 1 - 2 * distortion.weights[distortion.flipped].sum() / distortion.weights.sum()
    if kept < _SIDE_MIN:
        notes = (*notes, f"it turns over {50 * (1 - kept):.2g}% of the area before that")
    return Initial(found, notes)
