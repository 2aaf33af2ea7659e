"""Every numba kernel: arrays in and out, GIL released, compiled code kept on disk, one thread, fixed order of sums.

Indices are unsigned: a signed one would be tested for counting from the end at every use, which doubles the time.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

FloatArray = NDArray[np.float64]
IndexArray = NDArray[Any]
Kernel = TypeVar("Kernel", bound=Callable[..., Any])


def kernel(function: Kernel) -> Kernel:
    """Compile with the settings that all kernels share."""
    compiled = numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})(function)
    return cast(Kernel, compiled)


@kernel
def inner(a: FloatArray, b: FloatArray) -> float:
    """Inner product of two flat arrays, summed in order (the same bits whatever else runs)."""
    partial = np.zeros(8)
    whole = (a.size // 8) * 8
    for i in range(0, whole, 8):
        for lane in range(8):
            partial[lane] += a[i + lane] * b[i + lane]
    total: float = partial.sum()
    for i in range(whole, a.size):
        total += a[i] * b[i]
    return total


@kernel
def csr_product(indptr: IndexArray, indices: IndexArray, data: FloatArray, x: FloatArray, out: FloatArray) -> None:
    """``out = matrix @ x``."""
    for i in range(out.size):
        total = 0.0
        for e in range(indptr[i], indptr[i + 1]):
            total += data[e] * x[indices[e]]
        out[i] = total


def product(matrix: sparse.csr_array, x: FloatArray) -> FloatArray:
    """``matrix @ x`` for a CSR matrix, with the GIL released."""
    out = np.empty(matrix.shape[0])
    indptr, indices = unsigned(matrix.indptr), unsigned(matrix.indices)
    csr_product(indptr, indices, matrix.data, np.ascontiguousarray(x), out)
    return out


def unsigned(indices: IndexArray) -> IndexArray:
    """The same memory with the sign bit read as a digit."""
    return indices.view(np.uint32 if indices.itemsize == 4 else np.uint64)


@kernel
def assemble_derivative(
    faces: IndexArray,
    positions: IndexArray,
    slopes: FloatArray,
    inverse_areas: FloatArray,
    v: FloatArray,
    out: FloatArray,
) -> None:
    """Entries of ``D_v`` on the fixed sparsity of the vertex adjacency.

    ``slopes`` (F, 3, 2) holds ``A_F / 3 grad phi``, ``positions`` (F, 3, 3) the entry of row corner a, column corner b.
    """
    out[:] = 0.0
    for f in range(faces.shape[0]):
        for b in range(3):
            rate = slopes[f, b, 0] * v[f, 0] + slopes[f, b, 1] * v[f, 1]
            for a in range(3):
                out[positions[f, a, b]] += rate * inverse_areas[faces[f, a]]


@kernel
def assemble_derivative_transposed(
    faces: IndexArray,
    positions: IndexArray,
    slopes: FloatArray,
    inverse_areas: FloatArray,
    entries: FloatArray,
    out: FloatArray,
) -> None:
    """Chain rule of `assemble_derivative`: adds derivatives by the entries, as derivatives by the field, to ``out``."""
    for f in range(faces.shape[0]):
        for b in range(3):
            rate = 0.0
            for a in range(3):
                rate += entries[positions[f, a, b]] * inverse_areas[faces[f, a]]
            out[f, 0] += rate * slopes[f, b, 0]
            out[f, 1] += rate * slopes[f, b, 1]


@kernel
def perron_bound(indptr: IndexArray, indices: IndexArray, data: FloatArray, rounds: int) -> float:
    """Upper bound on the spectral radius: Collatz-Wielandt quotients of ``|matrix|``, the best of some rounds.

    The first round is the maximum norm ``||matrix||_inf``.
    """
    size = indptr.size - 1
    x = np.ones(size)
    y = np.empty(size)
    best = np.inf
    for _ in range(rounds):
        quotient = 0.0
        top = 0.0
        for i in range(size):
            total = 0.0
            for e in range(indptr[i], indptr[i + 1]):
                total += abs(data[e]) * x[indices[e]]
            y[i] = total
            ratio = total / x[i]
            if not ratio <= quotient:
                quotient = ratio
            if total > top:
                top = total
        if not quotient >= best:
            best = quotient
        if not (best > 0.0 and np.isfinite(best)):
            return quotient
        for i in range(size):
            x[i] = y[i] / top + 1e-3
    return best


@kernel
def chebyshev_forward(
    indptr: IndexArray,
    indices: IndexArray,
    data: FloatArray,
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
    """
    size = f.size
    rows = terms.shape[0]
    top = 0.0
    for i in range(size):
        terms[0, i] = f[i]
        out[i] = coefficients[0] * f[i]
        if not abs(f[i]) <= top:
            top = abs(f[i])
    if top == 0.0:
        return 1, 1.0
    limit = tolerance * top
    growth = top
    small = 0
    for k in range(1, coefficients.size):
        now = terms[(k - 1) % rows]
        before = terms[(k - 2) % rows]
        after = terms[k % rows]
        factor = scale if k == 1 else 2.0 * scale
        weight = coefficients[k]
        largest = 0.0
        for i in range(size):
            total = 0.0
            for e in range(indptr[i], indptr[i + 1]):
                total += data[e] * now[indices[e]]
            value = factor * total
            if k > 1:
                value += before[i]
            after[i] = value
            out[i] += weight * value
            if not abs(value) <= largest:
                largest = abs(value)
        if not largest <= growth:
            growth = largest
        if not np.isfinite(largest):
            return 0, np.inf
        small = small + 1 if k >= first and abs(weight) * largest <= limit else 0
        if small == 2:
            return k + 1, growth / top
    return 0, growth / top


@kernel
def chebyshev_backward(
    indptr: IndexArray,
    indices: IndexArray,
    transposed: FloatArray,
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
    size = mu.size
    work: FloatArray = np.zeros((3, size))
    for i in range(size):
        work[(count - 1) % 3, i] = coefficients[count - 1] * mu[i]
    for k in range(count - 2, -1, -1):
        known = work[(k + 1) % 3]
        later = work[(k + 2) % 3]
        result = work[k % 3]
        factor = scale if k == 0 else 2.0 * scale
        weight = coefficients[k]
        term = terms[k]
        for j in range(size):
            total = 0.0
            gain = factor * term[j]
            for e in range(indptr[j], indptr[j + 1]):
                a = known[indices[e]]
                total += transposed[e] * a
                entries[e] += gain * a
            result[j] = weight * mu[j] + factor * total + later[j]
    mu_start: FloatArray = work[0].copy()
    return mu_start
