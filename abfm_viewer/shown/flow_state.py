"""A flow that is shown, with what it is a flow of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

import abfm
from abfm import Parameters, TriangleMesh
from abfm.types import FloatArray
from abfm_viewer.document.document import EXTRAPOLATION

_VALUE_MAX = 1e37  # that can be shown in single precision
_SEQUENCE_LINE = 0.5  # of sqrt(area)


@dataclass(frozen=True, eq=False)
class FlowState:
    """A field (N, 4^k F, 3), of the mesh subdivided k times, or what reads it, which takes a while,
    or one (F, 3) of a film's interval; the same only if one object.
    """

    mesh: TriangleMesh
    found: FloatArray | Callable[[], FloatArray]
    parameters: Parameters
    final: bool = True  # a result, and not an iterate
    problem: abfm.Problem | None = None  # that was solved, whose source is known on finer meshes
    fields: int = 1  # in a row, N, as far as they are still to be read
    initial: abfm.maps.PointMap | None = None  # of two surfaces: where B's points lie on A
    reach: float = EXTRAPOLATION  # how long the time bar is, in units of tau
    motion: float = 1.0  # its share in the frames between two of a sequence

    @property
    def count(self) -> int:
        """How many fields there are in a row, N."""
        is_here = not callable(self.found) and self.found.ndim == 3
        return len(self.found) if is_here and not callable(self.found) else self.fields

    @cached_property
    def flow(self) -> abfm.Flow:
        """The flow; not to be asked for in the frame loop."""
        found = self.found() if callable(self.found) else self.found
        return abfm.Flow(self.mesh, found, self.parameters.tau, self.parameters.paper.method)

    @property
    def duration(self) -> float:
        """How long the time bar is."""
        return self.reach * self.parameters.tau

    @property
    def line_time(self) -> float:
        """How long flow lines of the field are, one way: tau; of a film, whose steps are short,
        half of sqrt(area) at the usual speed.
        """
        if self.reach == EXTRAPOLATION:
            return self.parameters.tau
        usual = float(np.sqrt(np.mean((self.velocity**2).sum(axis=-1))))
        return _SEQUENCE_LINE * self.mesh.length_scale / usual if usual > 0 else self.parameters.tau

    @property
    def velocity(self) -> FloatArray:
        """The fields on the mesh itself (N, F, 3); not to be asked for in the frame loop."""
        return self.flow.velocity

    def origins(self, places: FloatArray, times: FloatArray) -> FloatArray:
        """Where what is at the vertices' places (V, 3) at times (T,) came from, (T, V, 3), of two
        surfaces on A.
        """
        maps, first = self.flow.point_maps(times), self.initial
        found = [(each if first is None else each.followed_by(first)).positions for each in maps]
        return np.array(found).reshape(len(times), *places.shape)

    def destinations(self, places: FloatArray, times: FloatArray) -> FloatArray:
        """Where what is at the vertices' places (V, 3) goes until times (T,), (T, V, 3)."""
        found = [points.positions for points in self.flow.point_maps(times, inverse=True)]
        return np.array(found).reshape(len(times), *places.shape)

    def carry(self, function: FloatArray, times: FloatArray) -> FloatArray:
        """A function (V,) or (V, C) at times (T,), if the flow can be followed: (T, V, C)."""
        carried = self._pushed(function, times)
        if np.abs(carried).max() > _VALUE_MAX:
            raise abfm.AdvectionError(
                "the function overflows on its way: the discrete flow is unstable over this time"
            )
        return carried

    def _pushed(self, function: FloatArray, times: FloatArray) -> FloatArray:
        """Carry the source as it was carried when the flow was found: evaluated on its mesh."""
        flow = self.flow
        channels = () if self.problem is None or not flow.refined else self.problem.source.T
        for channel, source in enumerate(channels):
            if self.problem is not None and np.array_equal(source, function):
                there = self.problem.refined(flow.refined)
                fine = abfm.Flow(flow.fine_mesh, flow.fine_velocity, flow.tau, flow.method)
                return fine.push(there.source[:, channel], times)[:, : len(function)]
        return flow.push(function, times)
