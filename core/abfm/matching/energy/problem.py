"""What is to be matched: a source and a target, and how much of their mismatch counts where."""

import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.channels import channels
from abfm.calculus.operators import l2_norm, vertex_areas
from abfm.errors import FunctionError, ParameterError
from abfm.matching.schedule import MATCHED
from abfm.mesh import TriangleMesh
from abfm.real_numbers import real_numbers
from abfm.types import FloatArray

SMALLEST, LARGEST = 1e-100, 1e100
"""Of functions, as their largest value: squares of such sizes neither underflow nor overflow."""
_LIGHTEST, _HEAVIEST = 1e-30, 1e30  # the same of masks and weights
CONSTANT = 1e-9
"""A function is constant whose deviation from its mean is no larger than this share of its norm."""


class Problem:
    """A source f and a target g, (V,) or (V, C), on a mesh.

    The mask (V,) weighs the mismatch at each vertex of the mesh or of its file, weights (C,) that of each channel; they
    are 1 unless given. Values of the source may come from where the mask is 0.

    ``source`` and ``target`` are (C, V), ``areas`` (V,) those of the vertices times the mask, ``function_size`` is the
    larger of the functions' deviations, 1 where both are constant.

    Raises
    ------
    FunctionError
        If a function does not fit the mesh, they have not as many channels, or values so large or so small that
        squares over- or underflow.
    ParameterError
        If mask or weights do not fit, a value is negative or not finite, or all are zero or beyond 1e-30 to 1e30.
    """

    def __init__(
        self,
        mesh: TriangleMesh,
        f: ArrayLike,
        g: ArrayLike,
        mask: ArrayLike | None = None,
        weights: ArrayLike | None = None,
    ) -> None:
        self.mesh = mesh
        self.source, self.target = channels(mesh, f, "source"), channels(mesh, g, "target")
        count = len(self.source)
        if count != len(self.target):
            raise FunctionError(f"source has {count} and target {len(self.target)} channels; give as many of each")
        self.mask: FloatArray | None = None
        if mask is not None:
            of_vertices = real_numbers(mask, "mask", ParameterError)
            if of_vertices.shape == (mesh.file_vertex_count,):
                of_vertices = mesh.restrict(of_vertices)
            self.mask = _weights(of_vertices, len(mesh.vertices), "mask")
        self.weights = np.ones(count) if weights is None else _weights(weights, count, "weights")
        _refuse_extremes(self.source, self.target, self.weights)
        self.areas = vertex_areas(mesh) if self.mask is None else vertex_areas(mesh) * self.mask
        self.function_size = max(self.deviation(self.source), self.deviation(self.target)) or 1.0

    @property
    def is_constant(self) -> bool:
        """Whether source and target have one value each, up to rounding."""
        norms = self.norm(self.source), self.norm(self.target)
        return max(self.deviation(self.source), self.deviation(self.target)) <= CONSTANT * max(norms)

    def relative_mismatch(self, advected: FloatArray) -> float:
        """``||f_tau - g|| / ||g||`` in L2 over all channels (C, V), see the function of this name."""
        return relative_mismatch(self.mesh, advected, self.target, self.source, self.mask, self.weights)

    def norm(self, functions: FloatArray) -> float:
        """L2 norm over channels (C, V), with mask and weights."""
        return _norm(self.mesh, functions, self.mask, self.weights)

    def deviation(self, functions: FloatArray) -> float:
        """Norm of channels (C, V) less the mean of each, by the mask."""
        return _deviation(self.areas, functions, self.weights)

    def covariance(self, one: FloatArray, other: FloatArray) -> float:
        """L2 product over channels (C, V) less the mean of each, with mask and weights."""
        return _covariance(self.areas, one, other, self.weights)


def relative_mismatch(
    mesh: TriangleMesh,
    found: FloatArray,
    target: FloatArray,
    source: FloatArray,
    mask: FloatArray | None,
    weights: FloatArray,
) -> float:
    """``||found - target|| / ||target||`` in L2 over all channels (C, V), with mask (V,) and weights (C,).

    Relative to the source where the target is 0. Functions that are mostly a constant would always be matched: where
    both deviate from their means by less than `MATCHED` of that norm the larger deviation takes its place, unless both
    are constants.
    """
    scale = _norm(mesh, target, mask, weights) or _norm(mesh, source, mask, weights) or 1.0
    areas = vertex_areas(mesh) if mask is None else vertex_areas(mesh) * mask
    deviation = max(_deviation(areas, source, weights), _deviation(areas, target, weights))
    if CONSTANT * scale < deviation < MATCHED * scale:
        scale = deviation
    return _norm(mesh, found - target, mask, weights) / scale


def _deviation(areas: FloatArray, functions: FloatArray, weights: FloatArray) -> float:
    """Norm of channels (C, V) less the mean of each."""
    return float(np.sqrt(_covariance(areas, functions, functions, weights)))


def _covariance(areas: FloatArray, one: FloatArray, other: FloatArray, weights: FloatArray) -> float:
    apart = one - (one @ areas / areas.sum())[:, None]
    return float(weights @ ((apart * (other - (other @ areas / areas.sum())[:, None])) @ areas))


def _norm(mesh: TriangleMesh, functions: FloatArray, mask: FloatArray | None, weights: FloatArray) -> float:
    """Infinite for functions that a flow without bounds has made."""
    with np.errstate(over="ignore"):
        return l2_norm(mesh, (np.sqrt(weights)[:, None] * functions).T, mask)


def _weights(values: ArrayLike, count: int, name: str) -> FloatArray:
    array = real_numbers(values, name, ParameterError).copy()
    if array.shape != (count,):
        raise ParameterError(f"{name} has shape {array.shape}; expected ({count},)")
    if not np.isfinite(array).all() or (array < 0).any() or not array.any():
        raise ParameterError(f"{name} must be finite, not negative, and not zero everywhere")
    if not _LIGHTEST <= array.max() <= _HEAVIEST:
        raise ParameterError(
            f"{name} is {array.max():.3g} at most; expected a largest value between {_LIGHTEST:g} and {_HEAVIEST:g}"
        )
    return array


def _refuse_extremes(source: FloatArray, target: FloatArray, weights: FloatArray) -> None:
    sizes = np.maximum(np.abs(source).max(axis=1), np.abs(target).max(axis=1))
    largest, counting = float(sizes.max()), float(sizes[weights > 0].max())
    if largest > LARGEST or 0 < counting < SMALLEST:
        raise FunctionError(
            f"source and target have values of up to {largest if largest > LARGEST else counting:.3g}, whose squares "
            f"over- or underflow; scale both by the same factor, to between {SMALLEST:g} and {LARGEST:g}"
        )
