"""Advection of functions along one field or several in a row: exponential or linearised, adjoint, time spans."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.vector_fields import to_frame
from abfm.errors import AdvectionError, brief
from abfm.flow.derivative_pattern import derivative_pattern
from abfm.flow.exponential import TOLERANCE, ExponentialFlow, Segment, Trajectory, Workspace
from abfm.mesh import TriangleMesh
from abfm.real_numbers import is_finite_number, real_numbers
from abfm.types import FloatArray


class LinearizedFlow:
    """``id - t D_v`` of one field: the first two terms of the exponential (Eq. 5)."""

    def __init__(self, mesh: TriangleMesh, v: FloatArray) -> None:
        self.pattern = derivative_pattern(mesh)
        self.values = self.pattern.values(v)

    def forward(self, f: FloatArray, t: float, keep: bool = False) -> Trajectory:
        """One step of length ``t`` from ``f`` (V,)."""
        return Trajectory(t, [Segment(f, 1)], f - t * self._derivative(f))

    def backward(self, trajectory: Trajectory, mu: FloatArray, gradient: FloatArray) -> FloatArray:
        """Adjoint of `forward`: adds the derivative by ``v`` to ``gradient`` (F, 2), returns the derivative by ``f``.

        This is Eq. 8: ``-t D̄_f^T mu``, and ``(id - t D_v)^T mu``.
        """
        start, mu = trajectory.segments[0].start[self.pattern.order], mu[self.pattern.order]
        rows = np.repeat(mu, np.diff(self.pattern.indptr))
        self.pattern.add_chain_rule(-trajectory.step * rows[:, None] * start[self.pattern.indices], gradient)
        mu = mu - trajectory.step * self.pattern.product(self.pattern.transposed(self.values), mu)
        return mu[self.pattern.rank]

    def span(self, f: FloatArray, times: FloatArray) -> FloatArray:
        """Partial steps from ``f`` to several times (T,) -> (T, V)."""
        return f - times[:, None] * self._derivative(f)

    def _derivative(self, f: FloatArray) -> FloatArray:
        return self.pattern.product(self.values, f[self.pattern.order])[self.pattern.rank]


class Advection:
    """Composition of the flows of N fields (N, F, 2) of frame coefficients, in the mesh's units, each over ``tau / N``.

    ``linearized`` takes ``id - t D_v`` per field instead of ``exp(-t D_v)``. A ``workspace`` is that of an earlier flow
    on the same mesh, whose terms are forgotten.
    """

    def __init__(
        self,
        mesh: TriangleMesh,
        fields: FloatArray,
        tau: float,
        linearized: bool = False,
        workspace: Workspace | None = None,
        tolerance: float = TOLERANCE,
        clustered: bool = False,
    ) -> None:
        self.workspace = Workspace(len(mesh.vertices)) if workspace is None else workspace
        self.workspace.release()
        fields = np.ascontiguousarray(fields)
        self.parts: Sequence[LinearizedFlow | ExponentialFlow] = (
            [LinearizedFlow(mesh, v) for v in fields]
            if linearized
            else [ExponentialFlow(mesh, v, self.workspace, tolerance, clustered) for v in fields]
        )
        self.step = tau / len(fields)

    def forward(self, f: FloatArray, keep: bool = False) -> list[Trajectory]:
        """Advect ``f`` (V,) to time tau: one trajectory per field; the last one's ``end`` is the result.

        With ``keep`` the terms of all functions are kept for `backward`, as far as they fit.
        """
        trajectories: list[Trajectory] = []
        for part in self.parts:
            trajectories.append(part.forward(f, self.step, keep))
            f = trajectories[-1].end
        return trajectories

    def backward(self, trajectories: list[Trajectory], mu: FloatArray, gradient: FloatArray) -> None:
        """Add the derivative by the fields to ``gradient`` (N, F, 2), for the derivative ``mu`` (V,) by the result."""
        for j in reversed(range(len(self.parts))):
            mu = self.parts[j].backward(trajectories[j], mu, gradient[j])

    def at(self, f: FloatArray, times: FloatArray) -> FloatArray:
        """Function ``f`` (V,) carried to each of the times (T,) -> (T, V), see `abfm.Flow`."""
        out = np.empty((len(times), len(f)))
        order = np.argsort(np.abs(times), kind="stable")
        part = self.parts[0]
        is_one = isinstance(part, ExponentialFlow) and len(self.parts) == 1
        for chosen, carry in ((order[times[order] >= 0], self._ahead), (order[times[order] < 0], self._back)):
            if len(chosen):
                out[chosen] = (part.span if is_one else carry)(f, times[chosen])
        return out

    def _ahead(self, f: FloatArray, times: FloatArray) -> FloatArray:
        """At ascending times."""
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

    def _back(self, f: FloatArray, times: FloatArray) -> FloatArray:
        """At negative times, each by itself."""
        out = np.empty((len(times), len(f)))
        for row, t in enumerate(-times):
            last = max(int(np.ceil(t / self.step * (1 - 1e-12))) - 1, 0)
            state = f
            for j in range(last, -1, -1):
                length = t - last * self.step if j == last else self.step
                state = self.parts[min(j, len(self.parts) - 1)].forward(state, -length).end
            out[row] = state
        return out


def advect(mesh: TriangleMesh, velocity: ArrayLike, f: ArrayLike, t: float) -> FloatArray:
    """Function carried along a field for a time: ``exp(-t D_v) f`` (Eq. 4).

    Parameters
    ----------
    mesh : TriangleMesh
    velocity : (F, 3) array
        Tangent vectors, in the mesh's length unit per unit of time.
    f : (V,) or (V, C) array
        One value or row per vertex of the mesh, or of its file.
    t : float
        Time of either sign.

    Returns
    -------
    Array of shape (V,) or (V, C).

    Raises
    ------
    AdvectionError
        If the arrays do not fit the mesh or are not finite, or if the flow is too long or overflows.
    """
    field, functions = real_numbers(velocity, "velocity", AdvectionError), real_numbers(f, "f", AdvectionError)
    if field.shape != (len(mesh.faces), 3):
        raise AdvectionError(f"velocity has shape {field.shape}; expected {(len(mesh.faces), 3)}, a vector per face")
    if functions.ndim not in (1, 2) or len(functions) not in (len(mesh.vertices), mesh.file_vertex_count):
        raise AdvectionError(f"f has shape {functions.shape}; expected ({len(mesh.vertices)},) or with channels")
    functions = mesh.restrict(functions)
    if not is_finite_number(t):
        raise AdvectionError(f"t is {brief(t)}; expected one time, finite")
    if not (np.isfinite(field).all() and np.isfinite(functions).all()):
        raise AdvectionError("velocity and f must be finite")
    flow = ExponentialFlow(mesh, to_frame(mesh, field), Workspace(len(mesh.vertices)))
    columns = np.ascontiguousarray(functions.reshape(len(functions), -1).T)
    carried = np.stack([flow.forward(column, float(t)).end for column in columns], axis=1)
    if not np.isfinite(carried).all():
        raise AdvectionError("the advected function overflows: the discrete flow is unstable over this time")
    return carried.reshape(functions.shape)
