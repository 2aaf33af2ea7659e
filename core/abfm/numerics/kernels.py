"""Settings that all numba kernels share, and kernels for sums and sparse products.

Kernels release the GIL, are cached on disk, and use one thread with a fixed summation order.
Indices are unsigned. Numba tests signed indices for negative values at every use, which doubles the
time.
"""

import hashlib
import inspect
import os
import sys
import threading
import warnings
from collections.abc import Callable
from contextlib import ExitStack, suppress
from typing import Any, TypeVar, cast

import numpy as np
from scipy import sparse

from abfm.errors import AbfmError
from abfm.types import FloatArray, IndexArray
from abfm.workers.progress import compiling

try:
    with warnings.catch_warnings():
        warnings.filterwarnings("error", "Environment variable", RuntimeWarning)
        import numba
        import numba.core.event
        from numba.core.dispatcher import Dispatcher
except (RuntimeWarning, ValueError) as error:
    settings = ", ".join(f"{k}={v!r}" for k, v in os.environ.items() if k.startswith("NUMBA_"))
    problem = str(error).partition("\n")[0].rstrip(".")
    raise AbfmError(
        f"numba rejects the environment variables {settings}: {problem}. Correct or unset the "
        "variable"
    ) from error

Kernel = TypeVar("Kernel", bound=Callable[..., Any])


class _CompilationListener(numba.core.event.Listener):
    """Reports progress while Numba compiles a kernel (a few seconds, once per machine)."""

    def __init__(self) -> None:
        self._open_steps = threading.local()

    def on_start(self, event: object) -> None:
        current = ExitStack()
        current.enter_context(compiling())
        self._open_steps.all = [*getattr(self._open_steps, "all", []), current]

    def on_end(self, event: object) -> None:
        self._open_steps.all.pop().close()


_listen: Callable[[str, object], None] = numba.core.event.register
_listen("numba:compile", _CompilationListener())


class _Cache:
    """The cache of numba on disk, except that errors of its files are ignored.

    If a file is damaged, the kernel is compiled anew. If writing fails, the kernel is not cached.
    """

    def __init__(self, cache: Any) -> None:
        self._cache = cache
        self.cache_path: str = cache.cache_path
        self.flush: Callable[[], None] = cache.flush

    def load_overload(self, signature: object, target: object) -> object:
        try:
            return self._cache.load_overload(signature, target)
        except Exception:  # cache files are pickles and may raise anything
            with suppress(OSError):
                self.flush()
            return None

    def save_overload(self, signature: object, compiled: object) -> None:
        with suppress(Exception):
            self._cache.save_overload(signature, compiled)


def kernel(function: Kernel) -> Kernel:
    """Compile a function with the settings of this module, and with fused multiply-adds."""
    return _compiled(function, {"contract"})


def unfused_kernel(function: Kernel) -> Kernel:
    """Compile a function as `kernel` does, but without fused multiply-adds.

    Whether products and sums are fused depends on inlining, which differs for callees loaded from
    the cache. Kernels that branch on signs could then decide differently.
    """
    return _compiled(function, set())


def _compiled(function: Kernel, fastmath: set[str]) -> Kernel:
    """Compile a function with the numba option ``fastmath``, or load it from the cache.

    numba reuses a cached function while the function's own file is unchanged. The name in the cache
    includes a digest of all files with kernels that it calls. A change of a kernel therefore also
    recompiles its callers in other files.
    """
    name = function.__qualname__
    function.__qualname__ = f"{name}_{_stamp(function.__globals__)}"
    compiled: Any = numba.njit(nogil=True, error_model="numpy", fastmath=fastmath)(function)
    if hasattr(compiled, "enable_caching"):  # the method is absent with NUMBA_DISABLE_JIT
        with suppress(RuntimeError):  # raised if no folder is writable
            compiled.enable_caching()
            compiled._cache = _Cache(compiled._cache)
    function.__qualname__ = name
    return cast(Kernel, compiled)


def _stamp(namespace: dict[str, Any]) -> str:
    """Return a digest of this file and of all files whose kernels a module (``namespace``) uses."""
    modules, remaining = {__name__}, [namespace]
    while remaining:
        for value in remaining.pop().values():
            if isinstance(value, Dispatcher) and value.__module__ not in modules:
                modules.add(value.__module__)
                remaining.append(vars(sys.modules[value.__module__]))
    sources = "".join(inspect.getsource(sys.modules[name]) for name in sorted(modules))
    return hashlib.sha256(sources.encode()).hexdigest()[:12]


def inner(a: FloatArray, b: FloatArray) -> float:
    total = 0.0
    for i in range(a.size):
        total += a[i] * b[i]
    return total


# the compiler fixes the order of the sum, so the bits do not depend on other threads
inner = _compiled(inner, {"contract", "reassoc"})


@kernel
def csr_product(
    indptr: IndexArray, indices: IndexArray, data: FloatArray, x: FloatArray, out: FloatArray
) -> None:
    for i in range(out.size):
        total = 0.0
        for e in range(indptr[i], indptr[i + 1]):
            total += data[e] * x[indices[e]]
        out[i] = total


def product(matrix: sparse.csr_array, x: FloatArray) -> FloatArray:
    """Compute ``matrix @ x`` for a CSR matrix, with the GIL released."""
    out = np.empty(matrix.shape[0])
    indptr, indices = unsigned(matrix.indptr), unsigned(matrix.indices)
    csr_product(indptr, indices, matrix.data, np.ascontiguousarray(x), out)
    return out


def unsigned(indices: IndexArray) -> IndexArray:
    return indices.view(np.uint32 if indices.itemsize == 4 else np.uint64)
