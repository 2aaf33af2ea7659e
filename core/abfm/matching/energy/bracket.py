"""The paper's gradient of the advected function, through the Lie bracket (Eq. 9 and its n-step form in section 7)."""

from collections.abc import Callable

import numpy as np

from abfm.calculus.operators import Matrix
from abfm.calculus.vector_fields import dual_directional_derivative, exponential_action, lie_bracket
from abfm.flow.exponential import ExponentialFlow
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray


class BracketGradient:
    """Derivative by one field of an inner product with the advected function, as the paper approximates it.

    ``-(dt / (k+1)) sum_s exp(s dt / k ad_v)^T sum_r D̄_{f_(r-1)}^T exp(-(n - r) dt D_v)^T mu``, with ``dt = t / n``;
    for ``n = 1`` Eq. 9, ``-(t / (k+1)) sum_s exp(s t / k ad_v)^T D̄_f^T exp(-t D_v)^T mu``.

    Parameters
    ----------
    mesh : TriangleMesh
    v : (F, 2) array
    flow : ExponentialFlow
        That of ``v``.
    substeps, quadrature : int
        ``n`` and ``k``.
    between : callable
        Called between steps; what it raises ends them.
    """

    def __init__(
        self,
        mesh: TriangleMesh,
        v: FloatArray,
        flow: ExponentialFlow,
        substeps: int,
        quadrature: int,
        between: Callable[[], None],
    ) -> None:
        self.mesh, self.flow, self._between = mesh, flow, between
        self.substeps, self.quadrature = substeps, quadrature
        self.bracket = Matrix(lie_bracket(mesh, v).T.tocsr())

    def sources(self, f: FloatArray, t: float, mu: FloatArray) -> FloatArray:
        """The sum over r, applied to ``mu`` (V,), (2F,): to be summed over channels."""
        dt = t / self.substeps
        states = [f]
        for _ in range(self.substeps - 1):
            self._between()
            states.append(self.flow.forward(states[-1], dt).end)
        backward = self.flow.transposed()
        total = np.zeros(2 * len(self.mesh.faces))
        for index, state in enumerate(reversed(states)):
            self._between()
            if index or self.substeps == 1:  # Eq. 9 has a factor that the n-step form lacks
                mu = backward.forward(mu, dt).end
            total += dual_directional_derivative(self.mesh, state).T @ mu
        return total

    def gradient(self, sources: FloatArray, t: float) -> FloatArray:
        """The derivative by ``v``, (F, 2), for the summed `sources`."""
        dt = t / self.substeps
        total = term = sources
        for _ in range(self.quadrature):
            self._between()
            term = exponential_action(self.bracket, term, dt / self.quadrature)
            total = total + term
        return (-dt / (self.quadrature + 1) * total).reshape(-1, 2)
