"""Eigenfunctions of the Laplace-Beltrami operator."""

from typing import Any

import numpy as np
from scipy import linalg, sparse
from scipy.sparse.linalg import ArpackError, LinearOperator, eigsh

from abfm.calculus.operators import cotangent_laplacian, vertex_areas
from abfm.errors import AbfmError, FunctionError, brief
from abfm.mesh import TriangleMesh, per_mesh
from abfm.numerics.cholesky import factor
from abfm.numerics.real_numbers import is_integer
from abfm.types import FloatArray
from abfm.workers.progress import step

BLOCKS = (32, 64, *range(128, 1025, 128))


def eigenbasis(mesh: TriangleMesh, k: int) -> tuple[FloatArray, FloatArray]:
    """Compute the first k (at most 1024) eigenpairs of ``L phi = lambda M phi``.

    Return read-only eigenvalues (k,), ascending, and eigenfunctions (V, k). L is the cotangent
    Laplacian (natural, that is Neumann, condition on a boundary), M the lumped mass. Eigenvalues
    are in 1/length^2 of the mesh's unit, eigenfunctions orthonormal in ``sum_i M_ii phi_i psi_i``.
    The sign of an eigenfunction makes the integral of ``phi^3`` positive. If that integral vanishes
    (by a symmetry), consider the first vertex with at least half of the largest absolute value: phi
    is positive there.

    The same mesh gives the same bits, independent of earlier computations. Pairs are computed and
    cached in blocks of the first 32, 64, 128, 256, 384, ... pairs; k selects the smallest
    sufficient block. For repeated eigenvalues, the basis is arbitrary and may differ between
    blocks.
    """
    count = len(mesh.vertices)
    most = min(count, BLOCKS[-1])
    if not is_integer(k, 1, most):
        raise FunctionError(
            f"{brief(k)} eigenfunctions requested; expected 1 to {most} on a mesh of {count} "
            "vertices"
        )
    k = int(k)
    values, functions = _block(mesh, min(next(block for block in BLOCKS if block >= k), count))
    return values[:k], functions[:, :k]


def unit_eigenbasis(mesh: TriangleMesh, k: int) -> tuple[FloatArray, FloatArray]:
    """Compute the `eigenbasis` of the mesh scaled to unit area, which has no unit of length."""
    return eigenbasis(mesh.normalized(), k)


@per_mesh
def _block(mesh: TriangleMesh, size: int) -> tuple[FloatArray, FloatArray]:
    count = len(mesh.vertices)
    root_mass = np.sqrt(vertex_areas(mesh))
    scale = sparse.diags_array(1 / root_mass)
    operator = sparse.csr_array(scale @ cotangent_laplacian(mesh) @ scale)
    if count <= 2 * size + 1:  # the matrix is too small for the Lanczos basis
        found = linalg.eigh(operator.toarray(), subset_by_index=(0, size - 1))
        values, vectors = (np.asarray(array, dtype=np.float64) for array in found)
    else:
        with step("computing eigenfunctions", count * size, f": {size}"):
            shift = 1 / mesh.length_scale**2
            solve = factor(sparse.csr_array(operator + shift * sparse.eye_array(count)))
            inverse = LinearOperator((count, count), matvec=solve, dtype=np.float64)
            values, vectors = lanczos(
                operator, size, FunctionError, "eigenfunctions", sigma=-shift, OPinv=inverse
            )
    order = np.argsort(values, kind="stable")
    functions = vectors[:, order] / root_mass[:, None]
    skewness, sizes = vertex_areas(mesh) @ functions**3, np.abs(functions)
    first_large = np.argmax(sizes >= 0.5 * sizes.max(axis=0), axis=0)
    fallback = functions[first_large, np.arange(functions.shape[1])]
    is_skew = np.abs(skewness) > 1e-6 * (vertex_areas(mesh) @ sizes**3)
    functions *= np.sign(np.where(is_skew, skewness, fallback))
    values = np.maximum(values[order], 0)
    values.flags.writeable = functions.flags.writeable = False
    return values, functions


def lanczos(
    operator: Any, count: int, error: type[AbfmError], what: str, **options: Any
) -> tuple[FloatArray, FloatArray]:
    """Return ``count`` eigenvalues and eigenvectors of an operator, computed by SciPy's `eigsh`.

    The start vector is fixed, so that results are reproducible; ``options`` are those of `eigsh`.
    If the iteration does not converge, an ``error`` is raised whose message begins with ``what``.
    """
    start = np.sin(np.arange(1.0, operator.shape[0] + 1))
    try:
        values, vectors = eigsh(operator, k=count, v0=start, rng=0, **options)
    except ArpackError as problem:
        raise error(
            f"{what}: no convergence on this mesh ({problem}). Remesh its thin faces"
        ) from problem
    return np.asarray(values), np.asarray(vectors)
