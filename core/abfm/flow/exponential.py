"""The action of ``exp(-t D_v)`` on functions, and its adjoint.

``D_v`` is the derivative along a field v, and ``rho`` a bound of its spectral radius. The
exponential is a Chebyshev series on the imaginary axis, where the spectrum of ``D_v`` lies except
for small real parts. It is ``exp(-t D) f = sum_k c_k J_k(t rho) phi_k`` with Bessel functions
``J_k``, ``c_0 = 1`` and ``c_k = 2``. The terms are ``phi_0 = f``, ``phi_1 = -(D / rho) f`` and
``phi_(k+1) = -2 (D / rho) phi_k + phi_(k-1)``. A long time is split into equal segments. The
derivative is that of the computed sum, so it is exact for any truncation.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.special import jv

from abfm.calculus.channels import constant_part
from abfm.errors import AdvectionError
from abfm.flow.derivative import GROUP, UNSIGNED_ONE, DerivativePattern, dot, gathered, perron_bound
from abfm.numerics.kernels import kernel
from abfm.types import FloatArray, IndexArray

TOLERANCE = 1e-10  # default truncation of the series
# terms this much larger than the function lose five digits, so the time is split instead
_GROWTH_LIMIT = 1e5
_PRODUCT_LIMIT = 1e6
_PRODUCTS_MIN = 2.0  # segments with fewer products are not split, as this would not help
_BOUND_MIN = 1e-100  # smallest rho; a zero field also needs a positive rho for its derivative
_MEMORY = 70_000_000  # largest count of numbers in the stored terms
# Segment lengths in products. Shorter segments spend more than half of them on the tail.
_SHORT_SEGMENT = 30.0
_LONG_SEGMENT = 1000.0
# Smaller values, relative to the largest, count as 0. Their products are subnormal numbers, which
# processors handle many times more slowly; a narrow Gaussian has mostly such values.
_NEGLIGIBLE_SHARE = 1e-120
_SWEEP = 4  # terms per sweep, whose rows of the matrix stay in the cache together


class RowProducts:
    """A count of the products of functions with rows of ``D_v`` or of its transpose.

    ``is_shared`` is True if other counts were open at the same time, for example in another thread.
    Each of these counts then includes the products of all.
    """

    count, is_shared = 0, False


_open_counts: list[RowProducts] = []


@contextmanager
def counted_row_products() -> Iterator[RowProducts]:
    """Count the row products of all advections in this process while the context is open.

    On V vertices, each term of a series or of its adjoint has V row products.
    """
    products = RowProducts()
    _open_counts.append(products)
    if len(_open_counts) > 1:
        for each in _open_counts:
            each.is_shared = True
    try:
        yield products
    finally:
        _open_counts.remove(products)


def _count(terms: int, size: int) -> None:
    """Add the row products of a series to the open counts; its first term needs none."""
    for products in _open_counts:
        products.count += max(terms - 1, 0) * size


class Workspace:
    """Memory for the terms of series with ``size`` rows, reused between evaluations.

    The memory has about 560 MB, of which only the used part is touched. A full workspace needs as
    much scratch memory in addition.
    """

    def __init__(self, size: int) -> None:
        self.lock = threading.Lock()
        rows = _MEMORY // size
        longest = np.clip(2 * rows - _likely_terms(rows), _SHORT_SEGMENT, _LONG_SEGMENT)
        self.longest_segment = float(longest)
        self.block = len(_bessel_coefficients(self.longest_segment))
        self.capacity = min(rows, 8 * self.block)
        self.size, self.used, self.generation = size, self.block, 0

    @cached_property
    def rolling(self) -> FloatArray:
        """Memory for the last three terms (3, size) of a series that does not store its terms."""
        return np.empty((3, self.size))

    @cached_property
    def terms(self) -> FloatArray:
        """Memory for stored terms (capacity and two blocks, size), allocated when first needed."""
        return np.empty((self.capacity + 2 * self.block, self.size))

    def fits(self, rows: int) -> bool:
        """Return whether ``rows`` more terms fit; the first block is only for temporary terms."""
        return self.used - self.block + rows <= self.capacity

    def take(self, rows: int) -> FloatArray | None:
        """Return memory for ``rows`` terms, valid until `release`, or None if there is no space."""
        end = self.used + rows
        return self.terms[self.used : end] if end <= len(self.terms) else None

    def release(self) -> None:
        self.used = self.block
        self.generation += 1


def _likely_terms(x: float) -> int:
    """Return the usual number of terms at the default tolerance, for ``x = t rho``."""
    return int(x + 8 * np.cbrt(x)) + 8


def _bessel_coefficients(x: float) -> FloatArray:
    """Return the coefficients of the Chebyshev series, down to values below rounding errors.

    They are ``J_0(x)``, and ``2 J_k(x)`` for k > 0, with the Bessel functions J_k.
    """
    return bessel_coefficients(x, int(x + 14 * np.cbrt(x)) + 20)


@dataclass
class Segment:
    """One segment of an advection: the function at its start, and the count of terms of its series.

    The stored terms, if any, are valid until the workspace is released, which changes its
    generation.
    """

    start: FloatArray
    count: int
    terms: FloatArray | None = None
    generation: int = 0


@dataclass
class Trajectory:
    """An advected function (``end``), and the data for the adjoint of its advection.

    Each segment lasts a time ``step``. ``constant`` was subtracted before the segments and added to
    ``end``, because a flow does not change it.
    """

    step: float
    segments: list[Segment]
    end: FloatArray
    constant: float = 0.0


class ExponentialFlow:
    """The flow ``exp(-t D_v)`` of a field v (F, 2), as a truncated series for each time segment.

    The tolerance of the truncation is relative to ``max |f|`` of the advected function f.
    """

    def __init__(
        self,
        pattern: DerivativePattern,
        v: FloatArray,
        workspace: Workspace,
        tolerance: float = TOLERANCE,
    ) -> None:
        self.pattern, self.workspace, self.tolerance = pattern, workspace, tolerance
        self.values = pattern.values(v)
        bound = perron_bound(pattern.indptr, pattern.indices, self.values, 4)
        if not np.isfinite(bound):
            raise AdvectionError(
                "the field is not finite or overflows; expected one finite vector per face"
            )
        # The bound is rounded up to a grid, so that it is locally constant in the field, and the
        # derivative is exact.
        self.rho = float(2.0 ** (np.ceil(64 * np.log2(max(bound, _BOUND_MIN))) / 64))

    def transposed(self) -> ExponentialFlow:
        """Return the flow ``exp(-t D_v^T)`` of the transpose, which does not support clusters."""
        flow = copy(self)
        flow.values = self.pattern.transposed(self.values)
        return flow

    def forward(self, f: FloatArray, t: float, keep: bool = False) -> Trajectory:
        """Advect ``f`` (V,) over time ``t``.

        With ``keep``, terms are stored for `backward` if they fit into the workspace; otherwise
        `backward` computes them again.
        """
        x = abs(t) * self.rho
        if x > _PRODUCT_LIMIT:
            raise AdvectionError(
                f"advection over this time needs about {x:.0e} matrix products; expected at "
                f"most {_PRODUCT_LIMIT:.0e}. Shorten the time or scale the field down"
            )
        count = max(1, int(np.ceil(x / self.workspace.longest_segment)))
        used, constant = self.workspace.used, constant_part(f)  # a flow does not change constants
        f = f - constant if constant else f
        while (trajectory := self._attempt(f, t / count, count, keep)) is None:
            self.workspace.used = used
            count *= 2
        trajectory.constant = constant
        trajectory.end = trajectory.end + constant if constant else trajectory.end
        return trajectory

    def _attempt(self, f: FloatArray, step: float, count: int, keep: bool) -> Trajectory | None:
        """Advect ``f`` by ``count`` segments of time ``step``; return None if they are too long.

        Terms of the series of a long segment are so much larger than ``f`` that digits are lost.
        """
        x = abs(step) * self.rho
        coefficients = _bessel_coefficients(x)
        # without space, `backward` recomputes the terms of one segment after the other
        keep = keep and self.workspace.fits(count * _likely_terms(x))
        segments: list[Segment] = []
        state = f
        for _ in range(count):
            terms = self.workspace.take(len(coefficients)) if keep else None
            buffer = self.workspace.rolling if terms is None else terms
            end, used, growth = self._series(state, step, coefficients, buffer)
            if (used == 0 or growth > _GROWTH_LIMIT) and x > _PRODUCTS_MIN:
                return None
            if used == 0:
                return Trajectory(step, segments, np.full_like(f, np.inf))
            if terms is not None:
                self.workspace.used += used
            segments.append(Segment(state, used, terms, self.workspace.generation))
            state = end
        return Trajectory(step, segments, state)

    def _series(
        self, f: FloatArray, step: float, coefficients: FloatArray, terms: FloatArray
    ) -> tuple[FloatArray, int, float]:
        end = np.empty(self.pattern.size)
        series = self._series_of(self.values, step, coefficients)
        truncation = int(np.ceil(abs(step) * self.rho)), self.tolerance
        start = self.pattern.restricted(f)
        used, growth = chebyshev_forward(series, truncation, start, terms, end)
        _count(used, len(end))
        return self.pattern.extended(end), used, growth

    def _series_of(self, values: FloatArray, step: float, coefficients: FloatArray) -> Series:
        pattern, scale = self.pattern, -float(np.sign(step)) / self.rho
        return Series(pattern.indptr, pattern.indices, values, pattern.bounds, scale, coefficients)

    def backward(self, trajectory: Trajectory, mu: FloatArray, gradient: FloatArray) -> FloatArray:
        """Apply the adjoint of `forward` to the derivative ``mu`` (V,) of an energy by its result.

        Add the energy's derivative by the field to ``gradient`` (F, 2), and return its derivative
        by the function f.
        """
        coefficients = _bessel_coefficients(abs(trajectory.step) * self.rho)
        transposed = self.pattern.transposed(self.values)
        series = self._series_of(transposed, trajectory.step, coefficients)
        entries = np.zeros_like(transposed)
        for segment in reversed(trajectory.segments):
            terms = segment.terms
            if terms is None or segment.generation != self.workspace.generation:
                terms = self.workspace.terms[: len(coefficients)]  # the block for temporary terms
                self._series(segment.start, trajectory.step, coefficients, terms)
            _count(segment.count, self.pattern.size)
            dual = self.pattern.restricted_dual(mu)
            dual = chebyshev_backward(series, terms, segment.count, dual, entries)
            mu = self.pattern.extended_dual(dual)
        self.pattern.add_chain_rule(self.pattern.transposed(entries), gradient)
        return mu

    def span(self, f: FloatArray, times: FloatArray) -> FloatArray:
        """Advect ``f`` (V,) to T times of one sign, in ascending absolute value; return (T, V)."""
        trajectory = self.forward(f, float(times[-1]))
        step, last = trajectory.step, len(trajectory.segments) - 1
        out = np.repeat(trajectory.end[None], len(times), axis=0)
        owner = np.clip(np.ceil(times / step) - 1, 0, last) if step else np.zeros(len(times))
        coefficients = _bessel_coefficients(abs(step) * self.rho)
        terms = np.empty((len(coefficients), self.pattern.size))  # only the used part gets memory
        for index, segment in enumerate(trajectory.segments):
            inside = np.flatnonzero((owner == index) & (times != times[-1]))
            if len(inside):
                self._series(segment.start, step, coefficients, terms)
                local = np.abs(times[inside] - index * step) * self.rho
                series = 2 * jv(np.arange(segment.count), local[:, None])
                series[:, 0] /= 2
                advected = (series @ terms[: segment.count])[:, self.pattern.rank]
                out[inside] = advected + trajectory.constant
        return out


class Series(NamedTuple):
    """A series ``sum_k coefficients[k] phi_k`` for a matrix M that is stored in groups of entries.

    The terms are ``phi_0 = f`` (the function), ``phi_1 = scale M f`` and ``phi_(k+1) = 2 scale M
    phi_k + phi_(k-1)``. ``bounds`` divide the rows into blocks. The rows of a block have neighbours
    only in the same, the next or the previous block. Several terms can therefore be computed in one
    sweep, each one block behind the term before, while the matrix is in the cache. Terms are stored
    cyclically; the term before the first is 0.
    """

    indptr: IndexArray
    indices: IndexArray
    values: FloatArray
    bounds: IndexArray
    scale: float
    coefficients: FloatArray


@kernel
def bessel_coefficients(x: float, count: int) -> FloatArray:
    """Compute the ``count`` numbers ``J_0(x), 2 J_1(x), ...`` by Miller's recurrence.

    ``count`` must be so large that the last of these numbers is negligible.
    """
    out: FloatArray = np.zeros(count)
    if x == 0.0:
        out[0] = 1.0
        return out
    out[-1] = 1e-300
    for k in range(count - 1, 0, -1):
        out[k - 1] = 2 * k / x * out[k] - (out[k + 1] if k + 1 < count else 0.0)
        if abs(out[k - 1]) > 1e150:
            out[k - 1 :] *= 1e-150
    out[1:] *= 2.0
    out /= out[::2].sum()
    return out


@kernel
def _without_negligible(f: FloatArray) -> FloatArray:
    """Return a function (V,) with 0 in place of values that are negligible against the largest."""
    least = _NEGLIGIBLE_SHARE * np.abs(f).max()
    out: FloatArray = f.copy()
    for i in range(f.size):
        if abs(f[i]) < least:
            out[i] = 0.0
    return out


@kernel
def _forward_rows(series: Series, k: int, block: int, terms: FloatArray, out: FloatArray) -> float:
    """Compute term k of a series on a block of rows; return its largest absolute value.

    Add the term times its coefficient to ``out``. ``terms`` has the previous terms and receives the
    new one.
    """
    indptr, indices, values, bounds = series.indptr, series.indices, series.values, series.bounds
    factor, weight = series.scale if k == 1 else 2.0 * series.scale, series.coefficients[k]
    rows = terms.shape[0]
    now, before, after = terms[(k - 1) % rows], terms[(k - 2) % rows], terms[k % rows]
    largest = 0.0
    for i in range(bounds[block], bounds[block + 1]):
        total = 0.0
        for group in range(indptr[i], indptr[i + UNSIGNED_ONE]):
            total += dot(values[group], gathered(now, indices[group]))
        value = factor * total + before[i]
        after[i] = value
        out[i] += weight * value
        if not abs(value) <= largest:
            largest = abs(value)
    return largest


@kernel
def _sweep(
    series: Series, start: int, terms: FloatArray, out: FloatArray, largest: FloatArray
) -> None:
    """Compute several terms of a series, beginning with term ``start``, in one sweep over all rows.

    Their number is the length of ``largest``, which receives the largest absolute value of each.
    """
    blocks, steps = series.bounds.size - 1, largest.size
    largest[:] = 0.0
    for front in range(blocks + steps - 1):
        for step in range(max(0, front - blocks + 1), min(steps, front + 1)):
            highest = _forward_rows(series, start + step, front - step, terms, out)
            if not highest <= largest[step]:
                largest[step] = highest


@kernel
def chebyshev_forward(
    series: Series, truncation: tuple[int, float], f: FloatArray, terms: FloatArray, out: FloatArray
) -> tuple[int, float]:
    """Sum a series into ``out``; return the number of terms and ``max |phi_k| / max |f|``.

    ``truncation`` has the number of a term and a tolerance. The sum stops when two consecutive
    terms, from that term on, are below the tolerance times ``max |f|``. The returned number is 0 if
    there are too few coefficients or values overflow. ``terms`` (rows, V) receives the ``phi_k``
    cyclically.
    """
    first, tolerance = truncation
    coefficients, f = series.coefficients, _without_negligible(f)
    most = _SWEEP if series.bounds.size > 2 else 1
    top = 0.0
    for i in range(f.size):
        terms[0, i] = f[i]
        out[i] = coefficients[0] * f[i]
        if not abs(f[i]) <= top:
            top = abs(f[i])
    if top == 0.0:
        return 1, 1.0
    terms[-1, :] = 0.0  # the row before term 0
    growth = top
    small = 0
    for start in range(1, coefficients.size, most):
        largest = np.empty(min(most, coefficients.size - start))
        _sweep(series, start, terms, out, largest)
        for step in range(largest.size):
            k = start + step
            if not np.isfinite(largest[step]):
                return 0, np.inf
            growth = max(growth, largest[step])
            if small < 2:
                is_small = abs(coefficients[k]) * largest[step] <= tolerance * top
                small = small + 1 if k >= first and is_small else 0
        if small == 2:
            return start + largest.size, growth / top
    return 0, growth / top


@kernel
def _backward_rows(
    series: Series,
    place: tuple[int, int],
    term: FloatArray,
    duals: tuple[FloatArray, FloatArray],
    entries: FloatArray,
) -> None:
    """Compute the adjoint of term k of a series on a block of rows; ``place`` is (k, block).

    ``duals`` has the derivative of an energy by the sum, and memory for the results of the last
    three terms. Derivatives by the entries of the matrix are added to ``entries``.
    """
    (k, block), (mu, work) = place, duals
    indptr, indices = series.indptr, series.indices
    transposed, bounds = series.values, series.bounds
    factor, weight = series.scale if k == 0 else 2.0 * series.scale, series.coefficients[k]
    known, later, result = work[(k + 1) % 3], work[(k + 2) % 3], work[k % 3]
    for j in range(bounds[block], bounds[block + 1]):
        total = 0.0
        gain = factor * term[j]
        for group in range(indptr[j], indptr[j + UNSIGNED_ONE]):
            a = gathered(known, indices[group])
            total += dot(transposed[group], a)
            entry = entries[group]
            for slot in range(GROUP):
                entry[slot] += gain * a[slot]
        result[j] = weight * mu[j] + factor * total + later[j]


@kernel
def chebyshev_backward(
    series: Series, terms: FloatArray, count: int, mu: FloatArray, entries: FloatArray
) -> FloatArray:
    """Apply the adjoint of a series of ``count`` terms to ``mu`` (V,).

    ``mu`` is the derivative of an energy by the sum of the series. Return the energy's derivative
    by the function. ``series`` has the entries of the transposed matrix; the derivative by them is
    added to ``entries``. ``terms`` are those of `chebyshev_forward`.
    """
    blocks, mu = series.bounds.size - 1, _without_negligible(mu)
    most = _SWEEP if blocks > 1 else 1
    work: FloatArray = np.zeros((3, mu.size))
    for i in range(mu.size):
        work[(count - 1) % 3, i] = series.coefficients[count - 1] * mu[i]
    for start in range(count - 2, -1, -most):
        steps = min(most, start + 1)
        for front in range(blocks + steps - 1):
            for step in range(max(0, front - blocks + 1), min(steps, front + 1)):
                k = start - step
                _backward_rows(series, (k, front - step), terms[k], (mu, work), entries)
    mu_start: FloatArray = work[0].copy()
    return mu_start
