"""The matching energy (Eq. 3, discretised in Eq. 6) of a problem, for every stage of a match."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.operators import Matrix
from abfm.calculus.vector_fields import (
    dual_directional_derivative,
    exponential_action,
    lie_bracket,
    to_ambient,
    to_frame,
)
from abfm.errors import AdvectionError
from abfm.flow.advection import Advection, Discretisation
from abfm.flow.exponential import TOLERANCE, ExponentialFlow, Trajectory
from abfm.matching.objective.regularizer import Regularizer, regularizer
from abfm.matching.problem import Problem, check_fields
from abfm.matching.terms.data_term import DataTerms, Sum
from abfm.matching.terms.landmarks import LandmarkMisfit, residual_of_errors
from abfm.mesh import MeshLike, TriangleMesh
from abfm.numerics import kernels
from abfm.types import FloatArray
from abfm.workers.control import checkpoint


@dataclass(frozen=True)
class Evaluation:
    x: FloatArray  # frame coefficients (N, F, 2) of the fields
    energy: float  # total and its terms; infinite where the flow overflows
    regularity: float
    shares: tuple[float, ...]  # of the data terms in the mismatch
    advected: FloatArray  # what the data terms want carried, carried to the end time, (C, V)
    differentiate: Callable[[], FloatArray]  # faster before than after the next evaluation
    landmark_errors: FloatArray | None = None  # (L,), see `Landmarks`; None without any, or by inf

    @property
    def mismatch(self) -> float:
        return float(sum(self.shares))

    @cached_property
    def gradient(self) -> FloatArray:
        """Derivative by the frame coefficients, (N, F, 2), made when asked for."""
        return self.differentiate()


@dataclass(frozen=True)
class Adjoint:
    """The exact derivative of the discrete flow, by its adjoint."""

    shape: tuple[int, ...]

    def carry(self, flow: Advection, f: FloatArray) -> list[Trajectory]:
        return flow.forward(f, keep=True)

    def of_fields(
        self, flow: Advection, trajectories: Sequence[list[Trajectory]], residuals: FloatArray
    ) -> FloatArray:
        gradient = np.zeros(self.shape)
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


@dataclass(frozen=True, eq=False)
class Objective:
    """``step/2 sum_j v_j^T R v_j`` plus data terms of what the flow of fields carries (Eq. 6), and
    of where it takes landmarks.
    """

    regularity: Regularizer  # ``R``, by ``apply``
    carried: FloatArray  # functions (C, V) that the data terms want carried
    # each data term's energy, and the derivative of their sum, by what was carried
    misfit: Callable[[FloatArray], tuple[tuple[float, ...], FloatArray]]
    advect: Callable[[FloatArray], Advection]  # the flow of frame coefficients (N, F, 2)
    tau: float
    gradient: Callable[[FloatArray], Adjoint | Bracket]  # at frame coefficients (N, F, 2)
    shift: FloatArray | float = 0.0  # what is taken off what was carried, before it is measured
    landmarks: Callable[[FloatArray], LandmarkMisfit] | None = None  # what they say of (N, F, 2)
    is_of_landmarks: bool = False  # whether nothing but them counts

    def evaluate(self, x: FloatArray) -> Evaluation:
        with np.errstate(over="ignore", invalid="ignore"):  # an unstable flow ends in any numbers
            momentum = self.tau / len(x) * np.stack([self.regularity.apply(v) for v in x])
            regularity = 0.5 * kernels.inner(momentum.ravel(), np.ascontiguousarray(x).ravel())
            try:
                shares, advected, differentiate = self._mismatch(x)
            except AdvectionError:
                shares, differentiate = (np.inf,), partial(np.full, x.shape, np.nan)
                advected = np.full_like(self.carried, np.nan)
            derivatives, errors = [differentiate], None
            if self.landmarks is not None and np.isfinite(sum(shares)):
                try:
                    misfit = self.landmarks(x)
                except AdvectionError:
                    shares = (np.inf,)
                else:
                    shares, errors = (*shares, misfit.share), misfit.errors
                    derivatives.append(misfit.differentiate)

        def gradient() -> FloatArray:
            return np.asarray(sum((by() for by in derivatives), momentum))

        total = regularity + float(sum(shares))
        return Evaluation(x, total, regularity, shares, advected, gradient, errors)

    def _mismatch(
        self, x: FloatArray
    ) -> tuple[tuple[float, ...], FloatArray, Callable[[], FloatArray]]:
        if self.is_of_landmarks:
            shares = self.misfit(self.carried - self.shift)[0]
            return (
                shares,
                advect_functions(self.advect, x, self.carried),
                partial(np.zeros, x.shape),
            )
        flow, gradient = self.advect(x), self.gradient(x)
        trajectories, advected = [], np.empty_like(self.carried)
        for c, f in enumerate(self.carried):
            trajectories.append(gradient.carry(flow, f))
            advected[c] = trajectories[c][-1].end
            if not np.isfinite(advected[c]).all():
                raise AdvectionError("the advected function overflows")
        shares, residuals = self.misfit(advected - self.shift)
        if not np.isfinite(sum(shares)):
            raise AdvectionError("the mismatch overflows")
        return shares, advected, partial(gradient.of_fields, flow, trajectories, residuals)


def advect_functions(
    advect: Callable[[FloatArray], Advection], x: FloatArray, functions: FloatArray
) -> FloatArray:
    """Return functions (C, V), carried by the flow of fields; constant ones stay as they are."""
    if not np.ptp(functions, axis=1).any():
        return functions
    flow = advect(x)
    return np.stack([flow.forward(f)[-1].end for f in functions])


class MatchingEnergy:
    """Regularity of the fields plus mismatch of what they carry, with exact or paper's gradient.

    ``E(v) = dtau/2 sum_j v_j^T G_F D_alpha v_j + 1/(2 sigma^2) sum_c w_c dg_c^T G_V C_beta dg_c``
    with ``dg = f_tau - g`` (Eq. 6), on ``mesh``, scaled to unit area by ``length_scale``.
    A norm of second order has ``D_alpha^2``, one in which the divergence weighs more than the curl
    that of `Regularizer`, and a relative sigma the unit of the functions.

    Parameters
    ----------
    problem : Problem
        Or what `Problem` takes: mesh, f, g, parameters and, by name, mask and weights.
    """

    def __init__(self, problem: Problem | MeshLike, *functions: Any, **given: Any) -> None:
        if not isinstance(problem, Problem):
            problem = Problem(problem, *functions, **given)
        self.problem, self.parameters = problem, problem.parameters
        self.mesh, self.length_scale = problem.mesh.normalized(), problem.mesh.length_scale
        self.functions, self.terms = problem.functions, DataTerms(problem.terms)
        self.landmarks = problem.landmarks
        alone = self.landmarks is not None and len(problem.terms) == 1
        self.is_of_landmarks = alone and self.functions.is_constant
        self.discretisation = Discretisation(self.mesh, self.parameters.paper.method)
        alpha, order = self.parameters.alpha, self.parameters.solver.order
        usual = regularizer(self.mesh, alpha, order, problem.divergence)
        self._regularizers = {alpha: usual}
        self._measures = {0.0: self.terms.measure(self.parameters, 0.0)}

    @property
    def words(self) -> tuple[str, ...]:
        """What the shares of the data terms are called."""
        words = tuple(term.word for term in self.terms.terms)
        return words if self.landmarks is None else (*words, self.landmarks.word)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape (N, F, 2) of the unknowns, the fields' frame coefficients, of the fewest fields."""
        return max(1, self.parameters.solver.segments), len(self.mesh.faces), 2

    def __call__(self, velocity: ArrayLike) -> tuple[float, FloatArray]:
        """Return the value and the Euclidean gradient (N, F, 3) at fields (N, F, 3) on `mesh`."""
        given = check_fields(velocity, (*self.shape[:2], 3), "velocity")
        found = self.objective(self.parameters.last_sigma).evaluate(to_frame(self.mesh, given))
        return found.energy, to_ambient(self.mesh, found.gradient)

    def objective(
        self,
        sigma: float,
        reach: float = 0.0,
        *,
        alpha: float | None = None,
        shift: FloatArray | float = 0.0,
        tolerance: float = TOLERANCE,
    ) -> Objective:
        """Return what is minimised with a sigma, and an alpha in place of the parameters'.

        A ``reach`` is that of the data terms; a shift (C, V) is taken off what was carried before
        they measure it; a tolerance truncates the advection, and the gradient is that of the
        truncated sum.
        """
        misfit = self.measure(reach).shares_and_residual
        return Objective(
            self.regularizer(alpha),
            self.terms.carried,
            partial(misfit, sigma=sigma),
            partial(self.discretisation.flow, tau=self.parameters.tau, tolerance=tolerance),
            self.parameters.tau,
            self._gradient,
            shift,
            self.landmark_misfit(self.parameters.landmark_sigma),
            self.is_of_landmarks,
        )

    def flow(self, x: FloatArray) -> Advection:
        """Return the flow of frame coefficients (N, F, 2)."""
        return self.discretisation.flow(x, self.parameters.tau)

    def clustered(self) -> MatchingEnergy:
        """Return the energy of functions with one value on each cluster of vertices."""
        energy = copy(self)  # with the same norms
        energy.discretisation = self.discretisation.clustered()
        return energy

    def with_mask(self, mask: FloatArray) -> MatchingEnergy:
        """Return the energy with another mask (V,) of source and target."""
        energy = MatchingEnergy(self.problem.with_mask(mask))
        energy._regularizers = self._regularizers  # the same norms, factored once for all
        return energy

    def regularizer(self, alpha: float | None = None) -> Regularizer:
        """Return the norm of fields with an alpha; of others than the parameters' one is kept."""
        known, usual = self._regularizers, self.parameters.alpha
        alpha = usual if alpha is None else alpha
        if alpha not in known:
            for other in known.keys() - {usual}:
                del known[other]
            order, divergence = known[usual].order, known[usual].divergence
            known[alpha] = Regularizer(self.mesh, alpha, order, divergence)
        return known[alpha]

    def measure(self, reach: float) -> Sum:
        """Return the norm of the data terms, for early stages with a reach."""
        if reach not in self._measures:
            self._measures[reach] = self.terms.measure(self.parameters, reach)
        return self._measures[reach]

    def residual(self, carried: FloatArray) -> float:
        """Return the residual of functions (C, V), see `FunctionTerm`."""
        return self.terms.residual(carried)

    def landmark_misfit(self, sigma: float) -> Callable[[FloatArray], LandmarkMisfit] | None:
        """Return what landmarks say of frame coefficients (N, F, 2), by their own sigma."""
        if self.landmarks is None:
            return None
        return partial(self.landmarks.misfit, tau=self.parameters.tau, sigma=sigma)

    def left(self, point: Evaluation, shift: FloatArray | float = 0.0) -> float:
        """Return the residual at an evaluation, of functions or of landmarks: the larger one."""
        return self._larger(point.advected - shift, point.landmark_errors)

    def residual_of(self, x: FloatArray, carried: FloatArray) -> float:
        """Return the same of fields (N, F, 2), and what they carried (C, V)."""
        return self._larger(carried, self.landmark_errors(x))

    def landmark_errors(self, x: FloatArray) -> FloatArray | None:
        """Return `Landmarks.errors_along` fields (N, F, 2), (L,); None without landmarks."""
        if self.landmarks is None:
            return None
        velocity = to_ambient(self.mesh, x)
        return self.landmarks.errors_along(self.mesh, velocity, self.parameters.tau)

    def _larger(self, carried: FloatArray, errors: FloatArray | None) -> float:
        of_terms = self.residual(carried)
        return of_terms if errors is None else max(of_terms, residual_of_errors(errors))

    def advected(self, x: FloatArray) -> FloatArray:
        """Carry the terms' functions (C, V) by (N, F, 2); not finite where the flow overflows."""
        try:
            return advect_functions(self.flow, x, self.terms.carried)
        except AdvectionError:
            return np.full_like(self.terms.carried, np.nan)

    def _gradient(self, x: FloatArray) -> Adjoint | Bracket:
        p = self.parameters
        if p.paper.gradient == "bracket" and p.paper.method == "nonlinear":
            return Bracket(self.mesh, x, p.paper.substeps, p.paper.quadrature)
        return Adjoint(x.shape)
