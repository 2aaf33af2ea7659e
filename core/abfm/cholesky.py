"""Sparse Cholesky factorisation: cholespy where it has wheels, SciPy's SuperLU elsewhere."""

from __future__ import annotations

from collections.abc import Callable

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
    entries = matrix.tocoo()
    solver = CholeskySolverD(
        matrix.shape[0],
        entries.row.astype(np.int32),
        entries.col.astype(np.int32),
        entries.data.astype(np.float64),
        MatrixType.COO,
    )

    def solve(b: FloatArray) -> FloatArray:
        x = np.empty_like(b)
        solver.solve(b, x)
        return x

    return solve
