"""Sparse Cholesky factorisation by cholespy, or by SciPy's SuperLU if cholespy is missing."""

from __future__ import annotations

import atexit
import threading
import weakref
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import ClassVar

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from abfm.numerics.available_memory import require_memory
from abfm.numerics.factoring_in_subprocess import is_factored_in_subprocess
from abfm.types import FloatArray
from abfm.workers.progress import step, work_time
from abfm.workers.worker import Call, Worker, WorkerEndedError

try:
    from cholespy import CholeskySolverD, MatrixType
except ImportError:  # linux-aarch64 has no wheel of it
    CholeskySolverD = None

Solve = Callable[[FloatArray], FloatArray]

# Bytes to request per matrix entry and per log2(unknowns). Measured on surfaces of 642 to 163,842
# vertices: 6 to 11.
_BYTES_PER_ENTRY = 16


def factor(matrix: sparse.csr_array) -> Solve:
    """Factor a sparse symmetric positive definite matrix; return its solver for one vector (n,).

    The factorisation runs in a subprocess if `factoring_in_subprocess` chooses one. If it runs out
    of memory there, or the subprocess ends, the solver raises MemoryError. Otherwise `factor`
    itself raises MemoryError.
    """
    unknowns = matrix.shape[0]
    if unknowns == 0:  # the mesh has no inner vertices; both libraries refuse an empty matrix
        return np.copy
    # number of unknowns of an equally costly scalar system, which has seven entries per row
    work = unknowns * max(1.0, matrix.nnz / unknowns / 7) ** 2
    if is_factored_in_subprocess(work):
        return _SubprocessFactor(matrix)
    with _factoring_step(unknowns):
        return _factored(matrix)


def _factored(matrix: sparse.csr_array) -> Solve:
    if CholeskySolverD is not None:
        return _Factor(matrix)
    symmetric = {"SymmetricMode": True}
    solve: Solve = splu(matrix.tocsc(), "MMD_AT_PLUS_A", 0.0, options=symmetric).solve
    return solve


def _factoring_step(unknowns: int, since: float | None = None) -> AbstractContextManager[object]:
    """Return a progress step of factoring; nested dissection costs about ``unknowns^1.5``."""
    return step("factoring", unknowns**1.5, f" a system of {unknowns:,} unknowns", since)


class _Factor:
    """A factorisation by cholespy, which can be called to solve a system.

    A factorisation that outlives the interpreter, in a global variable or a thread, is reported on
    stderr as a memory leak. All factorisations are therefore released when Python ends.
    """

    _alive: ClassVar[weakref.WeakSet[_Factor]] = weakref.WeakSet()

    def __init__(self, matrix: sparse.csr_array) -> None:
        self._unknowns, self._has_solved, entries = matrix.shape[0], False, matrix.tocoo()
        require_memory(_BYTES_PER_ENTRY * matrix.nnz * np.log2(self._unknowns + 1))
        row, column = entries.row.astype(np.int32), entries.col.astype(np.int32)
        data = entries.data.astype(np.float64)
        self._solver = CholeskySolverD(self._unknowns, row, column, data, MatrixType.COO)
        _Factor._alive.add(self)

    def __call__(self, b: FloatArray) -> FloatArray:
        x = np.empty_like(b)
        self._solver.solve(b, x)
        self._has_solved = True
        return x

    def __del__(self) -> None:
        if not hasattr(self, "_solver"):  # the solver is already freed, or its allocation failed
            return
        if self._has_solved:
            # cholespy frees the buffer of the latest right-hand side when the number of columns
            # changes, but not in its destructor. Solving for zero columns frees it. Older versions
            # accept an empty array with these strides only.
            empty = np.ndarray((self._unknowns, 0), strides=(0, 8))
            self._solver.solve(empty, empty)
        del self._solver

    @staticmethod
    @atexit.register
    def _release() -> None:
        for each in list(_Factor._alive):
            each.__del__()


class _SubprocessFactor:
    """A factorisation in its own subprocess; the first solve waits until it is finished."""

    def __init__(self, matrix: sparse.csr_array) -> None:
        self._lock = threading.Lock()
        self._unknowns, self._since = matrix.shape[0], work_time()
        self._worker = Worker(_FactorHolder, "the process that factors a linear system has ended")
        self._factoring: Call[None] | None = self._worker.call(_FactorHolder.factor, matrix)

    def __call__(self, b: FloatArray) -> FloatArray:
        with self._lock:
            try:
                if self._factoring is not None:
                    with _factoring_step(self._unknowns, self._since):
                        self._factoring.result()
                    self._factoring = None
                return self._worker.call(_FactorHolder.solve, b).result()
            except WorkerEndedError as error:
                raise MemoryError(str(error)) from None


class _FactorHolder:
    _solve: Solve | None = None

    def factor(self, matrix: sparse.csr_array) -> None:
        self._solve = _factored(matrix)

    def solve(self, b: FloatArray) -> FloatArray:
        if self._solve is None:  # this subprocess replaces the one that had factored
            raise MemoryError("the process that factored a linear system has ended")
        return self._solve(b)
