"""The matching energy (Eq. 3, discretised in Eq. 6) and its gradient by the fields."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from abfm import kernels
from abfm.advection import Flow
from abfm.bracket import BracketGradient
from abfm.channels import channels
from abfm.errors import FunctionError, ParameterError
from abfm.exponential import TOLERANCE, AdvectionError, ExponentialFlow, Workspace
from abfm.mesh import FloatArray, TriangleMesh
from abfm.operators import function_norm_matrix, l2_norm
from abfm.parameters import Parameters
from abfm.regularizer import regularizer
from abfm.vector_fields import to_ambient, to_frame


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


class MatchingEnergy:
    """Regularity of the fields plus mismatch of the advected source, with the exact or the paper's gradient.

    ``E(v) = dtau/2 sum_j v_j^T G_F D_alpha v_j + 1/(2 sigma^2) sum_c w_c dg_c^T G_V C_beta dg_c`` with
    ``dg = f_tau - g`` (Eq. 6); the mesh is scaled to unit area.

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
        self.mesh = mesh.normalized()
        self.length_scale = mesh.length_scale
        self.parameters = parameters
        self.source, self.target = channels(mesh, f, "source"), channels(mesh, g, "target")
        if len(self.source) != len(self.target):
            raise FunctionError(
                f"source has {len(self.source)} and target {len(self.target)} channels; give as many of each"
            )
        self.mask = None
        if mask is not None:
            of_vertices = np.asarray(mask)
            if of_vertices.shape == (mesh.file_vertex_count,):
                of_vertices = mesh.restrict(of_vertices)
            self.mask = _weights(of_vertices, len(mesh.vertices), "mask")
        self.weights = np.ones(len(self.source)) if weights is None else _weights(weights, len(self.source), "weights")
        self.metric = function_norm_matrix(self.mesh, parameters.beta, self.mask)
        self.regularizer = regularizer(self.mesh, parameters.alpha)
        self.shape = (parameters.segments, len(mesh.faces), 2)
        self.step = parameters.tau / parameters.segments
        self._workspace = Workspace(self.mesh)

    def __call__(self, velocity: ArrayLike) -> tuple[float, FloatArray]:
        """Value, and Euclidean gradient (N, F, 3), at fields (N, F, 3) on the mesh scaled to unit area."""
        result = self.evaluate(to_frame(self.mesh, check_fields(velocity, self.shape)), self.parameters.sigma)
        return result.energy, to_ambient(self.mesh, result.gradient)

    def flow(self, fields: FloatArray, tolerance: float = TOLERANCE) -> Flow:
        """The flow of frame coefficients (N, F, 2)."""
        linearised = self.parameters.method == "linearised"
        return Flow(self.mesh, fields, self.parameters.tau, linearised, self._workspace, tolerance)

    def evaluate(self, fields: FloatArray, sigma: float, tolerance: float = TOLERANCE) -> Evaluation:
        """Energy and gradient at frame coefficients (N, F, 2), with ``sigma`` in place of the parameters'.

        ``tolerance`` truncates the advection; the gradient is that of the truncated sum.
        """
        momentum = self.step * np.stack([self.regularizer.apply(v) for v in fields])
        regularity = 0.5 * kernels.inner(momentum.ravel(), np.ascontiguousarray(fields).ravel())
        try:
            mismatch, advected, gradient = self._mismatch(fields, sigma, tolerance)
        except AdvectionError:
            nowhere = np.full(self.shape, np.nan)
            mismatch, advected, gradient = np.inf, np.full_like(self.source, np.nan), lambda: nowhere
        return Evaluation(regularity + mismatch, regularity, mismatch, advected, lambda: momentum + gradient())

    def _mismatch(
        self, fields: FloatArray, sigma: float, tolerance: float
    ) -> tuple[float, FloatArray, Callable[[], FloatArray]]:
        flow = self.flow(fields, tolerance)
        advected = np.empty_like(self.source)
        mismatch = 0.0
        by_bracket = self.parameters.gradient == "bracket" and self.parameters.method == "nonlinear"
        residuals = np.empty_like(self.source)
        trajectories = []
        for c, f in enumerate(self.source):
            trajectories.append(flow.forward(f, keep=not by_bracket))
            advected[c] = trajectories[c][-1].end
            if not np.isfinite(advected[c]).all():
                raise AdvectionError("the advected function overflows")
            difference = advected[c] - self.target[c]
            residuals[c] = self.weights[c] / sigma**2 * kernels.product(self.metric, difference)
            mismatch += 0.5 * kernels.inner(residuals[c], difference)

        def differentiate() -> FloatArray:
            if by_bracket:
                return self._bracket_gradient(fields, flow, residuals)
            gradient = np.zeros(self.shape)
            for trajectory, residual in zip(trajectories, residuals, strict=True):
                flow.backward(trajectory, residual, gradient)
            return gradient

        return mismatch, advected, differentiate

    def _bracket_gradient(self, fields: FloatArray, flow: Flow, residuals: FloatArray) -> FloatArray:
        p = self.parameters
        starts = [[trajectory.segments[0].start for trajectory in flow.forward(f)] for f in self.source]
        gradient = np.empty(self.shape)
        for j in reversed(range(p.segments)):
            part = flow.parts[j]
            assert isinstance(part, ExponentialFlow)
            bracket = BracketGradient(self.mesh, fields[j], part, p.substeps, p.quadrature)
            sources = sum(bracket.sources(starts[c][j], self.step, mu) for c, mu in enumerate(residuals))
            gradient[j] = bracket.gradient(np.asarray(sources), self.step)
            if j:
                residuals = np.stack([part.transposed().forward(mu, self.step).end for mu in residuals])
        return gradient

    def relative_mismatch(self, advected: FloatArray) -> float:
        """``||f_tau - g|| / ||g||`` in L2 over all channels (C, V), with mask and weights; ``||f||`` where g is 0."""
        root = np.sqrt(self.weights)

        def norm(functions: FloatArray) -> float:
            return l2_norm(self.mesh, (root[:, None] * functions).T, self.mask)

        scale = norm(self.target) or norm(self.source) or 1.0
        return norm(advected - self.target) / scale


def _weights(values: ArrayLike, count: int, name: str) -> FloatArray:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != (count,):
        raise ParameterError(f"{name} has shape {array.shape}; expected ({count},)")
    if not np.isfinite(array).all() or (array < 0).any() or not array.any():
        raise ParameterError(f"{name} must be finite, not negative, and not zero everywhere")
    return array


def check_fields(velocity: ArrayLike, shape: tuple[int, int, int], name: str = "velocity") -> FloatArray:
    """Fields as (N, F, 3), for the shape (N, F, 2) of the unknowns; one field may come as (F, 3).

    Raises
    ------
    ParameterError
        If the shape is another one or a value is not finite.
    """
    field = np.asarray(velocity, dtype=np.float64)
    expected = (*shape[:2], 3)
    if field.shape == expected[1:] and expected[0] == 1:
        field = field[None]
    if field.shape != expected:
        raise ParameterError(f"{name} has shape {field.shape}; expected {expected}")
    if not np.isfinite(field).all():
        raise ParameterError(f"{name} has values that are not finite")
    return field
