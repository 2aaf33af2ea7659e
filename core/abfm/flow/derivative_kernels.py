"""Kernels for the matrix of ``D_v``: assembly, products, a bound on its spectrum.

Matrices come in groups of seven entries of one row: ``indptr`` counts groups, ``indices`` and
values are (G, 7), and what is left of a row's last group is padded with zeros. Seven are what a
vertex of valence six has. A group's loads all come before its stores, which is what makes the
adjoint fast.
"""

from typing import NamedTuple

import numpy as np

from abfm.numerics.kernels import kernel
from abfm.types import FloatArray, IndexArray

GROUP = 7
ONE = np.uint32(1)  # a signed one makes a signed index of the sum


class Assembly(NamedTuple):
    """The linear map from a field to the entries of ``D_v``."""

    faces: IndexArray  # (F, 3)
    positions: IndexArray  # (F, 3, 3), the entry of row corner a, column corner b
    slopes: FloatArray  # (F, 3, 2), ``A_F / 3 grad phi``
    inverse_areas: FloatArray  # (V,)


@kernel
def assemble_derivative(assembly: Assembly, v: FloatArray, out: FloatArray) -> None:
    """Assemble the entries of ``D_v`` on the fixed sparsity of the vertex adjacency."""
    faces, positions, slopes, inverse_areas = assembly
    out[:] = 0.0
    for f in range(faces.shape[0]):
        for b in range(3):
            rate = slopes[f, b, 0] * v[f, 0] + slopes[f, b, 1] * v[f, 1]
            for a in range(3):
                out[positions[f, a, b]] += rate * inverse_areas[faces[f, a]]


@kernel
def assemble_derivative_transposed(
    assembly: Assembly, entries: FloatArray, out: FloatArray
) -> None:
    """Add derivatives by the entries, as derivatives by the field (F, 2), to ``out``."""
    faces, positions, slopes, inverse_areas = assembly
    for f in range(faces.shape[0]):
        for b in range(3):
            rate = 0.0
            for a in range(3):
                rate += entries[positions[f, a, b]] * inverse_areas[faces[f, a]]
            out[f, 0] += rate * slopes[f, b, 0]
            out[f, 1] += rate * slopes[f, b, 1]


@kernel
def gathered(x: FloatArray, at: IndexArray) -> tuple[float, ...]:
    return x[at[0]], x[at[1]], x[at[2]], x[at[3]], x[at[4]], x[at[5]], x[at[6]]


@kernel
def dot(a: FloatArray, b: tuple[float, ...]) -> float:
    total: float = (
        a[0] * b[0]
        + a[1] * b[1]
        + a[2] * b[2]
        + a[3] * b[3]
        + a[4] * b[4]
        + a[5] * b[5]
        + a[6] * b[6]
    )
    return total


@kernel
def grouped_product(
    indptr: IndexArray, indices: IndexArray, values: FloatArray, x: FloatArray, out: FloatArray
) -> None:
    """Compute ``out = matrix @ x``."""
    for i in range(out.size):
        total = 0.0
        for group in range(indptr[i], indptr[i + 1]):
            total += dot(values[group], gathered(x, indices[group]))
        out[i] = total


@kernel
def perron_bound(indptr: IndexArray, indices: IndexArray, values: FloatArray, rounds: int) -> float:
    """Bound the spectral radius from above: Collatz-Wielandt quotients of ``|matrix|``, the best
    of some rounds.

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
            for group in range(indptr[i], indptr[i + 1]):
                for slot in range(GROUP):
                    total += abs(values[group, slot]) * x[indices[group, slot]]
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
