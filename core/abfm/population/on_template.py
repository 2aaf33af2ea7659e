"""A subject on the template: where its points lie, what it has there, and what its map does."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np

from abfm.calculus.operators import face_areas
from abfm.flow.continuous_flow import ContinuousFlow
from abfm.functions.known import filled, known_functions
from abfm.io import results
from abfm.maps.distortion import SurfaceMap
from abfm.maps.point_maps import PointMap
from abfm.maps.surface_points import SurfacePoints
from abfm.matching.terms.functions import mask_from_input
from abfm.mesh import TriangleMesh
from abfm.reading import from_json
from abfm.registration import Registration
from abfm.registration.correspondence import Correspondence
from abfm.types import FloatArray

Shift: TypeAlias = Callable[[SurfacePoints], SurfacePoints]
"""Where on the template its points come from, before a mean field was taken off."""
# of changes of areas whose logarithm is told
_LEAST_LOG2 = 2.0**-20
_MOST_LOG2 = 2.0**20


class OnTemplate(NamedTuple):
    """What of a subject is known on the template, by one map."""

    values: FloatArray  # (V, C), NaN where unknown
    mask: FloatArray  # (V,)


class Own(NamedTuple):
    """A subject's own surface, values (V_A, C), NaN where unknown, and mask (V_A,)."""

    mesh: TriangleMesh
    values: FloatArray
    mask: FloatArray

    @classmethod
    def of(cls, mesh: TriangleMesh, texts: Sequence[str], mask: str | None) -> Own:
        """Evaluate functions as texts, of which those that are unknown are empty. Vertices where
        one has NaN or the mask is 0 do not count, and values are filled in from around.
        """
        given = [text for text in texts if text]
        weight = checked_mask(mesh, mask, "it")
        functions, known = known_functions(mesh, given, "its functions", weight)
        own = dict(zip(given, filled(mesh, functions, known), strict=True))
        unknown = np.full(len(mesh.vertices), np.nan)
        values = np.stack([own[text] if text else unknown for text in texts], axis=1)
        return cls(mesh, values, np.where(known, weight, 0))


class MapFacts(NamedTuple):
    """What a subject's map does; NaN where it is unknown."""

    folded: float = math.nan  # share of the faces, 0 to 1, that its flow folds
    residual: float = math.nan  # of its registration, the larger one of both checks
    # root of the mean square of the field without the mean field, in sqrt(area)
    displacement: float = math.nan
    landmarks: float = math.nan  # how far they are left, on average, in sqrt(area)


def map_facts(
    found: Registration, points: PointMap, drift: FloatArray
) -> tuple[FloatArray, MapFacts]:
    """Return log2 J of the template's faces, (F,), by where its vertices lie on a subject, and what
    the map does, of which the mean field ``drift`` (F, 3) was taken off.
    """
    template = points.domain
    ratios = Correspondence(points).distortion().area
    squares = ((displacement(found) - drift) ** 2).sum(axis=1)
    left = found.landmark_errors
    numbers = (
        found.match.folded,
        found.match.worse_residual,
        math.sqrt(np.average(squares, weights=face_areas(template))) / template.length_scale,
        math.nan if left is None else float(left.mean()),
    )
    # as of flow lines that lead too far
    known = (number if math.isfinite(number) else math.nan for number in numbers)
    return np.log2(np.clip(ratios, _LEAST_LOG2, _MOST_LOG2)), MapFacts(*known)


def maps(
    found: Registration, surface: TriangleMesh, template: TriangleMesh, shift: Shift
) -> tuple[SurfaceMap, SurfaceMap]:
    """Return where on a subject points of the template lie: by the initial map, and along the mean
    field, back along the subject's flow, and then by that.
    """
    match, initial = found.match, found.initial.on_surfaces(surface, template)
    lines = ContinuousFlow(template, match.fine_velocity, match.parameters.tau)
    return initial.points.at, lambda points: initial.points.at(lines.origins(shift(points)))


def carried(there: SurfacePoints, own: Own) -> OnTemplate:
    """Return what a subject has where points (P,) lie on it."""
    values = np.full((len(there.faces), own.values.shape[1]), np.nan)
    for c, each in enumerate(own.values.T):
        if np.isfinite(each).any():
            values[:, c] = there.pull_back(each)
    return OnTemplate(values, np.clip(there.pull_back(own.mask), 0, None))


def edge_middles(mesh: TriangleMesh) -> SurfacePoints:
    """Return the middles of edges, (E,), each in one of its faces."""
    slots = np.empty(len(mesh.edges), dtype=np.int64)
    slots[mesh.face_edges.ravel()] = np.arange(mesh.face_edges.size)
    faces, opposite = np.divmod(slots, 3)
    return SurfacePoints(mesh, faces, 0.5 - 0.5 * np.eye(3)[opposite])


def checked_mask(mesh: TriangleMesh, text: str | None, whose: str) -> FloatArray:
    """Evaluate a mask (V,), 1 where there is none; a ParameterError says what is wrong with it."""
    found = mask_from_input(mesh, text or None, f"the mask of {whose}")
    return np.ones(len(mesh.vertices)) if found is None else found


def displacement(found: Registration) -> FloatArray:
    """Return the displacement per unit of time 1, (F, 3), of a registration's flow: its fields'
    mean over time, times tau.
    """
    return np.asarray(found.match.parameters.tau * found.match.velocity.mean(axis=0))


def displacement_in(path: Path) -> FloatArray:
    """Return the `displacement` of a registration's file, of which nothing else is read."""
    with results.open_archive(path, results.REGISTRATION.name, results.MEND) as archive:
        fields, parameters = archive["velocity"], str(archive["parameters"])
    tau = float(from_json(parameters)["tau"])
    return np.asarray(tau * fields.mean(axis=0))
