"""The matching energy (Eq. 3, discretised in Eq. 6) of a problem, for every stage of a match."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.vector_fields import to_ambient, to_frame
from abfm.errors import AdvectionError
from abfm.flow.advection import Advection, Discretisation
from abfm.flow.exponential import TOLERANCE
from abfm.matching.objective.bracket import Bracket
from abfm.matching.objective.objective import Adjoint, Gradient, Mismatch, Objective, RegularityTerm
from abfm.matching.objective.regularizer import Regularizer, regularizer
from abfm.matching.problem import Problem, check_fields
from abfm.matching.terms.data_term import DataTerms, Measure
from abfm.mesh import TriangleMesh
from abfm.parameters import Parameters
from abfm.types import FloatArray


class MatchingEnergy:
    """Regularity of the fields plus mismatch of what they carry, with exact or paper's gradient.

    ``E(v) = dtau/2 sum_j v_j^T G_F D_alpha v_j + 1/(2 sigma^2) sum_c w_c dg_c^T G_V C_beta dg_c``
    with ``dg = f_tau - g`` (Eq. 6); the mesh is scaled to unit area. A norm of second order has
    ``D_alpha^2``, a sigma that is relative is multiplied by `function_size`, and early stages
    measure ``dg`` with a `reach`. Each such choice is an `objective`.

    Parameters
    ----------
    problem : Problem
        Or what `Problem` takes: mesh, f, g, parameters and, by name, mask and weights.

    Attributes
    ----------
    mesh : TriangleMesh
        That of unit area.
    length_scale : float
        Of the mesh as it was given: what one length of `mesh` is there.
    discretisation : Discretisation
    """

    def __init__(self, problem: Problem | TriangleMesh, *functions: Any, **given: Any) -> None:
        if not isinstance(problem, Problem):
            problem = Problem(problem, *functions, **given)
        self.problem, self.parameters = problem, problem.parameters
        self.mesh, self.length_scale = problem.mesh.normalized(), problem.mesh.length_scale
        self.functions, self.terms = problem.functions, DataTerms(problem.terms)
        self.discretisation = Discretisation(self.mesh, self.parameters.method)
        self._norms = _Norms(self.mesh, self.parameters, self.terms)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape (N, F, 2) of the unknowns, the fields' frame coefficients."""
        return self.parameters.segments, len(self.mesh.faces), 2

    @property
    def step(self) -> float:
        """Time of each field."""
        return self.parameters.tau / self.parameters.segments

    def __call__(self, velocity: ArrayLike) -> tuple[float, FloatArray]:
        """Return the value and the Euclidean gradient (N, F, 3) at fields (N, F, 3) on `mesh`."""
        given = check_fields(velocity, (*self.shape[:2], 3), "velocity")
        found = self.objective(self.parameters.sigma).evaluate(to_frame(self.mesh, given))
        return found.energy, to_ambient(self.mesh, found.gradient)

    def objective(
        self,
        sigma: float,
        reach: float = 0.0,
        *,
        alpha: float | None = None,
        offset: FloatArray | None = None,
        tolerance: float = TOLERANCE,
    ) -> Objective:
        """Return what is minimised with a sigma, and an alpha in place of the parameters'.

        A ``reach`` is that of the data terms; an ``offset`` (C, V) is what they may leave;
        ``tolerance`` truncates the advection, and the gradient is that of the truncated sum.
        """
        return Objective(
            self.regularizer(alpha),
            Mismatch(self.terms.carried, self.measure(reach), sigma, offset),
            partial(self.discretisation.flow, tau=self.parameters.tau, tolerance=tolerance),
            self.step,
            self._gradient,
        )

    def flow(self, fields: FloatArray) -> Advection:
        """Return the flow of frame coefficients (N, F, 2)."""
        return self.discretisation.flow(fields, self.parameters.tau)

    def clustered(self) -> MatchingEnergy:
        """Return the energy of functions with one value on each cluster of vertices."""
        energy = MatchingEnergy(self.problem)
        energy.discretisation, energy._norms = self.discretisation.clustered(), self._norms
        return energy

    def regularizer(self, alpha: float | None = None) -> RegularityTerm:
        """Return the norm of fields, with the parameters' alpha or another one."""
        return self._norms.of_fields(self.parameters.alpha if alpha is None else alpha)

    def measure(self, reach: float) -> Measure:
        """Return the norm of the data terms, for early stages with a reach."""
        return self._norms.of_mismatches(reach)

    def mismatch_energy(self, carried: FloatArray, sigma: float) -> float:
        """Return the data terms' energy for functions (C, V) that were carried by any means."""
        return self.measure(0.0).value(carried, sigma)

    def relative_mismatch(self, carried: FloatArray) -> float:
        """Return ``||f_tau - g|| / ||g||`` of functions (C, V), see `FunctionTerm`."""
        return self.terms.relative_mismatch(carried)

    def advected(self, fields: FloatArray) -> FloatArray:
        """Carry the terms' functions (C, V) by (N, F, 2); not finite where the flow overflows."""
        try:
            flow = self.flow(fields)
            return np.stack([flow.forward(f)[-1].end for f in self.terms.carried])
        except AdvectionError:
            return np.full_like(self.terms.carried, np.nan)

    def _gradient(self, fields: FloatArray) -> Gradient:
        p = self.parameters
        if p.gradient == "bracket" and p.method == "nonlinear":
            return Bracket(self.mesh, fields, p.substeps, p.quadrature)
        return Adjoint(fields.shape)


class _Norms:
    """Norms of fields and of mismatches, each made when it is first asked for."""

    def __init__(self, mesh: TriangleMesh, parameters: Parameters, terms: DataTerms) -> None:
        self._mesh, self._parameters, self._terms = mesh, parameters, terms
        usual = regularizer(mesh, parameters.alpha, parameters.order)
        self._regularizers: dict[float, RegularityTerm] = {parameters.alpha: usual}
        self._measures: dict[float, Measure] = {0.0: terms.measure(parameters, 0.0)}

    def of_fields(self, alpha: float) -> RegularityTerm:
        """Keep the latest other one: on a large mesh each has factors of hundreds of megabytes."""
        usual = self._parameters.alpha
        if alpha not in self._regularizers:
            for other in self._regularizers.keys() - {usual}:
                del self._regularizers[other]
            self._regularizers[alpha] = Regularizer(self._mesh, alpha, self._parameters.order)
        return self._regularizers[alpha]

    def of_mismatches(self, reach: float) -> Measure:
        if reach not in self._measures:
            self._measures[reach] = self._terms.measure(self._parameters, reach)
        return self._measures[reach]
