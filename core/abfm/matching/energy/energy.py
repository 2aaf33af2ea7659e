"""The matching energy (Eq. 3, discretised in Eq. 6) and its gradient by the fields."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.vector_fields import to_ambient, to_frame
from abfm.errors import AdvectionError, FunctionError, ParameterError
from abfm.flow.advection import Advection
from abfm.flow.derivative_pattern import clustered_pattern
from abfm.flow.exponential import TOLERANCE, ExponentialFlow, Workspace
from abfm.matching.energy.bracket import BracketGradient
from abfm.matching.energy.problem import Problem
from abfm.matching.energy.terms import DataTerm, RegularityTerm, data_term, regularity_term
from abfm.mesh import TriangleMesh
from abfm.numerics import kernels
from abfm.parameters import Parameters
from abfm.real_numbers import real_numbers
from abfm.types import FloatArray


@dataclass(frozen=True)
class Evaluation:
    """The energy at one point.

    Attributes
    ----------
    energy, regularity, mismatch : float
        Total and its two terms; infinite where the flow overflows.
    advected : (C, V) array
        Source carried to the end time.
    differentiate : callable
        Computes the gradient; faster before than after the next evaluation of the energy.
    """

    energy: float
    regularity: float
    mismatch: float
    advected: FloatArray
    differentiate: Callable[[], FloatArray]

    @cached_property
    def gradient(self) -> FloatArray:
        """Derivative by the frame coefficients of the fields, (N, F, 2), computed when first asked for."""
        return self.differentiate()


class MatchingEnergy(Problem):
    """Regularity of the fields plus mismatch of the advected source, with the exact or the paper's gradient.

    ``E(v) = dtau/2 sum_j v_j^T G_F D_alpha v_j + 1/(2 sigma^2) sum_c w_c dg_c^T G_V C_beta dg_c`` with
    ``dg = f_tau - g`` (Eq. 6); the mesh is scaled to unit area. A norm of second order has ``D_alpha^2``, a sigma that
    is relative is multiplied by `function_size`, and early stages measure ``dg`` with a `reach`.

    Parameters
    ----------
    mesh : TriangleMesh
    f, g : (V,) or (V, C) arrays
        Source and target.
    parameters : Parameters
    mask : (V,) array, optional
        Weight of the mismatch at each vertex, not negative.
    weights : (C,) array, optional
        Weight of each channel's mismatch, not negative.

    Attributes
    ----------
    function_size : float
        The larger of the two functions' deviations from their means, in L2 with mask and weights, all channels
        together; 1 where both are constant.
    vertex_count : int
        Values of a function that is advected: vertices, or clusters of them.
    """

    def __init__(
        self,
        mesh: TriangleMesh,
        f: ArrayLike,
        g: ArrayLike,
        parameters: Parameters,
        mask: ArrayLike | None = None,
        weights: ArrayLike | None = None,
    ) -> None:
        super().__init__(mesh.normalized(), f, g, mask, weights)
        self.length_scale = mesh.length_scale
        self.parameters = parameters
        self.shape = (parameters.segments, len(mesh.faces), 2)
        self.step = parameters.tau / parameters.segments
        self.vertex_count = len(mesh.vertices)  # values of a function that is advected, one a vertex or a cluster
        self._clustered = False
        self._workspace = Workspace(len(mesh.vertices))
        self._regularizers = {parameters.alpha: regularity_term(self.mesh, parameters, parameters.alpha)}
        self._data_terms = {0.0: data_term(self, parameters, 0.0)}

    def __call__(self, velocity: ArrayLike) -> tuple[float, FloatArray]:
        """Value, and Euclidean gradient (N, F, 3), at fields (N, F, 3) on the mesh scaled to unit area."""
        result = self.evaluate(to_frame(self.mesh, check_fields(velocity, self.shape)), self.parameters.sigma)
        return result.energy, to_ambient(self.mesh, result.gradient)

    def flow(self, fields: FloatArray, tolerance: float = TOLERANCE) -> Advection:
        """The flow of frame coefficients (N, F, 2)."""
        p = self.parameters
        linearised = p.method == "linearised"
        return Advection(self.mesh, fields, p.tau, linearised, self._workspace, tolerance, self._clustered)

    def evaluate(
        self,
        fields: FloatArray,
        sigma: float,
        reach: float = 0.0,
        target: FloatArray | None = None,
        tolerance: float = TOLERANCE,
        alpha: float | None = None,
        between: Callable[[], None] = lambda: None,
    ) -> Evaluation:
        """Energy and gradient at frame coefficients (N, F, 2), with ``sigma`` and ``alpha`` for the parameters'.

        A ``reach`` is that of the data term; a ``target`` (C, V) takes the place of g; ``tolerance`` truncates the
        advection, and the gradient is that of the truncated sum. Long gradients call ``between`` again and again; what
        it raises ends them.
        """
        apply = self.regularizer(alpha).apply
        with np.errstate(over="ignore", invalid="ignore"):
            momentum = self.step * np.stack([apply(v) for v in fields])
        regularity = 0.5 * kernels.inner(momentum.ravel(), np.ascontiguousarray(fields).ravel())
        try:
            with np.errstate(over="ignore", invalid="ignore"):  # an unstable flow ends in any numbers
                mismatch, advected, gradient = self._mismatch(fields, sigma, reach, target, tolerance, between)
            if not np.isfinite(mismatch):
                raise AdvectionError("the mismatch overflows")
        except AdvectionError:
            nowhere = np.full(self.shape, np.nan)
            mismatch, advected, gradient = np.inf, np.full_like(self.source, np.nan), lambda: nowhere
        return Evaluation(regularity + mismatch, regularity, mismatch, advected, lambda: momentum + gradient())

    def mismatch_energy(self, advected: FloatArray, sigma: float) -> float:
        """The second term of the energy for a source (C, V) that was carried by whatever means."""
        value_and_residual = self.data_term(0.0).value_and_residual
        values = [value_and_residual(*each)[0] for each in zip(advected, self.target, self.weights, strict=True)]
        return float(sum(values) / self.sigma(sigma) ** 2)

    def sigma(self, sigma: float) -> float:
        """The sigma of the energy, in the functions' unit, for one as the parameters give it."""
        return sigma * self.function_size if self.parameters.sigma_unit == "relative" else sigma

    def _weight(self, channel: int, sigma: float) -> float:
        scale = float(self.sigma(sigma))
        try:
            return float(self.weights[channel]) / scale**2
        except (OverflowError, ZeroDivisionError):
            raise FunctionError(
                f"sigma in the functions' unit is {scale:.3g}, whose square over- or underflows; scale the functions, "
                "mask, weights or sigma to usual sizes"
            ) from None

    def clustered(self) -> MatchingEnergy:
        """The same energy for functions that have one value on each cluster of vertices, see `abfm.flow.clusters`."""
        energy = copy(self)
        energy._clustered = True
        energy.vertex_count = clustered_pattern(self.mesh).size
        energy._workspace = Workspace(energy.vertex_count)
        return energy

    def regularizer(self, alpha: float | None = None) -> RegularityTerm:
        """The norm of fields, with the parameters' alpha or another one.

        The latest other one is kept: on a large mesh the factors of each take hundreds of megabytes.
        """
        usual = self.parameters.alpha
        alpha = usual if alpha is None else alpha
        if alpha not in self._regularizers:
            for other in self._regularizers.keys() - {usual}:
                del self._regularizers[other]
            self._regularizers[alpha] = regularity_term(self.mesh, self.parameters, alpha)
        return self._regularizers[alpha]

    def data_term(self, reach: float) -> DataTerm:
        """What measures the mismatch, of early stages with a reach."""
        if reach not in self._data_terms:
            self._data_terms[reach] = data_term(self, self.parameters, reach)
        return self._data_terms[reach]

    def _mismatch(
        self,
        fields: FloatArray,
        sigma: float,
        reach: float,
        target: FloatArray | None,
        tolerance: float,
        between: Callable[[], None],
    ) -> tuple[float, FloatArray, Callable[[], FloatArray]]:
        flow = self.flow(fields, tolerance)
        value_and_residual = self.data_term(reach).value_and_residual
        target = self.target if target is None else target
        advected, residuals = np.empty_like(self.source), np.empty_like(self.source)
        mismatch = 0.0
        by_bracket = self.parameters.gradient == "bracket" and self.parameters.method == "nonlinear"
        trajectories = []
        for c, f in enumerate(self.source):
            trajectories.append(flow.forward(f, keep=not by_bracket))
            advected[c] = trajectories[c][-1].end
            if not np.isfinite(advected[c]).all():
                raise AdvectionError("the advected function overflows")
            weight = self._weight(c, sigma)
            value, residuals[c] = value_and_residual(advected[c], target[c], weight)
            mismatch += value

        def differentiate() -> FloatArray:
            if by_bracket:
                return self._bracket_gradient(fields, flow, residuals, between)
            gradient = np.zeros(self.shape)
            for trajectory, residual in zip(trajectories, residuals, strict=True):
                flow.backward(trajectory, residual, gradient)
            return gradient

        return mismatch, advected, differentiate

    def _bracket_gradient(
        self, fields: FloatArray, flow: Advection, residuals: FloatArray, between: Callable[[], None]
    ) -> FloatArray:
        p = self.parameters
        starts = [[trajectory.segments[0].start for trajectory in flow.forward(f)] for f in self.source]
        gradient = np.empty(self.shape)
        for j in reversed(range(p.segments)):
            part = flow.parts[j]
            assert isinstance(part, ExponentialFlow)
            bracket = BracketGradient(self.mesh, fields[j], part, p.substeps, p.quadrature, between)
            sources = sum(bracket.sources(starts[c][j], self.step, mu) for c, mu in enumerate(residuals))
            gradient[j] = bracket.gradient(np.asarray(sources), self.step)
            if j:
                residuals = np.stack([part.transposed().forward(mu, self.step).end for mu in residuals])
        return gradient

    def exponent(self, fields: FloatArray) -> float:
        """Spectral bound times time of the flow of frame coefficients (N, F, 2): about what an advection costs."""
        parts = self.flow(fields).parts
        return self.step * sum(part.rho for part in parts if isinstance(part, ExponentialFlow))

    def advected(self, fields: FloatArray) -> FloatArray:
        """The source (C, V) carried by frame coefficients (N, F, 2); not finite where the flow overflows."""
        try:
            flow = self.flow(fields)
            return np.stack([flow.forward(f)[-1].end for f in self.source])
        except AdvectionError:
            return np.full_like(self.source, np.nan)


def check_fields(velocity: ArrayLike, shape: tuple[int, int, int], name: str = "velocity") -> FloatArray:
    """Fields as (N, F, 3), for the shape (N, F, 2) of the unknowns; one field may come as (F, 3).

    Raises
    ------
    ParameterError
        If the shape is another one or a value is not finite.
    """
    field = real_numbers(velocity, name, ParameterError)
    expected = (*shape[:2], 3)
    if field.shape == expected[1:] and expected[0] == 1:
        field = field[None]
    if field.shape != expected:
        raise ParameterError(f"{name} has shape {field.shape}; expected {expected}")
    if not np.isfinite(field).all():
        raise ParameterError(f"{name} has values that are not finite")
    return field
