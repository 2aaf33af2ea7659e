"""Values of a subject on the template, and measures of its map."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np

from abfm.calculus.operators import face_areas
from abfm.flow.continuous_flow import ContinuousFlow
from abfm.functions.missing_values import filled, known_functions
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
"""Function that moves points of the template along the flow of the mean field."""
# bounds of reported area ratios
_AREA_RATIO_MIN = 2.0**-20
_AREA_RATIO_MAX = 2.0**20


class TemplateValues(NamedTuple):
    """Values of a subject at V points of the template, transferred by a map."""

    values: FloatArray  # (V, C), NaN where unknown
    mask: FloatArray  # (V,), nonnegative weights


class SubjectData(NamedTuple):
    """Data of a subject on its mesh: values (V_A, C), NaN if unknown, and mask (V_A,)."""

    mesh: TriangleMesh
    values: FloatArray
    mask: FloatArray

    @classmethod
    def of(cls, mesh: TriangleMesh, texts: Sequence[str], mask: str | None) -> SubjectData:
        """Evaluate the functions of a subject, given as texts; an empty text is an unknown one.

        The mask is 0 where a function is NaN or the given mask is 0. The values there are filled
        from neighbouring vertices.
        """
        known_texts = [text for text in texts if text]
        weight = checked_mask(mesh, mask, "the subject")
        functions, known = known_functions(mesh, known_texts, "its functions", weight)
        values_of = dict(zip(known_texts, filled(mesh, functions, known), strict=True))
        unknown = np.full(len(mesh.vertices), np.nan)
        values = np.stack([values_of[text] if text else unknown for text in texts], axis=1)
        return cls(mesh, values, np.where(known, weight, 0))


class MapFacts(NamedTuple):
    """Measures of the map from the template to a subject; NaN if unknown."""

    folded: float = math.nan  # fraction of the faces, 0 to 1, folded by the flow
    # residual of the registration, the larger one of discrete and flow-line residual
    residual: float = math.nan
    # root mean square of the displacement minus the mean field, in sqrt(area)
    displacement: float = math.nan
    landmarks: float = math.nan  # mean error of landmarks, in sqrt(area)


def map_facts(
    found: Registration, points: PointMap, drift: FloatArray
) -> tuple[FloatArray, MapFacts]:
    """Return log2 J (change of area) of the template's faces, (F,), and the measures of a map.

    ``found`` is the registration of the subject. ``points`` is the map from the template to the
    subject. ``drift`` (F, 3) is the mean field that was subtracted from the registration's field.
    """
    template = points.domain
    ratios = Correspondence(points).distortion().area
    squares = ((displacement(found) - drift) ** 2).sum(axis=1)
    errors = found.landmark_errors
    numbers = (
        found.match.folded,
        found.match.worse_residual,
        math.sqrt(np.average(squares, weights=face_areas(template))) / template.length_scale,
        math.nan if errors is None else float(errors.mean()),
    )
    # infinite if flow lines are too long
    known = (number if math.isfinite(number) else math.nan for number in numbers)
    return np.log2(np.clip(ratios, _AREA_RATIO_MIN, _AREA_RATIO_MAX)), MapFacts(*known)


def maps(
    found: Registration, surface: TriangleMesh, template: TriangleMesh, shift: Shift
) -> tuple[SurfaceMap, SurfaceMap]:
    """Return the initial and the registered map from the template to a subject.

    The registered map follows the flow of the mean field (``shift``), then the flow of the subject
    backwards, and then the initial map.
    """
    match, initial = found.match, found.initial.on_surfaces(surface, template)
    lines = ContinuousFlow(template, match.fine_velocity, match.parameters.tau)
    return initial.points.at, lambda points: initial.points.at(lines.origins(shift(points)))


def values_at(points: SurfacePoints, subject: SubjectData) -> TemplateValues:
    values = np.full((len(points.faces), subject.values.shape[1]), np.nan)
    for c, each in enumerate(subject.values.T):
        if np.isfinite(each).any():
            values[:, c] = points.pull_back(each)
    return TemplateValues(values, np.clip(points.pull_back(subject.mask), 0, None))


def edge_midpoints(mesh: TriangleMesh) -> SurfacePoints:
    """Return the midpoints of edges, (E,), each as a point of one adjacent face."""
    slots = np.empty(len(mesh.edges), dtype=np.int64)
    slots[mesh.face_edges.ravel()] = np.arange(mesh.face_edges.size)
    faces, opposite = np.divmod(slots, 3)
    return SurfacePoints(mesh, faces, 0.5 - 0.5 * np.eye(3)[opposite])


def checked_mask(mesh: TriangleMesh, text: str | None, name: str) -> FloatArray:
    """Evaluate the specification of a mask, (V,), or return ones; messages use ``name``."""
    found = mask_from_input(mesh, text or None, f"the mask of {name}")
    return np.ones(len(mesh.vertices)) if found is None else found


def displacement(found: Registration) -> FloatArray:
    """Return the displacement by a registration, (F, 3): tau times the field's mean over time."""
    return np.asarray(found.match.parameters.tau * found.match.velocity.mean(axis=0))


def displacement_in(path: Path) -> FloatArray:
    """Return the `displacement` by the registration in a file, without loading the rest of it."""
    with results.open_archive(path, results.REGISTRATION.name, results.REMEDY) as archive:
        fields, parameters = archive["velocity"], str(archive["parameters"])
    tau = float(from_json(parameters)["tau"])
    return np.asarray(tau * fields.mean(axis=0))
