"""The data term of source and target functions (Eq. 3), with checks of masks and weights."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from abfm.calculus.channels import channels
from abfm.calculus.operators import (
    Matrix,
    cotangent_laplacian,
    function_norm_matrix,
    l2_norm,
    vertex_areas,
)
from abfm.errors import FunctionError, ParameterError
from abfm.functions.objects import as_values
from abfm.matching.terms.data_term import Measure, Restriction
from abfm.mesh import TriangleMesh
from abfm.numerics import kernels
from abfm.numerics.cholesky import factor
from abfm.numerics.real_numbers import real_numbers
from abfm.parameters import Parameters
from abfm.types import BoolArray, FloatArray
from abfm.wording import counted

VALUE_MIN = 1e-100
VALUE_MAX = 1e100
"""Bounds of the largest value of functions; its square neither underflows nor overflows."""
# bounds of the largest mask value and weight
_WEIGHT_MIN = 1e-30
_WEIGHT_MAX = 1e30
CONSTANT_SHARE = 1e-9
"""Largest norm of a constant function minus its mean (rounding errors), relative to its norm."""


class FunctionTerm:
    """The data term of a source f and a target g, (V,) or (V, C), on a mesh of unit area.

    The attributes ``source`` and ``target`` are (C, V), and ``areas`` (V,) are those of the
    vertices times the mask. ``function_size`` is the larger L2 norm of source and target minus
    their means, over all channels; 1 if both are constant. The mask (V,) refers to the vertices of
    the mesh or of its file. Weights are (C,), and all 0 if the functions are only advected.
    ``approximate`` functions match only approximately, such as descriptors of two shapes. Raises
    AbfmError if shapes or values are wrong.
    """

    name = "closeness"

    def __init__(
        self,
        mesh: TriangleMesh,
        f: ArrayLike,
        g: ArrayLike,
        mask: ArrayLike | None = None,
        weights: ArrayLike | None = None,
        *,
        approximate: bool = False,
    ) -> None:
        self.mesh, self.approximate = mesh, approximate
        self.source, self.target = channels(mesh, f, "source"), channels(mesh, g, "target")
        count = len(self.source)
        if count != len(self.target):
            raise FunctionError(
                f"source has {counted(count, 'channel')} and target has {len(self.target)}; "
                "expected equal numbers"
            )
        self.mask = None if mask is None else checked_mask(mesh, mask)
        self.weights = checked_weights(weights, count, "weights", "channel", True)
        self.areas = vertex_areas(mesh) if self.mask is None else vertex_areas(mesh) * self.mask
        with np.errstate(over="ignore"):
            size = max(self.deviation(self.source), self.deviation(self.target))
        self.function_size = size or 1.0

    def check_sizes(self) -> None:
        """Raise FunctionError if squares of the values would overflow or underflow."""
        sizes = np.maximum(np.abs(self.source).max(axis=1), np.abs(self.target).max(axis=1))
        largest, counting = float(sizes.max()), float(sizes[self.weights > 0].max(initial=0))
        if largest > VALUE_MAX or 0 < counting < VALUE_MIN:
            wrong = largest if largest > VALUE_MAX else counting
            raise FunctionError(
                f"the largest value of source and target is {wrong:.3g}, whose square overflows or "
                f"underflows; scale both by the same factor, to between {VALUE_MIN:g} and "
                f"{VALUE_MAX:g}"
            )

    @property
    def sources(self) -> FloatArray:
        return self.source

    def measure(self, parameters: Parameters, reach: float) -> Measure:
        """Return the energy in the norm of the parameter beta.

        If ``reach`` is above 0, a smoothed norm compares functions over this distance.
        """
        unit = self.function_size if parameters.paper.sigma_unit == "relative" else 1.0
        if reach:
            difference = self.source - self.target
            smoothed = SmoothedNorm(self.mesh, self.areas, reach, difference, self.weights)
            return _Mismatch(self, unit, smoothed)
        matrix = function_norm_matrix(self.mesh, parameters.beta, self.mask)
        return _Mismatch(self, unit, partial(kernels.product, matrix))

    def residual(self, advected: FloatArray) -> float:
        """Return ``||f_tau - g|| / ||g - mean(g)||`` over all channels (C, V).

        Norms and mean are weighted by areas and mask. A constant that is added to both functions
        has no effect.
        """
        return self.relative_size(advected - self.target)

    def mismatch(self, advected: FloatArray) -> float:
        """Return the mismatch of the paper, ``||f_tau - g|| / ||g||``, over all channels (C, V).

        If g is 0, the denominator is ``||f||``.
        """
        scale = self.norm(self.target) or self.norm(self.source) or 1.0
        return self.norm(advected - self.target) / scale

    def relative_size(self, difference: FloatArray) -> float:
        """Return the L2 norm of channels (C, V), divided by `varying_size`."""
        return self.norm(difference) / self.varying_size

    @cached_property
    def varying_size(self) -> float:
        """The L2 norm of the target minus its mean.

        If the target is constant, the size is that of the source. If both are constant, the size is
        the norm of the target, or of the source, or 1, whichever is the first above 0.
        """
        sizes = (self._varying(self.target), self._varying(self.source))
        norms = (self.norm(self.target), self.norm(self.source))
        return next((size for size in (*sizes, *norms) if size), 1.0)

    def _varying(self, functions: FloatArray) -> float:
        """Return the L2 norm of channels (C, V) minus means; 0 if only rounding errors remain."""
        deviation = self.deviation(functions)
        return deviation if deviation > CONSTANT_SHARE * self.norm(functions) else 0.0

    def restricted(self, restriction: Restriction) -> FunctionTerm | None:
        """Return the term on the mesh of a restriction; None if the mask is 0 everywhere there."""
        average = restriction.function_to_coarse
        mask = None if self.mask is None else np.maximum(average(self.mask), 0)
        if mask is not None and not mask.any():
            return None
        coarse = restriction.coarse.normalized()
        found = self.with_values(coarse, average(self.source), average(self.target), mask)
        found.function_size = self.function_size
        return found

    def arrays(self) -> Mapping[str, NDArray[Any]]:
        parts = {"source": self.source.T, "target": self.target.T}
        if self.mask is not None:
            parts["mask"] = self.mask
        found = {name: np.ascontiguousarray(part) for name, part in parts.items()}
        if self.approximate:
            found["approximate"] = np.array(True)
        return found | {"weights": self.weights}

    def with_values(
        self, mesh: TriangleMesh, source: FloatArray, target: FloatArray, mask: FloatArray | None
    ) -> FunctionTerm:
        """Return a term of other functions (C, V) on another mesh, with the same weights."""
        approximate = self.approximate
        return FunctionTerm(mesh, source.T, target.T, mask, self.weights, approximate=approximate)

    def on_mesh(self, mesh: TriangleMesh) -> FunctionTerm:
        """Return the same functions on the same mesh in another length unit."""
        return self._copy_on(mesh, self.mask)

    def with_mask(self, mask: FloatArray) -> FunctionTerm:
        """Return the same functions with another mask (V,), which may be 0 everywhere."""
        return self._copy_on(self.mesh, mask)

    def reversed(self) -> FunctionTerm:
        other = self._copy()
        other.source, other.target = self.target, self.source
        return other

    def _copy(self) -> FunctionTerm:
        other = copy(self)
        other.__dict__.pop("varying_size", None)
        return other

    def _copy_on(self, mesh: TriangleMesh, mask: FloatArray | None) -> FunctionTerm:
        other = self._copy()
        areas = vertex_areas(mesh)
        other.mesh, other.mask, other.areas = mesh, mask, areas if mask is None else areas * mask
        return other

    @property
    def is_constant(self) -> bool:
        norms = self.norm(self.source), self.norm(self.target)
        deviations = self.deviation(self.source), self.deviation(self.target)
        return max(deviations) <= CONSTANT_SHARE * max(norms)

    def norm(self, functions: FloatArray) -> float:
        """Return the L2 norm over channels (C, V); infinite if an unstable flow overflowed."""
        with np.errstate(over="ignore"):
            weighted = (np.sqrt(self.weights)[:, None] * functions).T
            return l2_norm(self.mesh, weighted, self.mask)

    def deviation(self, functions: FloatArray) -> float:
        """Return the L2 norm of channels (C, V) minus their means, weighted by the mask."""
        return float(np.sqrt(self.covariance(functions, functions)))

    def covariance(self, one: FloatArray, other: FloatArray) -> float:
        shares = self.areas / self.areas.sum()
        deviations = []
        for functions in (one, other):
            shifted = functions - functions[:, :1]  # this is exactly zero for constant functions
            # not by BLAS, whose threads block each other if other programs run
            deviations.append(shifted - np.einsum("cv,v->c", shifted, shares)[:, None])
        return float(self.weights @ np.einsum("cv,v->c", deviations[0] * deviations[1], self.areas))


class SmoothedNorm:
    """The norm ``c A_w (A + s L)^-1 A_w`` of vertex functions, with ``s = reach^2``.

    Here A are the vertex areas, ``A_w`` the same times the mask, and L the cotangent Laplacian.

    If source and target do not overlap, the derivative of the L2 norm only shrinks the source. The
    smoothing extends the range of the derivative to ``sqrt(s)``, so that the source moves. The
    kernel is positive definite, and is a linearised distance of optimal transport [Peyre, ESAIM:
    COCV 24 (2018)].

    The argument ``areas`` (V,) is ``A_w``. The factor ``c`` makes the norm of ``differences`` (C,
    V) equal to their L2 norm. Each application takes one Cholesky solve.
    """

    def __init__(
        self,
        mesh: TriangleMesh,
        areas: FloatArray,
        reach: float,
        differences: FloatArray,
        weights: FloatArray,
    ) -> None:
        self._areas, self._scale = areas, 1.0
        masses = sparse.diags_array(vertex_areas(mesh))
        self._solve = factor(Matrix(masses + reach**2 * cotangent_laplacian(mesh)))
        pairs = list(zip(weights, differences, strict=True))
        in_l2 = sum(w * float(areas @ d**2) for w, d in pairs)
        smoothed = sum(w * float(d @ self(d)) for w, d in pairs)
        if smoothed > 0 and np.isfinite(in_l2 / smoothed):
            self._scale = in_l2 / smoothed

    def __call__(self, difference: FloatArray) -> FloatArray:
        return np.asarray(self._scale * self._areas * self._solve(self._areas * difference))


@dataclass(frozen=True, eq=False)
class _Mismatch:
    """The energy ``sum_c w_c <d_c, M d_c> / (2 (unit sigma)^2)`` with ``d = f_tau - g``.

    Here ``f_tau`` is the advected source, g the target, and ``w_c`` the weight of channel c.
    """

    functions: FunctionTerm
    unit: float
    norm: Callable[[FloatArray], FloatArray]  # multiplies functions by the mass matrix M

    def value_and_derivative(self, advected: FloatArray, sigma: float) -> tuple[float, FloatArray]:
        scale, derivative, total = float(sigma * self.unit), np.empty_like(advected), 0.0
        try:
            weights = [float(weight) / scale**2 for weight in self.functions.weights]
        except (OverflowError, ZeroDivisionError):
            raise FunctionError(
                f"sigma in the unit of the functions is {scale:.3g}, whose square overflows or "
                "underflows; scale functions, mask, weights or sigma to usual sizes"
            ) from None
        for c, weight in enumerate(weights):
            difference = advected[c] - self.functions.target[c]
            derivative[c] = weight * self.norm(difference)
            total += 0.5 * kernels.inner(derivative[c], difference)
        return total, derivative


def checked_mask(mesh: TriangleMesh, mask: ArrayLike, name: str = "mask") -> FloatArray:
    """Return a checked mask (V,), from values at the vertices of the mesh or of its file.

    Raise ParameterError if the mask is invalid.
    """
    of_vertices = real_numbers(mask, name, ParameterError)
    if of_vertices.shape == (mesh.file_vertex_count,):
        of_vertices = mesh.restrict(of_vertices)
    return checked_weights(of_vertices, len(mesh.vertices), name, "vertex")


def mask_from_input(
    mesh: TriangleMesh, mask: ArrayLike | None, name: str = "mask"
) -> FloatArray | None:
    """Return a mask (V,) from any input that `as_values` accepts; None if the input is None."""
    if mask is None:
        return None
    return checked_mask(mesh, as_values(mesh, mask, name, ParameterError), name)


def mask_of_known(mask: FloatArray | None, known: BoolArray) -> FloatArray | None:
    """Return ``mask`` (V,), set to 0 where ``known`` (V,) is False; None if 1 everywhere."""
    if mask is None:
        return None if known.all() else known.astype(np.float64)
    return mask * known


def checked_weights(
    values: ArrayLike | None, count: int, name: str, each: str, may_be_zero: bool = False
) -> FloatArray:
    """Return checked weights (n,), by default 1; ``each`` names a weighted object in messages."""
    if values is None:
        return np.ones(count)
    array = real_numbers(values, name, ParameterError).copy()
    if array.shape != (count,):
        raise ParameterError(f"{name} has shape {array.shape}; expected ({count},), one per {each}")
    is_zero = not array.any()
    if not np.isfinite(array).all() or (array < 0).any() or (is_zero and not may_be_zero):
        raise ParameterError(
            f"{name} has negative or non-finite values, or only zeros; give at least one {each} a "
            "value above 0, and none below 0"
        )
    if not is_zero and not _WEIGHT_MIN <= array.max() <= _WEIGHT_MAX:
        raise ParameterError(
            f"the largest value of {name} is {array.max():.3g}; expected a value between "
            f"{_WEIGHT_MIN:g} and {_WEIGHT_MAX:g}"
        )
    return array
