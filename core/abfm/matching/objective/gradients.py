"""Derivatives by the fields of an inner product with what they carry: exact, or the paper's."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from abfm.calculus.operators import Matrix
from abfm.calculus.vector_fields import dual_directional_derivative, exponential_action, lie_bracket
from abfm.flow.advection import Advection
from abfm.flow.exponential import ExponentialFlow, Trajectory
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray
from abfm.workers.control import checkpoint


class Adjoint:
    """The exact derivative of the discrete flow, by its adjoint."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self._shape = shape

    def carry(self, flow: Advection, f: FloatArray) -> list[Trajectory]:
        return flow.forward(f, keep=True)

    def of_fields(
        self, flow: Advection, trajectories: Sequence[list[Trajectory]], residuals: FloatArray
    ) -> FloatArray:
        gradient = np.zeros(self._shape)
        for trajectory, residual in zip(trajectories, residuals, strict=True):
            flow.backward(trajectory, residual, gradient)
        return gradient


@dataclass(frozen=True, eq=False)
class Bracket:
    """The paper's derivative (Eq. 9, and section 7): with ``dt = t / n``, for one field
    ``-(dt / (k+1)) sum_s exp(s dt / k ad_v)^T sum_r D̄_{f_(r-1)}^T exp(-(n - r) dt D_v)^T mu``.
    """

    mesh: TriangleMesh
    fields: FloatArray  # (N, F, 2)
    substeps: int  # n
    quadrature: int  # k

    def carry(self, flow: Advection, f: FloatArray) -> list[Trajectory]:
        return flow.forward(f)

    def of_fields(
        self, flow: Advection, trajectories: Sequence[list[Trajectory]], residuals: FloatArray
    ) -> FloatArray:
        gradient = np.empty_like(self.fields)
        dt = flow.step / self.substeps
        for j in reversed(range(len(flow.parts))):
            part = flow.parts[j]
            assert isinstance(part, ExponentialFlow)
            starts = [trajectory[j].segments[0].start for trajectory in trajectories]
            pairs = zip(starts, residuals, strict=True)
            sources = np.asarray(sum(self._sources(part, start, dt, mu) for start, mu in pairs))
            gradient[j] = self._integral(self.fields[j], sources, dt)
            if j:
                back = part.transposed()
                residuals = np.stack([back.forward(mu, flow.step).end for mu in residuals])
        return gradient

    def _sources(
        self, flow: ExponentialFlow, f: FloatArray, dt: float, mu: FloatArray
    ) -> FloatArray:
        """Return the sum over r, applied to ``mu`` (V,), (2F,): to be summed over channels."""
        states = [f]
        for _ in range(self.substeps - 1):
            checkpoint()
            states.append(flow.forward(states[-1], dt).end)
        backward = flow.transposed()
        total = np.zeros(2 * len(self.mesh.faces))
        for index, state in enumerate(reversed(states)):
            checkpoint()
            if index or self.substeps == 1:  # Eq. 9 has a factor that the n-step form lacks
                mu = backward.forward(mu, dt).end
            total += dual_directional_derivative(self.mesh, state).T @ mu
        return total

    def _integral(self, v: FloatArray, sources: FloatArray, dt: float) -> FloatArray:
        """Return the derivative by ``v`` (F, 2), for the summed sources, by the trapezium of k."""
        bracket = Matrix(lie_bracket(self.mesh, v).T.tocsr())
        total = term = sources
        for _ in range(self.quadrature):
            checkpoint()
            term = exponential_action(bracket, term, dt / self.quadrature)
            total = total + term
        return (-dt / (self.quadrature + 1) * total).reshape(-1, 2)
