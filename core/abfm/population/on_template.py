"""A subject on the template: where its points lie, what it has there, and what its map does."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np

from abfm.flow.continuous_flow import ContinuousFlow
from abfm.io import results
from abfm.maps.distortion import Map
from abfm.maps.point_maps import PointMap
from abfm.maps.surface_points import SurfacePoints, vertex_points
from abfm.mesh import TriangleMesh
from abfm.population.misfits import Likeness
from abfm.reading import from_json
from abfm.registration import Registration
from abfm.registration.correspondence import Correspondence
from abfm.types import FloatArray

Shift: TypeAlias = Callable[[SurfacePoints], SurfacePoints]
"""Where on the template its points come from, before a mean field was taken off."""
_LEAST_LOG2, _MOST_LOG2 = 2.0**-20, 2.0**20  # of changes of areas whose logarithm is told


class OnTemplate(NamedTuple):
    """What of a subject is known on the template, by one map."""

    values: FloatArray  # (V, C), NaN where unknown
    mask: FloatArray  # (V,)


class Own(NamedTuple):
    """A subject's own surface, values (V_A, C), NaN where unknown, and mask (V_A,)."""

    mesh: TriangleMesh
    values: FloatArray
    mask: FloatArray


class Registered(NamedTuple):
    """A subject, by its initial map and registered."""

    before: OnTemplate
    after: OnTemplate
    log2_area: FloatArray  # (F,)
    folded: float
    verdict: str
    mismatch: float

    def likeness(self, areas: FloatArray) -> Likeness:
        """Return what its map says of whether it fits, by areas of faces (F,)."""
        changed = float(np.average(np.abs(self.log2_area), weights=areas))
        return Likeness(math.nan, math.nan, changed, self.folded)


def registered(found: Registration, own: Own, template: TriangleMesh, shift: Shift) -> Registered:
    """Carry a subject by its maps, and measure what they do."""
    before, after = maps(found, own, template, shift)
    there = after(vertex_points(template))
    whole = Correspondence(
        PointMap(template, own.mesh, there.faces, there.barycentric, carried=after)
    )
    ratios = np.clip(whole.distortion().area, _LEAST_LOG2, _MOST_LOG2)
    return Registered(
        carried(before(vertex_points(template)), own),
        carried(there, own),
        np.log2(ratios),
        found.match.folded,
        found.match.verdict.kind,
        found.match.confirmed_mismatch,
    )


def maps(found: Registration, own: Own, template: TriangleMesh, shift: Shift) -> tuple[Map, Map]:
    """Return where on a subject points of the template lie: by the initial map, and along the mean
    field, back along the subject's flow, and then by that.
    """
    match, initial = found.match, found.initial.between(own.mesh, template)
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


def stacked(found: Sequence[OnTemplate]) -> tuple[FloatArray, FloatArray]:
    """Return values (N, V, C) and masks (N, V) of N subjects."""
    return np.stack([each.values for each in found]), np.stack([each.mask for each in found])


def mean_field(path: Path) -> FloatArray:
    """Return the displacement per unit of time 1, (F, 3), of a registration's file: its fields'
    mean over time, times tau.
    """
    with results.open_archive(path, results.REGISTRATION.name, results.MEND) as archive:
        fields, parameters = archive["velocity"], str(archive["parameters"])
    tau = float(from_json(parameters)["tau"])
    return np.asarray(tau * fields.mean(axis=0))
