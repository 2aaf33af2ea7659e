"""The flow that is shown: its field, mesh, parameters and range of times."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

import abfm
from abfm import Parameters, TriangleMesh
from abfm.types import FloatArray
from abfm_viewer.document.document import EXTRAPOLATION

_VALUE_MAX = 1e37  # largest value that is shown, because of single precision
_SEQUENCE_LINE = 0.5  # length of flow lines of sequences, in sqrt(area)


@dataclass(frozen=True, eq=False)
class FlowState:
    """A field and the data of its flow; two states are equal only if they are the same object.

    ``field`` has shape (N, 4^k F, 3) for N consecutive fields on the mesh subdivided k times. It is
    (F, 3) for an interval of a sequence. It may also be a slow function that returns the field.
    """

    mesh: TriangleMesh
    field: FloatArray | Callable[[], FloatArray]
    parameters: Parameters
    final: bool = True  # whether this is a result, not an iterate
    problem: abfm.Problem | None = None  # the solved problem, with its source on finer meshes
    fields: int = 1  # N, used while the field is not yet read
    initial: abfm.maps.PointMap | None = None  # initial map of two surfaces, from B to A
    reach: float = EXTRAPOLATION  # length of the time bar, in units of tau
    motion: float = 1.0  # share of motion in interpolated frames of a sequence, 0 to 1

    @property
    def count(self) -> int:
        """Number N of consecutive fields."""
        is_here = not callable(self.field) and self.field.ndim == 3
        return len(self.field) if is_here and not callable(self.field) else self.fields

    @cached_property
    def flow(self) -> abfm.Flow:
        """The flow of the field; reading it may be slow, so drawing code must not read it."""
        field = self.field() if callable(self.field) else self.field
        return abfm.Flow(self.mesh, field, self.parameters.tau, self.parameters.paper.method)

    @property
    def duration(self) -> float:
        """Length of the time bar, in the flow's unit of time."""
        return self.reach * self.parameters.tau

    @property
    def line_time(self) -> float:
        """Duration of flow lines in each direction, in the flow's unit of time; tau for a match.

        The intervals of a sequence are too short for this. There, a point at the root mean square
        speed moves by half of sqrt(area) in this time.
        """
        if self.reach == EXTRAPOLATION:
            return self.parameters.tau
        rms = float(np.sqrt(np.mean((self.velocity**2).sum(axis=-1))))
        return _SEQUENCE_LINE * self.mesh.length_scale / rms if rms > 0 else self.parameters.tau

    @property
    def velocity(self) -> FloatArray:
        """The fields on the mesh itself, (N, F, 3). Reading them may be slow, see `flow`."""
        return self.flow.velocity

    def origins(self, places: FloatArray, times: FloatArray) -> FloatArray:
        """Return the start, at time 0, of the points that are at the vertices at ``times`` (T,).

        The result (T, V, 3) is on surface A if there are two. ``places`` (V, 3) is used only for
        its shape.
        """
        maps, first = self.flow.point_maps(times), self.initial
        found = [(each if first is None else each.followed_by(first)).positions for each in maps]
        return np.array(found).reshape(len(times), *places.shape)

    def destinations(self, places: FloatArray, times: FloatArray) -> FloatArray:
        """Return the positions (T, V, 3) at ``times`` (T,) of points that start at the vertices."""
        found = [points.positions for points in self.flow.point_maps(times, inverse=True)]
        return np.array(found).reshape(len(times), *places.shape)

    def advect(self, function: FloatArray, times: FloatArray) -> FloatArray:
        """Return a function (V,) or (V, C) advected to ``times``, (T, V) or (T, V, C)."""
        advected = self._advected(function, times)
        if np.abs(advected).max() > _VALUE_MAX:
            raise abfm.AdvectionError(
                "the advected function overflows: the discrete flow is unstable. Use a shorter time"
            )
        return advected

    def _advected(self, function: FloatArray, times: FloatArray) -> FloatArray:
        """Advect a function; the source of a match is advected on the finer mesh, if any."""
        flow = self.flow
        channels = () if self.problem is None or not flow.refined else self.problem.source.T
        for channel, source in enumerate(channels):
            if self.problem is not None and np.array_equal(source, function):
                there = self.problem.refined(flow.refined)
                fine = abfm.Flow(flow.fine_mesh, flow.fine_velocity, flow.tau, flow.method)
                return fine.push(there.source[:, channel], times)[:, : len(function)]
        return flow.push(function, times)
