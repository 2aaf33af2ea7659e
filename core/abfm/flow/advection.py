"""Advection of functions along consecutive fields, to one or many times, and its derivative."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from abfm.flow.derivative import DerivativePattern, clustered_pattern, derivative_pattern
from abfm.flow.exponential import TOLERANCE, ExponentialFlow, Segment, Trajectory, Workspace
from abfm.mesh import TriangleMesh
from abfm.parameters import Method
from abfm.types import FloatArray


class LinearisedFlow:
    """The linearised flow ``id - t D_v`` of one field v (Eq. 5).

    ``D_v`` is the derivative along v. The flow has the first two terms of the exponential ``exp(-t
    D_v)``.
    """

    rho = 0.0  # no bound of ``D_v`` is needed, as each step is one product

    def __init__(self, pattern: DerivativePattern, v: FloatArray) -> None:
        self.pattern, self.values = pattern, pattern.values(v)

    def forward(self, f: FloatArray, t: float, keep: bool = False) -> Trajectory:
        """Return ``f`` (V,) advected by one step of length ``t``."""
        return Trajectory(t, [Segment(f, 1)], f - t * self._derivative(f))

    def backward(self, trajectory: Trajectory, mu: FloatArray, gradient: FloatArray) -> FloatArray:
        """Apply the adjoint of `forward` to the derivative ``mu`` (V,) of an energy by its result.

        Add the energy's derivative by the field (Eq. 8), ``-t D̄_f^T mu``, to ``gradient`` (F, 2).
        Return its derivative by ``f``, ``(id - t D_v)^T mu``.
        """
        pattern = self.pattern
        start, dual = pattern.restricted(trajectory.segments[0].start), pattern.restricted_dual(mu)
        rows = np.repeat(dual, np.diff(pattern.indptr))
        entries = -trajectory.step * rows[:, None] * start[pattern.indices]
        pattern.add_chain_rule(entries, gradient)
        derivative = pattern.product(pattern.transposed(self.values), dual)
        return mu - trajectory.step * pattern.extended_dual(derivative)

    def span(self, f: FloatArray, times: FloatArray) -> FloatArray:
        return f - times[:, None] * self._derivative(f)

    def _derivative(self, f: FloatArray) -> FloatArray:
        return self.pattern.extended(self.pattern.product(self.values, self.pattern.restricted(f)))


class Advection:
    """The flow along N consecutive fields, each for a time ``step``.

    ``parts`` are the flows of the fields. `Discretisation.flow` returns such objects.
    """

    def __init__(self, parts: Sequence[ExponentialFlow | LinearisedFlow], step: float) -> None:
        self.parts, self.step = parts, step

    @property
    def exponent(self) -> float:
        """The approximate number of matrix products of an advection, from bounds of ``D_v``."""
        return self.step * sum(part.rho for part in self.parts)

    def forward(self, f: FloatArray, keep: bool = False) -> list[Trajectory]:
        """Advect ``f`` (V,) along all fields; return one trajectory for each field.

        The ``end`` of the last trajectory is the advected function. With ``keep``, trajectories
        store terms for `backward`.
        """
        trajectories: list[Trajectory] = []
        for part in self.parts:
            trajectories.append(part.forward(f, self.step, keep))
            f = trajectories[-1].end
        return trajectories

    def backward(
        self, trajectories: list[Trajectory], mu: FloatArray, gradient: FloatArray
    ) -> None:
        """Add the derivative of an energy by the fields to ``gradient`` (N, F, 2).

        ``mu`` (V,) is the energy's derivative by the advected function, and ``trajectories`` are
        the result of `forward`.
        """
        for j in reversed(range(len(self.parts))):
            mu = self.parts[j].backward(trajectories[j], mu, gradient[j])

    def at(self, f: FloatArray, times: FloatArray) -> FloatArray:
        """Advect ``f`` (V,) to T times of either sign; return an array (T, V).

        `abfm.Flow` defines negative times and times beyond the last field.
        """
        out = np.empty((len(times), len(f)))
        order = np.argsort(np.abs(times), kind="stable")
        ahead, back = order[times[order] >= 0], order[times[order] < 0]
        part = self.parts[0]
        is_one = isinstance(part, ExponentialFlow) and len(self.parts) == 1
        for chosen, advect in ((ahead, self._to_later_times), (back, self._to_earlier_times)):
            if len(chosen):
                out[chosen] = (part.span if is_one else advect)(f, times[chosen])
        return out

    def _to_later_times(self, f: FloatArray, times: FloatArray) -> FloatArray:
        out = np.empty((len(times), len(f)))
        owner = np.maximum(np.ceil(times / self.step * (1 - 1e-12)) - 1, 0)
        for j in range(int(owner[-1]) + 1):
            part = self.parts[min(j, len(self.parts) - 1)]
            inside = np.flatnonzero(owner == j)
            if len(inside):
                out[inside] = part.span(f, times[inside] - j * self.step)
            if j < owner[-1]:
                f = part.forward(f, self.step).end
        return out

    def _to_earlier_times(self, f: FloatArray, times: FloatArray) -> FloatArray:
        out = np.empty((len(times), len(f)))
        for row, t in enumerate(-times):
            last = max(int(np.ceil(t / self.step * (1 - 1e-12))) - 1, 0)
            state = f
            for j in range(last, -1, -1):
                length = t - last * self.step if j == last else self.step
                state = self.parts[min(j, len(self.parts) - 1)].forward(state, -length).end
            out[row] = state
        return out


class Discretisation:
    """The discrete advection of functions on a mesh, and the memory that it uses.

    A function has one value for each vertex or, if `clustered`, for each cluster of vertices.
    """

    def __init__(
        self,
        mesh: TriangleMesh,
        method: Method = "nonlinear",
        pattern: DerivativePattern | None = None,
    ) -> None:
        self.mesh, self.method = mesh, method
        self.pattern = derivative_pattern(mesh) if pattern is None else pattern
        self.size = self.pattern.size  # values of a function: one per vertex or per cluster
        self.workspace = Workspace(self.size)

    def clustered(self) -> Discretisation:
        """Return the same discretisation, with one value for each cluster of vertices."""
        return Discretisation(self.mesh, self.method, clustered_pattern(self.mesh))

    def flow(self, fields: FloatArray, tau: float, tolerance: float = TOLERANCE) -> Advection:
        """Return the flow along N consecutive fields (N, F, 2), each for ``tau / N``.

        Fields have coefficients in the local frames of faces. ``tolerance`` is that of the series
        for exponentials. A new flow releases the terms that earlier flows stored in the workspace.
        """
        self.workspace.release()
        parts = [
            LinearisedFlow(self.pattern, v)
            if self.method == "linearised"
            else ExponentialFlow(self.pattern, v, self.workspace, tolerance)
            for v in np.ascontiguousarray(fields)
        ]
        return Advection(parts, tau / len(fields))
