"""Interpolations without a flow: linear blend and convolutional optimal transport.

Source: Solomon, de Goes, Peyré, Cuturi, Butscher, Nguyen, Du, Guibas: Convolutional Wasserstein
Distances, ACM TOG 34(4), 2015, algorithms 2 (barycentres) and 3 (entropic sharpening).
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.optimize import brentq

from abfm.calculus.channels import channels
from abfm.calculus.operators import Matrix, cotangent_laplacian, vertex_areas
from abfm.errors import FunctionError, ParameterError, brief
from abfm.matching.terms.functions import VALUE_MAX, VALUE_MIN
from abfm.mesh import TriangleMesh
from abfm.numerics.cholesky import factor
from abfm.numerics.real_numbers import is_finite_number, is_integer, real_numbers
from abfm.types import FloatArray

_ITERATIONS = 500
_TOLERANCE = 1e-5  # largest L1 change of the density (mass 1) in the last iteration
_HEAT_MIN = 1e-150  # squares and quotients of smaller densities underflow
_EXPONENT_MAX = 64.0
_WIDTH_MAX = 1e3
_STEPS_MAX = 10_000
_NEGATIVE_SHARE_MAX = 0.01  # tolerance for negative values, relative to the largest value
_TIME_MAX = 1e100  # largest time of a blend, relative to tau


def linear_blend(f: ArrayLike, g: ArrayLike, t: float, tau: float = 1.0) -> FloatArray:
    """Return the linear interpolation ``(1 - t / tau) f + (t / tau) g``.

    Raises an AbfmError if the arrays have different shapes, or a value or time is not finite.
    """
    finite = is_finite_number(t) and is_finite_number(tau)
    if not (finite and tau > 0 and abs(float(t)) < _TIME_MAX * float(tau)):
        raise ParameterError(
            f"t is {brief(t)} and tau is {brief(tau)}; expected a finite t and a positive tau"
        )
    source = real_numbers(f, "source f", FunctionError)
    target = real_numbers(g, "target g", FunctionError)
    if source.shape != target.shape:
        raise FunctionError(
            f"source and target have shapes {source.shape} and {target.shape}; expected equal "
            "shapes"
        )
    if not (np.isfinite(source).all() and np.isfinite(target).all()):
        raise FunctionError("source or target has values that are not finite")
    share = float(t) / float(tau)
    return (1 - share) * source + share * target


class HeatKernel:
    """Heat flow on a surface: a positive symmetric smoothing that preserves the integral.

    The heat flow takes ``steps`` implicit Euler steps ``(G_V + s L)^-1 G_V`` of length s with one
    factorisation. ``G_V`` has the areas of the vertices. L is the cotangent Laplacian without the
    edges of negative weight, so every entry of the kernel is positive, up to rounding. Several
    steps approximate a Gaussian up to distances of about ``sqrt(2 steps) width``. The width is the
    standard deviation of the kernel of the plane along an axis, as a fraction of sqrt(area).
    """

    def __init__(self, mesh: TriangleMesh, width: float, steps: int) -> None:
        in_range = is_finite_number(width) and 0 < width <= _WIDTH_MAX
        if not (in_range and is_integer(steps, 1, _STEPS_MAX)):
            raise ParameterError(
                f"blur is {brief(width)} and steps is {brief(steps)}; expected a blur above 0, up "
                f"to {_WIDTH_MAX:g}, and 1 to {_STEPS_MAX} steps"
            )
        unit = mesh.normalized()
        self.areas = vertex_areas(unit)  # (V,), on the mesh scaled to unit area
        self._steps = int(steps)
        matrix = sparse.diags_array(self.areas) + 0.5 * width**2 / steps * _positive_laplacian(unit)
        self._solve = factor(sparse.csr_array(matrix))

    def __call__(self, f: FloatArray) -> FloatArray:
        for _ in range(self._steps):
            f = self._solve(self.areas * f)
        return f


def optimal_transport(
    mesh: TriangleMesh,
    f: ArrayLike,
    g: ArrayLike,
    times: ArrayLike,
    *,
    blur: float = 0.1,
    steps: int = 16,
    sharpen: bool = False,
) -> FloatArray:
    """Return the entropic displacement interpolation of two non-negative functions.

    For time t, f and g are scaled to mass (integral) 1. The result is their Wasserstein barycentre
    with weights 1 - t and t, times ``(1 - t) mass(f) + t mass(g)``. At times 0 and 1 it is blurred
    by the `HeatKernel`, and slightly more between them. A smaller ``blur`` gives a sharper result.
    If ``blur^2`` is far below the product of transport distance and edge length, mass moves slowly
    near times 0 and 1 and fast between them.

    Parameters
    ----------
    f, g : (V,) arrays
        Functions with a positive integral. Negative values of up to 1% of the largest value count
        as 0.
    times : float or (T,) array
        Times from 0 (f) to 1 (g).
    blur : float
        Standard deviation of the `HeatKernel`, as a fraction of sqrt(area).
    steps : int
        Number of implicit Euler steps of the heat flow.
    sharpen : bool
        Whether to limit the entropy of the interpolation to the larger of the entropies of f and g
        (algorithm 3).

    Returns
    -------
    Array of shape (V,) or (T, V), not negative.

    Raises
    ------
    AbfmError
        If a function or number is invalid, or the kernel does not reach across the mesh.
    """
    moments = np.atleast_1d(real_numbers(times, "times", ParameterError))
    if moments.ndim != 1 or not ((moments >= 0) & (moments <= 1)).all():
        raise ParameterError(
            f"times is {brief(times)}; expected a time from 0 to 1, or a list of such times"
        )
    functions = [_non_negative(mesh, f, "source f"), _non_negative(mesh, g, "target g")]
    heat = HeatKernel(mesh, blur, steps)
    masses = [float(heat.areas @ values) for values in functions]
    densities = [values / mass for values, mass in zip(functions, masses, strict=True)]
    if min(heat(density).min() for density in densities) < _HEAT_MIN:
        raise ParameterError(
            f"blur is {blur:g} in {steps} steps, with which the heat kernel underflows between "
            "distant parts of this mesh. Use a larger blur or fewer steps"
        )
    bound = max(_entropy(heat.areas, density) for density in densities) if sharpen else np.inf
    means = [(1 - t) * masses[0] + t * masses[1] for t in moments]
    pairs = zip(means, moments, strict=True)
    found = np.stack([mass * _barycentre(heat, densities, t, bound) for mass, t in pairs])
    return found if np.ndim(times) else found[0]


def _barycentre(
    heat: HeatKernel, densities: list[FloatArray], t: float, bound: float
) -> FloatArray:
    """Return the barycentre of two densities, with weights 1 - t and t (algorithm 2).

    It is computed by Bregman projections. ``bound`` limits its entropy, and may be infinite.
    """
    areas, tiny = heat.areas, np.finfo(np.float64).tiny
    scalings = [np.ones_like(density) for density in densities]
    found = np.zeros_like(densities[0])
    for _ in range(_ITERATIONS):
        before = found
        marginals = [
            np.maximum(v * heat(density / np.maximum(heat(v), tiny)), tiny)
            for v, density in zip(scalings, densities, strict=True)
        ]
        found = marginals[0] ** (1 - t) * marginals[1] ** t
        if np.isfinite(bound):
            found = _sharpened(areas, found, bound)
        scalings = [v * found / marginal for v, marginal in zip(scalings, marginals, strict=True)]
        if areas @ np.abs(found - before) < _TOLERANCE:
            break
    return np.asarray(found / (areas @ found))


def _sharpened(areas: FloatArray, density: FloatArray, bound: float) -> FloatArray:
    """Raise a density to the smallest power up to 64 whose entropy is at most ``bound``.

    If no such power exists, the power 64 is used (algorithm 3).
    """

    def power(exponent: float) -> FloatArray:
        raised = (density / density.max()) ** exponent
        return np.asarray(raised / (areas @ raised))

    if _entropy(areas, power(1.0)) <= bound:
        return density
    if _entropy(areas, power(_EXPONENT_MAX)) >= bound:
        return power(_EXPONENT_MAX)
    found = brentq(lambda one: _entropy(areas, power(one)) - bound, 1.0, _EXPONENT_MAX, xtol=1e-6)
    return power(found)


def _entropy(areas: FloatArray, density: FloatArray) -> float:
    return -float((areas * density) @ np.log(np.maximum(density, np.finfo(np.float64).tiny)))


def _positive_laplacian(mesh: TriangleMesh) -> Matrix:
    """Return the cotangent Laplacian, shape (V, V), without the edges of negative weight."""
    entries = cotangent_laplacian(mesh).tocoo()
    is_positive = (entries.row != entries.col) & (entries.data < 0)
    indices = entries.row[is_positive], entries.col[is_positive]
    weights = Matrix((-entries.data[is_positive], indices), shape=entries.shape)
    return Matrix(sparse.diags_array(weights.sum(axis=1)) - weights)


def _non_negative(mesh: TriangleMesh, values: ArrayLike, name: str) -> FloatArray:
    rows = channels(mesh, values, name)
    if len(rows) != 1:
        raise FunctionError(
            f"{name} has {len(rows)} channels; optimal transport needs one function (V,)"
        )
    row = rows[0]
    worst, largest = int(row.argmin()), row.max()
    if row[worst] < -_NEGATIVE_SHARE_MAX * largest:
        raise FunctionError(
            f"{name} is negative at {np.count_nonzero(row < 0)} of {len(row)} vertices, down to "
            f"{row[worst]:g} at vertex {mesh.vertex_ids[worst]}; optimal transport needs a "
            "function that is not negative"
        )
    if not row.any():
        raise FunctionError(f"{name} is 0 everywhere; optimal transport needs a positive integral")
    if not VALUE_MIN <= largest <= VALUE_MAX:
        raise FunctionError(
            f"the largest value of {name} is {largest:.3g}, which overflows or underflows; scale "
            f"it to between {VALUE_MIN:g} and {VALUE_MAX:g}"
        )
    return np.asarray(np.maximum(row, 0))
