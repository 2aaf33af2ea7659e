"""The initial map of two surfaces of which nothing is known but a few landmarks."""

from __future__ import annotations

import numpy as np

from abfm.calculus.operators import face_areas
from abfm.errors import AbfmError
from abfm.maps.point_maps import PointMap
from abfm.mesh import TriangleMesh
from abfm.registration.initial.alignment import Kind, closest_after_alignment
from abfm.registration.initial.landmark_pairs import Landmarks
from abfm.registration.initial.spectral import LEAST, functional_map_start

FEWEST = 3
_PER_GAP = 10.0  # of the share of area that is lost, for a distance of sqrt(area) at landmarks


def map_from_landmarks(
    a: TriangleMesh, b: TriangleMesh, landmarks: Landmarks, mirrored: bool = False
) -> PointMap:
    """Return the better of two maps from B to A, by the eigenfunctions of both surfaces and to the
    closest points after they are aligned: the one that loses least area and brings landmarks
    nearest to where they belong, 0.1 sqrt(area) there counting as much as all of the area.

    The first is the right one for other poses, the second for the same one. Meshes too coarse for
    eigenfunctions are aligned. ``mirrored`` says that B is like the mirror image of A.

    Raises
    ------
    AbfmError
        If there are fewer than three landmarks.
    """
    if len(landmarks) < FEWEST:
        raise AbfmError(
            f"{len(landmarks)} landmarks were given; expected {FEWEST} or more: add some, or "
            "choose a map by eigenfunctions, which fewer landmarks help, too"
        )
    kind: Kind = "mirror" if mirrored else "similarity"
    maps = [closest_after_alignment(a, b, kind, landmarks)[0]]
    if min(len(a.vertices), len(b.vertices)) >= LEAST:
        maps.append(functional_map_start(a, b, landmarks, mirrored=mirrored)[0])
    return min(maps, key=lambda points: loss(points, landmarks))


def loss(points: PointMap, landmarks: Landmarks) -> float:
    """Return what a map loses: the share of area, 0 to 1, and `_PER_GAP` times how far landmarks
    of B land from those of A, on average, in sqrt(area).

    A face keeps the smaller one of its area and that of its image, over the larger one, on surfaces
    of equal area.
    """
    landed = points.at(landmarks.b)
    gaps = landed.distances_from(landmarks.a.positions) / points.codomain.length_scale
    own = face_areas(points.domain) / points.domain.length_scale**2
    corners = points.positions[points.domain.faces] / points.codomain.length_scale
    mapped = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    image = np.linalg.norm(mapped, axis=1) / 2
    kept = np.minimum(own, image) / np.maximum(own, image)
    return float(own @ (1 - kept) + _PER_GAP * np.average(gaps, weights=landmarks.weights))
