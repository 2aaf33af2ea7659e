"""The paper's algorithm as published: Algorithm 1 with the sub-steps of section 7, minimised by plain L-BFGS.

Kept to measure the solver of this package against; `abfm.match` does the same job. The exponentials are those of
SciPy's port of [AMH11]; the minimiser stands in for minFunc with its default settings.
"""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse.linalg import expm_multiply

from abfm.channels import channels
from abfm.mesh import FloatArray, TriangleMesh
from abfm.operators import Matrix, averaging, function_norm_matrix, gradient, vector_norm_matrix
from abfm.optimizer import LBFGS
from abfm.parameters import Parameters
from abfm.vector_fields import directional_derivative, lie_bracket, to_ambient

MEMORY = 100
"""Pairs that L-BFGS keeps: minFunc's default."""


def exponential_span(matrix: Matrix, x: FloatArray, end: float, intervals: int) -> FloatArray:
    """``exp(t matrix) x`` at ``intervals + 1`` even times from 0 to ``end``: ``exp_tspan`` of Algorithm 1, one per row.

    The span always starts at 0: with another start, SciPy's results have been wrong by many orders of magnitude.
    """
    if intervals == 0:
        return x[None]
    with np.errstate(all="ignore"):  # a field that is too fast overflows: its energy is infinite
        return np.asarray(expm_multiply(matrix, x, start=0.0, stop=end, num=intervals + 1, endpoint=True))


@dataclass(frozen=True)
class PaperEvaluation:
    """Energy at one field, and what the paper takes for its gradient by the frame coefficients, (F, 2)."""

    energy: float
    gradient: FloatArray


class PaperEnergy:
    """Energy and gradient of NLABFM: Algorithm 1 for one sub-step, the n-step form of section 7, as printed, for more.

    The unknowns are coefficients in orthonormal face frames, so plain L-BFGS takes the same steps as on the paper's
    tangent vectors in space. Energy and norms are those of `abfm.MatchingEnergy`.

    Parameters
    ----------
    mesh : TriangleMesh
        Scaled to unit area here.
    f, g : (V,) arrays
        Source and target.
    parameters : Parameters
        Read are ``tau``, ``alpha``, ``beta``, ``sigma``, ``substeps`` (n) and ``quadrature`` (k).
    """

    def __init__(self, mesh: TriangleMesh, f: ArrayLike, g: ArrayLike, parameters: Parameters) -> None:
        self.mesh = mesh.normalized()
        self.source, self.target = channels(mesh, f, "source")[0], channels(mesh, g, "target")[0]
        self.parameters = parameters
        self.field_norm = vector_norm_matrix(self.mesh, parameters.alpha)
        self.function_norm = function_norm_matrix(self.mesh, parameters.beta)

    def __call__(self, v: FloatArray) -> PaperEvaluation:
        """Energy and gradient at frame coefficients (F, 2) on the mesh scaled to unit area."""
        p = self.parameters
        derivative = directional_derivative(self.mesh, v)
        states = exponential_span(-derivative, self.source, p.tau, p.substeps)
        difference = states[-1] - self.target
        momentum = p.tau * (self.field_norm @ v.ravel())
        mu = self.function_norm @ difference / p.sigma**2
        energy = 0.5 * float(v.ravel() @ momentum + mu @ difference)
        if not np.isfinite(energy):
            return PaperEvaluation(np.inf, np.full_like(v, np.nan))
        sources = self._sources(derivative, states, mu)
        dt = p.tau / p.substeps
        transported = exponential_span(Matrix(lie_bracket(self.mesh, v).T), sources, dt, p.quadrature)
        total = momentum - dt / (p.quadrature + 1) * transported.sum(axis=0)
        return PaperEvaluation(energy, total.reshape(-1, 2))

    def _sources(self, derivative: Matrix, states: FloatArray, mu: FloatArray) -> FloatArray:
        """``sum_r D̄_{f_(r-1)}^T exp(-(n - r) dt D_v)^T mu``, (2F,); Eq. 9 has ``exp(-tau D_v)^T`` for ``n = 1``."""
        n, dt = self.parameters.substeps, self.parameters.tau / self.parameters.substeps
        transposed = Matrix(-derivative.T)
        momenta = exponential_span(transposed, mu, dt, 1)[1:] if n == 1 else self._printed(transposed, mu, dt)
        slopes = (gradient(self.mesh) @ states[:n].T).reshape(-1, 2, n)
        return np.einsum("fxr,fr->fx", slopes, averaging(self.mesh).T @ momenta.T).ravel()

    def _printed(self, transposed: Matrix, mu: FloatArray, dt: float) -> FloatArray:
        steps = self.parameters.substeps - 1
        return exponential_span(transposed, mu, steps * dt, steps)[::-1]


@dataclass(frozen=True)
class PaperDescent:
    """What the paper's algorithm found.

    Attributes
    ----------
    velocity : (F, 3) array
        Field of the lowest energy, in the input's units.
    energy : float
        The lowest energy, on the mesh scaled to unit area.
    history : (rows, 2) array
        Seconds since the start, and the lowest energy so far, at the start and each time that it fell.
    evaluations : int
    stop_reason : str
        "time limit", "line search failed" or "converged".
    """

    velocity: FloatArray
    energy: float
    history: FloatArray
    evaluations: int
    stop_reason: str


class _TimeIsUp(Exception):
    """Raised instead of an evaluation after the time limit."""


def minimise(
    mesh: TriangleMesh, f: ArrayLike, g: ArrayLike, parameters: Parameters, seconds: float = 60.0
) -> PaperDescent:
    """Run the paper's algorithm from ``v = 0`` until it stops by itself or the time is over, set-up included.

    Plain L-BFGS with `MEMORY` pairs, first step ``min(1, 1 / |gradient|_1)``, scaling ``<s, y> / <y, y>``, and a strong
    Wolfe search with constants 1e-4 and 0.9: minFunc's defaults. The evaluation under way when time is up counts.

    Parameters
    ----------
    mesh : TriangleMesh
    f, g : (V,) arrays
    parameters : Parameters
        As `PaperEnergy` reads them.
    seconds : float
        Time limit.
    """
    start = perf_counter()
    energy = PaperEnergy(mesh, f, g, parameters)
    history: list[tuple[float, float]] = []
    best = np.zeros((len(mesh.faces), 2))
    evaluations = 0

    def evaluate(v: FloatArray) -> PaperEvaluation:
        nonlocal best, evaluations
        if evaluations and perf_counter() - start > seconds:
            raise _TimeIsUp
        evaluations += 1
        point = energy(v)
        if not history or point.energy < history[-1][1]:
            best = v
            history.append((perf_counter() - start, point.energy))
        return point

    search = LBFGS(evaluate, memory=MEMORY, tolerance=0.0)
    reason = None
    try:
        state = search.init(best)
        while reason is None:
            state = search.step(state)
            reason = search.stop_reason(state)
    except _TimeIsUp:
        reason = "time limit"
    velocity = to_ambient(energy.mesh, best) * mesh.length_scale
    return PaperDescent(velocity, history[-1][1], np.array(history), evaluations, reason)
