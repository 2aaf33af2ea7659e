"""The paper's algorithm as published: Algorithm 1 with the substeps of section 7 and plain L-BFGS.

This algorithm is the baseline of the solver. The exponentials are those of SciPy's port of [AMH11];
SciPy's L-BFGS-B without bounds replaces minFunc.
"""

from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import fmin_l_bfgs_b
from scipy.sparse.linalg import expm_multiply

from abfm.calculus import operators as op
from abfm.calculus.channels import channels
from abfm.calculus.operators import Matrix
from abfm.calculus.vector_fields import directional_derivative, lie_bracket, to_ambient
from abfm.mesh import TriangleMesh
from abfm.parameters import Parameters
from abfm.types import FloatArray

MEMORY = 100
"""Number of pairs that L-BFGS stores, the default of minFunc."""
# A hundred times the 1-norm of exponents of good fields. Larger norms occur in line searches, and
# their exponentials take minutes.
_EXPONENT_NORM_MAX = 1e4
# Limit of the energy, relative to the first one. At infinity, L-BFGS-B stops instead of shortening
# its step.
_ENERGY_RATIO_MAX = 1e3


def exponential_span(matrix: Matrix, x: FloatArray, end: float, intervals: int) -> FloatArray:
    """Return ``exp(t matrix) x`` at ``intervals + 1`` evenly spaced times t from 0 to ``end``.

    This is ``exp_tspan`` of Algorithm 1, with one time per row. The result is infinite if the
    matrix is so large that it would take minutes. The span always starts at 0: with other starts,
    results of SciPy were wrong by many orders of magnitude.
    """
    if intervals == 0:
        return x[None]
    if not float(abs(matrix).sum(axis=0).max()) * end < _EXPONENT_NORM_MAX:
        return np.full((intervals + 1, len(x)), np.inf)
    with np.errstate(all="ignore"):  # an unstable flow overflows to an infinite energy
        return np.asarray(
            expm_multiply(matrix, x, start=0.0, stop=end, num=intervals + 1, endpoint=True)
        )


class PaperEnergy:
    """Energy and gradient of NLABFM: Algorithm 1, or the n-step form of section 7.

    The unknowns are coefficients in orthonormal face frames. Plain L-BFGS then takes the same steps
    as on tangent vectors in space. The bracket is the tangential part of Eq. 11. Energy and norms
    are those of `abfm.MatchingEnergy`, on the mesh scaled to unit area.

    Parameters
    ----------
    parameters : Parameters
        Only ``tau``, ``alpha``, ``beta``, ``sigma``, ``substeps`` (n) and ``quadrature`` (k) are
        used.
    as_printed : bool
        For ``n > 1``, omit the factor ``exp(-dtau D_v)``, as the printed n-step form does. The
        product rule and Eq. 9 have ``n - r + 1`` substeps, the printed form ``n - r``.
    """

    def __init__(
        self,
        mesh: TriangleMesh,
        f: ArrayLike,
        g: ArrayLike,
        parameters: Parameters,
        as_printed: bool = True,
    ) -> None:
        self.mesh = mesh.normalized()
        self.source, self.target = channels(mesh, f, "source")[0], channels(mesh, g, "target")[0]
        self.parameters = parameters
        self.dropped = 1 if as_printed and parameters.paper.substeps > 1 else 0
        self.field_norm = op.vector_norm_matrix(self.mesh, parameters.alpha)
        self.function_norm = op.function_norm_matrix(self.mesh, parameters.beta)

    def __call__(self, v: FloatArray) -> tuple[float, FloatArray]:
        """Return energy and gradient at frame coefficients (2F,) on the mesh scaled to unit area.

        If one of them overflows or would take minutes, the energy is infinite and the gradient 0.
        """
        p = self.parameters
        derivative = directional_derivative(self.mesh, v.reshape(-1, 2))
        states = exponential_span(-derivative, self.source, p.tau, p.paper.substeps)
        momentum = p.tau * (self.field_norm @ v)
        with np.errstate(all="ignore"):
            difference = states[-1] - self.target
            mu = self.function_norm @ difference / p.last_sigma**2
            energy = 0.5 * float(v @ momentum + mu @ difference)
        if not np.isfinite(energy):
            return np.inf, np.zeros_like(v)
        # sum_r D̄_{f_(r-1)}^T exp(-(n - r + 1) dtau D_v)^T mu, without the factor omitted in print
        n, dt = p.paper.substeps, p.tau / p.paper.substeps
        steps = n - self.dropped
        backward = Matrix(-derivative.T)
        momenta = exponential_span(backward, mu, steps * p.tau / n, steps)[::-1][:n]
        slopes = (op.gradient(self.mesh) @ states[:n].T).reshape(-1, 2, n)
        weights = op.averaging(self.mesh).T @ momenta.T
        sources = np.asarray(np.einsum("fxr,fr->fx", slopes, weights)).ravel()
        bracket = lie_bracket(self.mesh, v.reshape(-1, 2))
        transported = exponential_span(Matrix(bracket.T), sources, dt, p.paper.quadrature)
        slope = momentum - dt / (p.paper.quadrature + 1) * transported.sum(axis=0)
        return (energy, slope) if np.isfinite(slope).all() else (np.inf, np.zeros_like(v))


@dataclass(frozen=True)
class PaperDescent:
    """Result of the algorithm of the paper.

    Attributes
    ----------
    velocity : (F, 3) array
        The field of the lowest energy, in the input's units.
    energy : float
        Its energy on the mesh scaled to unit area.
    history : (rows, 2) array
        Seconds since the start and the energy, for each evaluation that lowered it.
    """

    velocity: FloatArray
    energy: float
    history: FloatArray
    evaluations: int
    stop_reason: str


class _OutOfTimeError(Exception):
    """Raised at the first evaluation after the time limit."""


def minimise(
    mesh: TriangleMesh, f: ArrayLike, g: ArrayLike, parameters: Parameters, seconds: float = 60.0
) -> PaperDescent:
    """Run the algorithm of the paper from ``v = 0`` until it stops or ``seconds`` have passed.

    The time includes the setup. An evaluation that runs at the time limit still counts.

    Two replacements of minFunc, the paper's optimiser, were tried, with its memory of `MEMORY`
    pairs, its scaling and a strong Wolfe search. L-BFGS-B of SciPy found lower energies than the
    L-BFGS of this package without preconditioner, which has the first step and the constants of
    minFunc.
    """
    start = perf_counter()
    energy = PaperEnergy(mesh, f, g, parameters)
    best = np.zeros(2 * len(mesh.faces))
    history: list[tuple[float, float]] = []
    evaluations = 0

    def evaluate(v: FloatArray) -> tuple[float, FloatArray]:
        nonlocal best, evaluations
        if evaluations and perf_counter() - start > seconds:
            raise _OutOfTimeError
        evaluations += 1
        value, slope = energy(v)
        if not history or value < history[-1][1]:
            best = v.copy()
            history.append((perf_counter() - start, value))
        return min(value, _ENERGY_RATIO_MAX * history[0][1]), slope

    try:
        *_, end = fmin_l_bfgs_b(
            evaluate, best, m=MEMORY, factr=0.0, pgtol=0.0, maxiter=10**9, maxfun=10**9
        )
        reason = str(end["task"])
    except _OutOfTimeError:
        reason = "time limit"
    velocity = to_ambient(energy.mesh, best.reshape(-1, 2)) * mesh.length_scale
    return PaperDescent(velocity, history[-1][1], np.array(history), evaluations, reason)
