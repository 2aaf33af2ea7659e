"""Every numba kernel: arrays in and out, GIL released, compiled code kept on disk, one thread, fixed order of sums.

Indices are unsigned: a signed one would be tested for counting from the end at every use, which doubles the time.
"""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
import numpy as np
from scipy import sparse

from abfm.types import FloatArray, IndexArray

Kernel = TypeVar("Kernel", bound=Callable[..., Any])


def kernel(function: Kernel) -> Kernel:
    """Compile with the settings that all kernels share."""
    compiled = numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})(function)
    return cast(Kernel, compiled)


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract", "reassoc"})
def inner(a: FloatArray, b: FloatArray) -> float:
    """Inner product of two flat arrays, summed in the compiler's order (the same bits whatever else runs)."""
    total = 0.0
    for i in range(a.size):
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
