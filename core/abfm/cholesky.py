"""Sparse Cholesky factorisation: cholespy where it has wheels, SciPy's SuperLU elsewhere."""

from __future__ import annotations

import atexit
import weakref
from collections.abc import Callable
from typing import ClassVar

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from abfm.mesh import FloatArray

try:
    from cholespy import CholeskySolverD, MatrixType
except ImportError:  # no wheel for linux-aarch64
    CholeskySolverD = None

Solve = Callable[[FloatArray], FloatArray]


def factor(matrix: sparse.csr_array) -> Solve:
    """Factor a sparse symmetric positive definite matrix once; the result solves for one right-hand side (n,)."""
    if matrix.shape[0] == 0:  # a mesh without inner vertices; both libraries refuse it
        return np.copy
    if CholeskySolverD is None:
        return splu(
            matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        ).solve
    return _Factor(matrix)


class _Factor:
    """A factorisation by cholespy.

    One that outlives the interpreter, as global variables and threads make it, is reported on stderr as a leak of
    cholespy's: all are therefore released when Python ends.
    """

    _alive: ClassVar[weakref.WeakSet[_Factor]] = weakref.WeakSet()

    def __init__(self, matrix: sparse.csr_array) -> None:
        entries = matrix.tocoo()
        self._solver = CholeskySolverD(
            matrix.shape[0],
            entries.row.astype(np.int32),
            entries.col.astype(np.int32),
            entries.data.astype(np.float64),
            MatrixType.COO,
        )
        _Factor._alive.add(self)

    def __call__(self, b: FloatArray) -> FloatArray:
        x = np.empty_like(b)
        self._solver.solve(b, x)
        return x

    @staticmethod
    @atexit.register
    def _release() -> None:
        for each in list(_Factor._alive):
            del each._solver
