"""Optimal transport between two non-negative functions: convolutional Wasserstein interpolation.

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
from abfm.matching.terms.functions import LARGEST, SMALLEST
from abfm.mesh import TriangleMesh
from abfm.numerics.cholesky import factor
from abfm.numerics.real_numbers import is_finite_number, is_whole_number, real_numbers
from abfm.types import FloatArray

_ITERATIONS = 500
# L1 change of the interpolated density, whose mass is 1, from one iteration to the next
_TOLERANCE = 1e-5
_LEAST_HEAT = 1e-150  # squares and quotients of smaller densities underflow
_SHARPEST = 64.0
_WIDEST, _MOST_STEPS = 1e3, 10_000
_NEGLIGIBLE = 0.01  # of the largest value: what a function may be below zero


class HeatKernel:
    """Heat flow on a surface: a positive symmetric smoothing that keeps the integral.

    Implicit Euler steps ``(G_V + s L)^-1 G_V`` with one factorisation. L has the cotangent weights
    of the edges, without the negative ones: every entry of the kernel is positive on every mesh,
    and small ones are exact to rounding, which optimal transport over long distances needs. Each
    step's tail decays like ``exp(-d / sqrt(s))``, so several steps are needed for one like a
    Gaussian's: up to distances of about ``sqrt(2 steps) width``.

    Parameters
    ----------
    mesh : TriangleMesh
    width : float
        Standard deviation of the flat kernel along an axis, as a fraction of sqrt(area).
    steps : int
        Implicit Euler steps.

    Raises
    ------
    ParameterError
        If a number is out of range.

    Attributes
    ----------
    areas : (V,) array
        Of the vertices, on the mesh scaled to unit area.
    """

    def __init__(self, mesh: TriangleMesh, width: float, steps: int) -> None:
        if not (
            is_finite_number(width)
            and 0 < width <= _WIDEST
            and is_whole_number(steps, 1, _MOST_STEPS)
        ):
            raise ParameterError(
                f"blur is {brief(width)}, steps is {brief(steps)}; expected a blur above 0, at "
                f"most {_WIDEST:g}, and a whole number of steps from 1 to {_MOST_STEPS}"
            )
        unit = mesh.normalized()
        self.areas = vertex_areas(unit)
        self._steps = int(steps)
        matrix = sparse.diags_array(self.areas) + 0.5 * width**2 / steps * _positive_laplacian(unit)
        self._solve = factor(sparse.csr_array(matrix))

    def __call__(self, f: FloatArray) -> FloatArray:
        """Return a function (V,) after the flow, (V,)."""
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
    """Return the entropic displacement interpolation of two non-negative functions: their mass
    takes the shortest ways.

    At time t the Wasserstein barycentre with weights 1 - t and t of both functions scaled to mass
    1, times ``(1 - t) mass(f) + t mass(g)``. All of it is blurred: at times 0 and 1 by the kernel,
    between them somewhat more. A smaller blur makes it sharper, but only down to a limit that the
    mesh sets: heat that spreads from vertex to vertex sees squared distances only where ``blur^2``
    is not far below the product of distance and edge length. Beyond, mass still goes from f to g,
    but lingers near both and hurries in the middle.

    Parameters
    ----------
    f, g : (V,) arrays
        Not negative, with a positive integral each. Values below zero by at most 1% of the largest
        one, as rounding and advection leave them, count as 0.
    times : float or (T,) array
        From 0 (f) to 1 (g).
    blur : float
        Standard deviation of the heat kernel, as a fraction of sqrt(area).
    steps : int
        Implicit Euler steps of the heat flow (see `HeatKernel`).
    sharpen : bool
        Keep the entropy of the interpolation below the larger one of f and g (algorithm 3).

    Returns
    -------
    Array of shape (V,) or (T, V), not negative.

    Raises
    ------
    FunctionError
        If a function has values further below zero or no mass, or does not fit the mesh.
    ParameterError
        If a time, blur or steps is out of range, or heat does not reach across the mesh.
    """
    moments = np.atleast_1d(real_numbers(times, "times", ParameterError))
    if moments.ndim != 1 or not ((moments >= 0) & (moments <= 1)).all():
        raise ParameterError(
            f"times is {brief(times)}; expected a time from 0 to 1 or a list of them"
        )
    functions = [
        _non_negative(mesh, values, name) for values, name in ((f, "source f"), (g, "target g"))
    ]
    heat = HeatKernel(mesh, blur, steps)
    masses = [float(heat.areas @ values) for values in functions]
    densities = [values / mass for values, mass in zip(functions, masses, strict=True)]
    if min(heat(density).min() for density in densities) < _LEAST_HEAT:
        raise ParameterError(
            f"blur is {blur:g} in {steps} steps: heat does not reach from one end of this mesh to "
            "the other in numbers that can be computed with; give a larger blur or fewer steps"
        )
    bound = max(_entropy(heat.areas, density) for density in densities) if sharpen else np.inf
    found = np.stack(
        [
            ((1 - t) * masses[0] + t * masses[1]) * _barycentre(heat, densities, t, bound)
            for t in moments
        ]
    )
    return found if np.ndim(times) else found[0]


def _barycentre(
    heat: HeatKernel, densities: list[FloatArray], t: float, bound: float
) -> FloatArray:
    """Run algorithm 2 for two densities with weights 1 - t and t: iterated Bregman projections."""
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
    """Run algorithm 3: the smallest power from 1 on, of mass 1, with at most this entropy."""

    def power(exponent: float) -> FloatArray:
        raised = (density / density.max()) ** exponent
        return np.asarray(raised / (areas @ raised))

    if _entropy(areas, power(1.0)) <= bound:
        return density
    if _entropy(areas, power(_SHARPEST)) >= bound:
        return power(_SHARPEST)
    return power(
        brentq(lambda exponent: _entropy(areas, power(exponent)) - bound, 1.0, _SHARPEST, xtol=1e-6)
    )


def _entropy(areas: FloatArray, density: FloatArray) -> float:
    """Return ``-integral of density log density``."""
    return -float((areas * density) @ np.log(np.maximum(density, np.finfo(np.float64).tiny)))


def _positive_laplacian(mesh: TriangleMesh) -> Matrix:
    """Return the cotangent Laplacian without the edges whose weight is negative, (V, V)."""
    entries = cotangent_laplacian(mesh).tocoo()
    kept = (entries.row != entries.col) & (entries.data < 0)
    weights = Matrix(
        (-entries.data[kept], (entries.row[kept], entries.col[kept])), shape=entries.shape
    )
    return Matrix(sparse.diags_array(weights.sum(axis=1)) - weights)


def _non_negative(mesh: TriangleMesh, values: ArrayLike, name: str) -> FloatArray:
    rows = channels(mesh, values, name)
    if len(rows) != 1:
        raise FunctionError(
            f"{name} has {len(rows)} channels; optimal transport takes one function (vertices,)"
        )
    worst = int(rows[0].argmin())
    if rows[0, worst] < -_NEGLIGIBLE * rows[0].max():
        raise FunctionError(
            f"{name} is negative at {np.count_nonzero(rows[0] < 0)} of {len(rows[0])} vertices, "
            f"down to {rows[0, worst]:g} at vertex {mesh.vertex_ids[worst]}; optimal transport "
            "moves mass, never negative"
        )
    if not rows[0].any():
        raise FunctionError(f"{name} is zero everywhere; optimal transport needs some mass to move")
    if not SMALLEST <= rows[0].max() <= LARGEST:
        raise FunctionError(
            f"{name} has values of up to {rows[0].max():.3g}, which over- or underflow; scale it "
            f"to between {SMALLEST:g} and {LARGEST:g}"
        )
    return np.asarray(np.maximum(rows[0], 0))
