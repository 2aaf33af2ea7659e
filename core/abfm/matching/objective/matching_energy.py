"""The matching energy of a problem (Eq. 3, discretised in Eq. 6) and its gradient."""

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
    """The value of an objective at some fields, with its terms and its gradient."""

    x: FloatArray  # frame coefficients (N, F, 2) of the fields
    energy: float  # the sum of all terms; infinite if the flow overflows
    regularity: float
    term_energies: tuple[float, ...]  # energy of each data term
    advected: FloatArray  # the sources of all data terms at tau, (C, V)
    differentiate: Callable[[], FloatArray]  # returns the gradient; fast until the next evaluation
    # errors of landmarks, (L,); None without landmarks, or if the flow overflows
    landmark_errors: FloatArray | None = None

    @property
    def mismatch(self) -> float:
        return float(sum(self.term_energies))

    @cached_property
    def gradient(self) -> FloatArray:
        """The derivative of the energy by ``x``, (N, F, 2), computed at the first use."""
        return self.differentiate()


@dataclass(frozen=True)
class Adjoint:
    """The exact derivative of the discrete flow, computed by its adjoint."""

    shape: tuple[int, ...]

    def advect(self, flow: Advection, f: FloatArray) -> list[Trajectory]:
        return flow.forward(f, keep=True)

    def differentiate_fields(
        self, flow: Advection, trajectories: Sequence[list[Trajectory]], residuals: FloatArray
    ) -> FloatArray:
        gradient = np.zeros(self.shape)
        for trajectory, residual in zip(trajectories, residuals, strict=True):
            flow.backward(trajectory, residual, gradient)
        return gradient


@dataclass(frozen=True, eq=False)
class Bracket:
    """The derivative of the paper by Lie brackets (Eq. 9 and section 7).

    For one field and ``dt = t / n`` the derivative is ``-(dt / (k+1)) sum_s exp(s dt / k ad_v)^T
    sum_r D̄_{f_(r-1)}^T exp(-(n - r) dt D_v)^T mu``.

    The sums are over s = 0 to k and r = 1 to n. Here ``f_r`` is the source after r substeps, and
    ``mu`` the derivative by the advected function.
    """

    mesh: TriangleMesh
    fields: FloatArray  # (N, F, 2)
    substeps: int  # the number n of the formula
    quadrature: int  # the number k of the formula

    def advect(self, flow: Advection, f: FloatArray) -> list[Trajectory]:
        return flow.forward(f)

    def differentiate_fields(
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
        """Return the sum over r in the formula of `Bracket`, for one channel, as (2F,).

        ``mu`` (V,) is the derivative by the advected function.
        """
        states = [f]
        for _ in range(self.substeps - 1):
            checkpoint()
            states.append(flow.forward(states[-1], dt).end)
        backward = flow.transposed()
        total = np.zeros(2 * len(self.mesh.faces))
        for index, state in enumerate(reversed(states)):
            checkpoint()
            if index or self.substeps == 1:  # the n-step form lacks a factor of Eq. 9
                mu = backward.forward(mu, dt).end
            total += dual_directional_derivative(self.mesh, state).T @ mu
        return total

    def _integral(self, v: FloatArray, sources: FloatArray, dt: float) -> FloatArray:
        """Return the derivative by ``v`` (F, 2) from the sums over r, by integration over s."""
        bracket = Matrix(lie_bracket(self.mesh, v).T.tocsr())
        total = term = sources
        for _ in range(self.quadrature):
            checkpoint()
            term = exponential_action(bracket, term, dt / self.quadrature)
            total = total + term
        return (-dt / (self.quadrature + 1) * total).reshape(-1, 2)


@dataclass(frozen=True, eq=False)
class Objective:
    """The function to minimise: ``dtau/2 sum_j v_j^T R v_j`` plus data terms (Eq. 6).

    Here ``dtau`` is ``tau / N`` for N fields. The data terms measure how far the advected functions
    are from the targets, and the advected landmarks from their target points.
    """

    regularity: Regularizer  # matrix ``R`` of the norm
    sources: FloatArray  # the sources of all data terms, (C, V)
    # energies of the data terms, and the derivative of their sum by the advected functions
    misfit: Callable[[FloatArray], tuple[tuple[float, ...], FloatArray]]
    flow: Callable[[FloatArray], Advection]  # the flow of frame coefficients (N, F, 2)
    tau: float
    gradient: Callable[[FloatArray], Adjoint | Bracket]  # derivative at (N, F, 2)
    shift: FloatArray | float = 0.0  # subtracted from the advected functions
    # the landmark term at frame coefficients (N, F, 2)
    landmarks: Callable[[FloatArray], LandmarkMisfit] | None = None
    is_of_landmarks: bool = False  # whether only landmarks are matched

    def evaluate(self, x: FloatArray) -> Evaluation:
        """Evaluate the objective at frame coefficients (N, F, 2)."""
        with np.errstate(over="ignore", invalid="ignore"):  # unstable flows may overflow
            momentum = self.tau / len(x) * np.stack([self.regularity.apply(v) for v in x])
            regularity = 0.5 * kernels.inner(momentum.ravel(), np.ascontiguousarray(x).ravel())
            try:
                energies, advected, differentiate = self._mismatch(x)
            except AdvectionError:
                energies, differentiate = (np.inf,), partial(np.full, x.shape, np.nan)
                advected = np.full_like(self.sources, np.nan)
            derivatives, errors = [differentiate], None
            if self.landmarks is not None and np.isfinite(sum(energies)):
                try:
                    misfit = self.landmarks(x)
                except AdvectionError:
                    energies = (np.inf,)
                else:
                    energies, errors = (*energies, misfit.energy), misfit.errors
                    derivatives.append(misfit.differentiate)

        def gradient() -> FloatArray:
            return np.asarray(sum((by() for by in derivatives), momentum))

        total = regularity + float(sum(energies))
        return Evaluation(x, total, regularity, energies, advected, gradient, errors)

    def _mismatch(
        self, x: FloatArray
    ) -> tuple[tuple[float, ...], FloatArray, Callable[[], FloatArray]]:
        if self.is_of_landmarks:
            energies = self.misfit(self.sources - self.shift)[0]
            advected = advect_functions(self.flow, x, self.sources)
            return energies, advected, partial(np.zeros, x.shape)
        flow, gradient = self.flow(x), self.gradient(x)
        trajectories, advected = [], np.empty_like(self.sources)
        for c, f in enumerate(self.sources):
            trajectories.append(gradient.advect(flow, f))
            advected[c] = trajectories[c][-1].end
            if not np.isfinite(advected[c]).all():
                raise AdvectionError("the advected function overflows")
        energies, derivatives = self.misfit(advected - self.shift)
        if not np.isfinite(sum(energies)):
            raise AdvectionError("the mismatch overflows")
        derivative = partial(gradient.differentiate_fields, flow, trajectories, derivatives)
        return energies, advected, derivative


def advect_functions(
    flow_of: Callable[[FloatArray], Advection], x: FloatArray, functions: FloatArray
) -> FloatArray:
    """Return functions (C, V) advected by the flow of fields ``x`` (N, F, 2).

    If all functions are constant, they are returned without computing the flow.
    """
    if not np.ptp(functions, axis=1).any():
        return functions
    flow = flow_of(x)
    return np.stack([flow.forward(f)[-1].end for f in functions])


class MatchingEnergy:
    """The energy of fields: their regularity plus the mismatch of the advected functions.

    ``E(v) = dtau/2 sum_j v_j^T G_F D_alpha v_j + 1/(2 sigma^2) sum_c w_c dg_c^T G_V C_beta dg_c``
    with ``dg = f_tau - g`` (Eq. 6). The energy refers to ``mesh``, which is scaled to unit area by
    dividing lengths by ``length_scale``. The norm of second order has ``D_alpha^2`` in place of
    ``D_alpha``. `Regularizer` describes the weight of the divergence. A relative sigma is
    multiplied by the size of the functions. The gradient is exact, or that of the paper.

    Parameters
    ----------
    problem : Problem, or a mesh
        With a mesh, the other arguments are those of `Problem`: f, g, parameters and, by name, mask
        and weights.
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
    def term_names(self) -> tuple[str, ...]:
        """The names of the data terms."""
        names = tuple(term.name for term in self.terms.terms)
        return names if self.landmarks is None else (*names, self.landmarks.name)

    @property
    def shape(self) -> tuple[int, int, int]:
        """The shape (N, F, 2) of frame coefficients; N is ``segments``, but at least 1."""
        return max(1, self.parameters.solver.segments), len(self.mesh.faces), 2

    def __call__(self, velocity: ArrayLike) -> tuple[float, FloatArray]:
        """Return the value and the Euclidean gradient (N, F, 3) at fields (N, F, 3) on `mesh`."""
        fields = check_fields(velocity, (*self.shape[:2], 3), "velocity")
        found = self.objective(self.parameters.last_sigma).evaluate(to_frame(self.mesh, fields))
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
        """Return the objective to minimise for one value of sigma.

        Parameters
        ----------
        sigma : float
        reach : float
            Distance over which the data terms compare functions, as a fraction of sqrt(area). 0
            compares them point by point, as in the paper.
        alpha : float, optional
            Value that replaces alpha of the parameters.
        shift : (C, V) array, optional
            Functions that are subtracted from the advected functions before the comparison with the
            target.
        tolerance : float
            Tolerance at which the series of the advection is truncated. The gradient is that of the
            truncated series.
        """
        misfit = self.measure(reach).energies_and_derivative
        return Objective(
            self.regularizer(alpha),
            self.terms.sources,
            partial(misfit, sigma=sigma),
            partial(self.discretisation.flow, tau=self.parameters.tau, tolerance=tolerance),
            self.parameters.tau,
            self._gradient,
            shift,
            self.landmark_misfit(self.parameters.landmark_sigma),
            self.is_of_landmarks,
        )

    def flow(self, x: FloatArray) -> Advection:
        return self.discretisation.flow(x, self.parameters.tau)

    def clustered(self) -> MatchingEnergy:
        """Return the energy for functions that are constant on each cluster of vertices.

        Clusters make the flow cheaper, see ``abfm.flow.clusters``.
        """
        energy = copy(self)  # the copy shares the norms
        energy.discretisation = self.discretisation.clustered()
        return energy

    def with_mask(self, mask: FloatArray) -> MatchingEnergy:
        """Return the energy with another mask (V,) of source and target."""
        energy = MatchingEnergy(self.problem.with_mask(mask))
        energy._regularizers = self._regularizers  # both energies share the factorisations
        return energy

    def regularizer(self, alpha: float | None = None) -> Regularizer:
        """Return the norm of fields for a value of alpha, by default that of the parameters.

        The norms for the default and for one other value are cached.
        """
        known, usual = self._regularizers, self.parameters.alpha
        alpha = usual if alpha is None else alpha
        if alpha not in known:
            for other in known.keys() - {usual}:
                del known[other]
            order, divergence = known[usual].order, known[usual].divergence
            known[alpha] = Regularizer(self.mesh, alpha, order, divergence)
        return known[alpha]

    def measure(self, reach: float) -> Sum:
        """Return the energies of the data terms, in a norm that smooths over a distance ``reach``.

        With reach 0, functions are compared point by point.
        """
        if reach not in self._measures:
            self._measures[reach] = self.terms.measure(self.parameters, reach)
        return self._measures[reach]

    def residual(self, advected: FloatArray) -> float:
        return self.terms.residual(advected)

    def landmark_misfit(self, sigma: float) -> Callable[[FloatArray], LandmarkMisfit] | None:
        """Return the landmark term as a function of frame coefficients (N, F, 2).

        ``sigma`` is the tolerance of the landmarks. None if the problem has no landmarks.
        """
        if self.landmarks is None:
            return None
        return partial(self.landmarks.misfit, tau=self.parameters.tau, sigma=sigma)

    def residual_at(self, point: Evaluation, shift: FloatArray | float = 0.0) -> float:
        """Return the residual at an evaluation: the larger one of functions and landmarks.

        The functions ``shift`` (C, V) are subtracted from the advected functions.
        """
        return self._worse_residual(point.advected - shift, point.landmark_errors)

    def residual_of(self, x: FloatArray, advected: FloatArray) -> float:
        """Return the residual of fields (N, F, 2): the larger one of functions and landmarks.

        ``advected`` are the sources (C, V) advected by these fields.
        """
        return self._worse_residual(advected, self.landmark_errors(x))

    def landmark_errors(self, x: FloatArray) -> FloatArray | None:
        """Return the landmark errors (L,) along flow lines of fields (N, F, 2).

        None if the problem has no landmarks.
        """
        if self.landmarks is None:
            return None
        return self.landmarks.errors_along(self.mesh, to_ambient(self.mesh, x), self.parameters.tau)

    def _worse_residual(self, advected: FloatArray, errors: FloatArray | None) -> float:
        of_terms = self.residual(advected)
        return of_terms if errors is None else max(of_terms, residual_of_errors(errors))

    def advected(self, x: FloatArray) -> FloatArray:
        """Return the sources (C, V) advected by fields (N, F, 2); NaN if the flow overflows."""
        try:
            return advect_functions(self.flow, x, self.terms.sources)
        except AdvectionError:
            return np.full_like(self.terms.sources, np.nan)

    def _gradient(self, x: FloatArray) -> Adjoint | Bracket:
        p = self.parameters
        if p.paper.gradient == "bracket" and p.paper.method == "nonlinear":
            return Bracket(self.mesh, x, p.paper.substeps, p.paper.quadrature)
        return Adjoint(x.shape)
