"""Every numba kernel: arrays in and out, GIL released, compiled code kept on disk, one thread, fixed order of sums.

Indices are unsigned: a signed one would be tested for counting from the end at every use, which doubles the time.
"""

import hashlib
import inspect
import sys
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numba.core.dispatcher import Dispatcher
from scipy import sparse

from abfm.types import FloatArray, IndexArray

Kernel = TypeVar("Kernel", bound=Callable[..., Any])


def kernel(function: Kernel) -> Kernel:
    """Compile with the settings that all kernels share.

    numba takes compiled code from disk as long as the function's own file is as it was. It is filed under a name with
    the stamp of the other files, so that a change of a kernel reaches those that call it from elsewhere, too.
    """
    name = function.__qualname__
    function.__qualname__ = f"{name}_{_stamp(function.__globals__)}"
    compiled = numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})(function)
    function.__qualname__ = name
    return cast(Kernel, compiled)


def _stamp(namespace: dict[str, Any]) -> str:
    """Of the source of this file and of all whose kernels a module, or what it calls, has."""
    modules, left = {__name__}, [namespace]
    while left:
        for value in left.pop().values():
            if isinstance(value, Dispatcher) and value.__module__ not in modules:
                modules.add(value.__module__)
                left.append(vars(sys.modules[value.__module__]))
    sources = "".join(inspect.getsource(sys.modules[name]) for name in sorted(modules))
    return hashlib.sha256(sources.encode()).hexdigest()[:12]


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
