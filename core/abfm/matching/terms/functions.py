"""A source that is to be carried to a target: the data term of the paper (Eq. 3)."""

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

VALUE_MIN = 1e-100
VALUE_MAX = 1e100
"""Of functions, as their largest value: squares of such sizes neither underflow nor overflow."""
# the same of masks and weights
_WEIGHT_MIN = 1e-30
_WEIGHT_MAX = 1e30
CONSTANT = 1e-9
"""A function is constant whose deviation from its mean is no larger than this share of its norm."""


class FunctionTerm:
    """A source f and a target g, (V,) or (V, C), on a mesh of unit area; AbfmError if they misfit.

    A mask is (V,), of the vertices of the mesh or of its file; weights are (C,), all 0
    of functions that are only carried. ``source`` and
    ``target`` are (C, V), ``areas`` those of the vertices times the mask. ``function_size`` is the
    larger deviation of both from their means, in L2 over all channels; 1 where both are constant.
    ``approximate`` functions are only alike, such as descriptors of two shapes.
    """

    word = "closeness"

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
                f"source has {count} and target {len(self.target)} channels; give as many of each"
            )
        self.mask = None if mask is None else checked_mask(mesh, mask)
        self.weights = checked_weights(weights, count, "weights", "channel", True)
        self.areas = vertex_areas(mesh) if self.mask is None else vertex_areas(mesh) * self.mask
        with np.errstate(over="ignore"):
            size = max(self.deviation(self.source), self.deviation(self.target))
        self.function_size = size or 1.0

    def refuse_extremes(self) -> None:
        """Raise FunctionError where values are so large or small that squares overflow."""
        sizes = np.maximum(np.abs(self.source).max(axis=1), np.abs(self.target).max(axis=1))
        largest, counting = float(sizes.max()), float(sizes[self.weights > 0].max(initial=0))
        if largest > VALUE_MAX or 0 < counting < VALUE_MIN:
            wrong = largest if largest > VALUE_MAX else counting
            raise FunctionError(
                f"source and target have values of up to {wrong:.3g}, whose squares over- or "
                f"underflow; scale both by the same factor, to between {VALUE_MIN:g} and "
                f"{VALUE_MAX:g}"
            )

    @property
    def carried(self) -> FloatArray:
        return self.source

    def measure(self, parameters: Parameters, reach: float) -> Measure:
        """Make the norm of the parameters' beta, or the smoothed one of a reach."""
        unit = self.function_size if parameters.paper.sigma_unit == "relative" else 1.0
        if reach:
            apart = self.source - self.target
            smoothed = SmoothedNorm(self.mesh, self.areas, reach, apart, self.weights)
            return _Mismatch(self, unit, smoothed)
        matrix = function_norm_matrix(self.mesh, parameters.beta, self.mask)
        return _Mismatch(self, unit, partial(kernels.product, matrix))

    def residual(self, carried: FloatArray) -> float:
        """Return ``||f_tau - g|| / ||g - mean(g)||`` over all channels (C, V).

        Norms and the mean are weighted by areas and mask, so that a constant added to both
        functions changes nothing.
        """
        return self.relative_size(carried - self.target)

    def mismatch(self, carried: FloatArray) -> float:
        """Return ``||f_tau - g|| / ||g||`` over all channels (C, V), as the paper defines it; over
        ``||f||`` if g is 0.
        """
        scale = self.norm(self.target) or self.norm(self.source) or 1.0
        return self.norm(carried - self.target) / scale

    def relative_size(self, difference: FloatArray) -> float:
        """Return the L2 norm of channels (C, V) over `varying_size`."""
        return self.norm(difference) / self.varying_size

    @cached_property
    def varying_size(self) -> float:
        """The deviation of the target from its mean.

        If the target is constant, the deviation of the source takes its place, then the norm of
        either, then 1.
        """
        sizes = (self._varying(self.target), self._varying(self.source))
        norms = (self.norm(self.target), self.norm(self.source))
        return next((size for size in (*sizes, *norms) if size), 1.0)

    def _varying(self, functions: FloatArray) -> float:
        """Return the deviation of channels (C, V); 0 if they are constant up to rounding."""
        deviation = self.deviation(functions)
        return deviation if deviation > CONSTANT * self.norm(functions) else 0.0

    def restricted(self, restriction: Restriction) -> FunctionTerm | None:
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
        """Return a term of other functions (C, V), on another mesh, with the same weights."""
        alike = self.approximate
        return FunctionTerm(mesh, source.T, target.T, mask, self.weights, approximate=alike)

    def on(self, mesh: TriangleMesh) -> FunctionTerm:
        """Return the same functions on this mesh in other units, such as the fields' own."""
        return self._again(mesh, self.mask)

    def with_mask(self, mask: FloatArray) -> FunctionTerm:
        """Return the same functions with another mask (V,), which may be 0 everywhere."""
        return self._again(self.mesh, mask)

    def reversed(self) -> FunctionTerm:
        """Return the term of the match from the target to the source."""
        other = self._copy()
        other.source, other.target = self.target, self.source
        return other

    def _copy(self) -> FunctionTerm:
        other = copy(self)
        other.__dict__.pop("varying_size", None)
        return other

    def _again(self, mesh: TriangleMesh, mask: FloatArray | None) -> FunctionTerm:
        other = self._copy()
        areas = vertex_areas(mesh)
        other.mesh, other.mask, other.areas = mesh, mask, areas if mask is None else areas * mask
        return other

    @property
    def is_constant(self) -> bool:
        norms = self.norm(self.source), self.norm(self.target)
        deviations = self.deviation(self.source), self.deviation(self.target)
        return max(deviations) <= CONSTANT * max(norms)

    def norm(self, functions: FloatArray) -> float:
        """Return the L2 norm over channels (C, V); infinite for what an unstable flow has made."""
        with np.errstate(over="ignore"):
            weighted = (np.sqrt(self.weights)[:, None] * functions).T
            return l2_norm(self.mesh, weighted, self.mask)

    def deviation(self, functions: FloatArray) -> float:
        """Return the norm of channels (C, V) less the mean of each, by the mask."""
        return float(np.sqrt(self.covariance(functions, functions)))

    def covariance(self, one: FloatArray, other: FloatArray) -> float:
        shares = self.areas / self.areas.sum()
        apart = []
        for functions in (one, other):
            off = functions - functions[:, :1]  # of constants exactly zero
            # not by BLAS, whose threads wait for one another where other programs run
            apart.append(off - np.einsum("cv,v->c", off, shares)[:, None])
        return float(self.weights @ np.einsum("cv,v->c", apart[0] * apart[1], self.areas))


class SmoothedNorm:
    """``c A_w (A + s L)^-1 A_w`` on vertex functions, ``s = reach^2``: one Cholesky solve.

    Where source and target do not touch, the derivative in L2 says "shrink", never "move"; through
    this smoothing it is felt as far as ``sqrt(s)``. The kernel is positive definite: optimal
    transport's distance, linearised [Peyre, ESAIM: COCV 24 (2018)]. ``areas`` (V,) are ``A_w``,
    with the mask; by ``c`` differences (C, V) measure the same as in L2.
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
        near = sum(w * float(areas @ d**2) for w, d in pairs)
        far = sum(w * float(d @ self(d)) for w, d in pairs)
        if far > 0 and np.isfinite(near / far):
            self._scale = near / far

    def __call__(self, difference: FloatArray) -> FloatArray:
        return np.asarray(self._scale * self._areas * self._solve(self._areas * difference))


@dataclass(frozen=True, eq=False)
class _Mismatch:
    """``sum_c w_c <d_c, M d_c> / (2 sigma^2)`` with ``d = f_tau - g`` and sigma in its unit."""

    functions: FunctionTerm
    unit: float
    norm: Callable[[FloatArray], FloatArray]  # by the matrix

    def value_and_residual(self, carried: FloatArray, sigma: float) -> tuple[float, FloatArray]:
        scale, residual, total = float(sigma * self.unit), np.empty_like(carried), 0.0
        try:
            weights = [float(weight) / scale**2 for weight in self.functions.weights]
        except (OverflowError, ZeroDivisionError):
            raise FunctionError(
                f"sigma in the functions' unit is {scale:.3g}, whose square over- or underflows; "
                "scale the functions, mask, weights or sigma to usual sizes"
            ) from None
        for c, weight in enumerate(weights):
            difference = carried[c] - self.functions.target[c]
            residual[c] = weight * self.norm(difference)
            total += 0.5 * kernels.inner(residual[c], difference)
        return total, residual


def checked_mask(mesh: TriangleMesh, mask: ArrayLike, name: str = "mask") -> FloatArray:
    """Return a mask of the vertices of a mesh or of its file as (V,); ParameterError if it does
    not fit.
    """
    of_vertices = real_numbers(mask, name, ParameterError)
    if of_vertices.shape == (mesh.file_vertex_count,):
        of_vertices = mesh.restrict(of_vertices)
    return checked_weights(of_vertices, len(mesh.vertices), name, "vertex")


def mask_from_input(
    mesh: TriangleMesh, mask: ArrayLike | None, name: str = "mask"
) -> FloatArray | None:
    """Return a mask as a user gives it, see `as_values`, as (V,); None for none."""
    if mask is None:
        return None
    return checked_mask(mesh, as_values(mesh, mask, name, ParameterError), name)


def mask_of_known(mask: FloatArray | None, known: BoolArray) -> FloatArray | None:
    """Return a mask (V,) that is 0 also where functions are not known, (V,); None for all 1."""
    if mask is None:
        return None if known.all() else known.astype(np.float64)
    return mask * known


def checked_weights(
    values: ArrayLike | None, count: int, name: str, each: str, may_be_zero: bool = False
) -> FloatArray:
    """Return weights (n,), one for each channel or vertex or the like, by default 1; a
    ParameterError reports what does not fit.
    """
    if values is None:
        return np.ones(count)
    array = real_numbers(values, name, ParameterError).copy()
    if array.shape != (count,):
        raise ParameterError(f"{name} has shape {array.shape}; expected ({count},), one per {each}")
    is_zero = not array.any()
    if not np.isfinite(array).all() or (array < 0).any() or (is_zero and not may_be_zero):
        raise ParameterError(
            f"{name} must be finite, not negative, and not zero everywhere: give a {each} one "
            "above 0"
        )
    if not is_zero and not _WEIGHT_MIN <= array.max() <= _WEIGHT_MAX:
        raise ParameterError(
            f"{name} is {array.max():.3g} at most; expected a largest value between "
            f"{_WEIGHT_MIN:g} and {_WEIGHT_MAX:g}"
        )
    return array
