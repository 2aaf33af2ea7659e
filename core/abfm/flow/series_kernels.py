"""Kernels for the Chebyshev series of ``exp(-t D_v)``: its coefficients, its sum and the adjoint of the sum."""

import numpy as np

from abfm.flow.derivative_kernels import GROUP, ONE, dot, gathered
from abfm.numerics.kernels import kernel
from abfm.types import FloatArray, IndexArray

_SWEEP = 4  # terms per sweep: their rows of the matrix together stay in the cache


@kernel
def bessel_coefficients(x: float, count: int) -> FloatArray:
    """``J_0(x), 2 J_1(x), 2 J_2(x), ...`` by Miller's recurrence; ``count`` is so large that the last one vanishes."""
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
def _forward_rows(
    indptr: IndexArray,
    indices: IndexArray,
    values: FloatArray,
    factor: float,
    weight: float,
    now: FloatArray,
    before: FloatArray,
    after: FloatArray,
    out: FloatArray,
    first: int,
    last: int,
) -> float:
    """``after = factor M now + before``, ``out += weight after`` on some rows; the largest ``|after|``."""
    largest = 0.0
    for i in range(first, last):
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
def chebyshev_forward(
    indptr: IndexArray,
    indices: IndexArray,
    values: FloatArray,
    bounds: IndexArray,
    scale: float,
    f: FloatArray,
    coefficients: FloatArray,
    first: int,
    tolerance: float,
    terms: FloatArray,
    out: FloatArray,
) -> tuple[int, float]:
    """``out = sum_k coefficients[k] phi_k`` with ``phi_1 = scale M f`` and ``phi_(k+1) = 2 scale M phi_k + phi_(k-1)``.

    ``terms`` (rows, V) receives the ``phi_k`` cyclically (all of them where it has as many rows as ``coefficients``).
    Stops after term ``first`` once two terms in a row are below ``tolerance * max |f|``. Returns how many terms
    were summed (0: the table of coefficients was too short) and ``max |phi_k| / max |f|``.

    The rows between two ``bounds`` have no neighbours beyond the next or last such block, so that several terms can be
    computed in one sweep, each a block behind the one before, while the matrix is in the cache.
    """
    rows = terms.shape[0]
    blocks = bounds.size - 1
    most = _SWEEP if blocks > 1 else 1
    top = 0.0
    for i in range(f.size):
        terms[0, i] = f[i]
        out[i] = coefficients[0] * f[i]
        if not abs(f[i]) <= top:
            top = abs(f[i])
    if top == 0.0:
        return 1, 1.0
    nothing = np.zeros(f.size)
    growth = top
    small = 0
    for start in range(1, coefficients.size, most):
        steps = min(most, coefficients.size - start)
        largest = np.zeros(steps)
        for front in range(blocks + steps - 1):
            for step in range(max(0, front - blocks + 1), min(steps, front + 1)):
                k, block = start + step, front - step
                highest = _forward_rows(
                    indptr,
                    indices,
                    values,
                    scale if k == 1 else 2.0 * scale,
                    coefficients[k],
                    terms[(k - 1) % rows],
                    nothing if k == 1 else terms[(k - 2) % rows],
                    terms[k % rows],
                    out,
                    bounds[block],
                    bounds[block + 1],
                )
                if not highest <= largest[step]:
                    largest[step] = highest
        for step in range(steps):
            k = start + step
            if not np.isfinite(largest[step]):
                return 0, np.inf
            growth = max(growth, largest[step])
            if small < 2:
                small = small + 1 if k >= first and abs(coefficients[k]) * largest[step] <= tolerance * top else 0
        if small == 2:
            return start + steps, growth / top
    return 0, growth / top


@kernel
def _backward_rows(
    indptr: IndexArray,
    indices: IndexArray,
    transposed: FloatArray,
    factor: float,
    weight: float,
    known: FloatArray,
    later: FloatArray,
    result: FloatArray,
    term: FloatArray,
    mu: FloatArray,
    entries: FloatArray,
    first: int,
    last: int,
) -> None:
    """``result = factor M^T known + later + weight mu`` on some rows; adds derivatives by entries to ``entries``."""
    for j in range(first, last):
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
    indptr: IndexArray,
    indices: IndexArray,
    transposed: FloatArray,
    bounds: IndexArray,
    scale: float,
    terms: FloatArray,
    coefficients: FloatArray,
    count: int,
    mu: FloatArray,
    entries: FloatArray,
) -> FloatArray:
    """Adjoint of `chebyshev_forward`: returns the derivative by ``f`` for the derivative ``mu`` by ``out``.

    ``transposed`` are the values of the transposed matrix on the same (structurally symmetric) sparsity; the derivative
    by the value of the transposed entry is added to ``entries``.
    """
    blocks = bounds.size - 1
    most = _SWEEP if blocks > 1 else 1
    work: FloatArray = np.zeros((3, mu.size))
    for i in range(mu.size):
        work[(count - 1) % 3, i] = coefficients[count - 1] * mu[i]
    for start in range(count - 2, -1, -most):
        steps = min(most, start + 1)
        for front in range(blocks + steps - 1):
            for step in range(max(0, front - blocks + 1), min(steps, front + 1)):
                k, block = start - step, front - step
                _backward_rows(
                    indptr,
                    indices,
                    transposed,
                    scale if k == 0 else 2.0 * scale,
                    coefficients[k],
                    work[(k + 1) % 3],
                    work[(k + 2) % 3],
                    work[k % 3],
                    terms[k],
                    mu,
                    entries,
                    bounds[block],
                    bounds[block + 1],
                )
    mu_start: FloatArray = work[0].copy()
    return mu_start
