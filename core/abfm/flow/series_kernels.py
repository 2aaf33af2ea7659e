"""Kernels for the Chebyshev series of ``exp(-t D_v)``: coefficients, sum and adjoint."""

from typing import NamedTuple

import numpy as np

from abfm.flow.derivative_kernels import GROUP, ONE, dot, gathered
from abfm.numerics.kernels import kernel
from abfm.types import FloatArray, IndexArray

_SWEEP = 4  # terms per sweep: their rows of the matrix together stay in the cache


class Series(NamedTuple):
    """``sum_k coefficients[k] phi_k`` with ``phi_1 = scale M f`` and
    ``phi_(k+1) = 2 scale M phi_k + phi_(k-1)``, for a matrix M in groups.

    The rows between two ``bounds`` have no neighbours beyond the next or last such block, so that
    several terms can be computed in one sweep, each a block behind the one before, while the matrix
    is in the cache.
    """

    indptr: IndexArray
    indices: IndexArray
    values: FloatArray
    bounds: IndexArray
    scale: float
    coefficients: FloatArray


@kernel
def bessel_coefficients(x: float, count: int) -> FloatArray:
    """Compute ``J_0(x), 2 J_1(x), 2 J_2(x), ...`` by Miller's recurrence; ``count`` is so
    large that the last one vanishes.
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
def _forward_rows(series: Series, k: int, block: int, terms: FloatArray, out: FloatArray) -> float:
    """Compute term k, and add it to ``out``, on a block of rows; returns the largest entry there.

    Terms are kept cyclically; that before the first is 0.
    """
    indptr, indices, values, bounds = series.indptr, series.indices, series.values, series.bounds
    factor, weight = series.scale if k == 1 else 2.0 * series.scale, series.coefficients[k]
    rows = terms.shape[0]
    now, before, after = terms[(k - 1) % rows], terms[(k - 2) % rows], terms[k % rows]
    largest = 0.0
    for i in range(bounds[block], bounds[block + 1]):
        total = 0.0
        for group in range(indptr[i], indptr[i + ONE]):
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
    """Compute as many terms as ``largest`` has entries, from term ``start`` on."""
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
    """Sum a series into ``out``.

    ``terms`` (rows, V) receives the ``phi_k`` cyclically (all of them where it has as many rows as
    there are coefficients). Stops after the first term of the ``truncation`` once two terms in a
    row are below its tolerance times ``max |f|``. Returns how many terms were summed (0: the table
    of coefficients was too short) and ``max |phi_k| / max |f|``.
    """
    first, tolerance = truncation
    coefficients = series.coefficients
    most = _SWEEP if series.bounds.size > 2 else 1
    top = 0.0
    for i in range(f.size):
        terms[0, i] = f[i]
        out[i] = coefficients[0] * f[i]
        if not abs(f[i]) <= top:
            top = abs(f[i])
    if top == 0.0:
        return 1, 1.0
    terms[-1, :] = 0.0  # before term 0
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
    """Compute the derivative by term k on a block of rows, from those by the two terms after it,
    and add derivatives by entries to ``entries``.
    """
    k, block = place
    mu, work = duals
    indptr = series.indptr
    indices = series.indices
    transposed = series.values
    bounds = series.bounds
    factor, weight = series.scale if k == 0 else 2.0 * series.scale, series.coefficients[k]
    known, later, result = work[(k + 1) % 3], work[(k + 2) % 3], work[k % 3]
    for j in range(bounds[block], bounds[block + 1]):
        total = 0.0
        gain = factor * term[j]
        for group in range(indptr[j], indptr[j + ONE]):
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
    """Apply the adjoint of `chebyshev_forward`, which summed ``count`` terms: returns the
    derivative by ``f`` for the derivative ``mu`` by ``out``.

    The series has the values of the transposed matrix on the same (structurally symmetric)
    sparsity; the derivative by the value of the transposed entry is added to ``entries``.
    """
    blocks = series.bounds.size - 1
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
