"""The norm ``||v||_alpha`` of fields (section 3) and its exact inverse.

``R = G_F D_alpha = M + alpha M (A G_1^-1 A^T + B G_0^-1 B^T) M`` with ``M = G_F``, the gradients ``A`` of edge and
``B`` of (rotated) vertex functions, and their masses. Because ``A^T M B = 0``, the Woodbury identity splits into two
scalar problems, ``R^-1 = M^-1 - alpha A (G_1 + alpha A^T M A)^-1 A^T - alpha B (G_0 + alpha B^T M B)^-1 B^T``.

The norm of second order, ``(id + alpha Delta_H)^2``, is ``R M^-1 R``, with the inverse ``R^-1 M R^-1``: fields of
finite norm are continuous, which those of the first order, the paper's, need not be in two dimensions.
"""

from __future__ import annotations

from copy import copy

import numpy as np
from scipy import sparse

from abfm import kernels
from abfm.cholesky import Solve, factor
from abfm.mesh import FloatArray, TriangleMesh, per_mesh
from abfm.operators import Matrix, edge_areas, face_areas, hodge_gradients, vertex_areas


@per_mesh
def _stacked(mesh: TriangleMesh) -> tuple[Matrix, Matrix, FloatArray]:
    """``[A B]``, its transpose (both sorted CSR), and the masses of edge and inner vertex functions."""
    both = sparse.hstack(hodge_gradients(mesh), format="csr")
    masses = np.concatenate([edge_areas(mesh), vertex_areas(mesh)[~mesh.is_boundary_vertex]])
    return Matrix(both), Matrix(both.T.tocsr()), masses


class Regularizer:
    """``R = G_F D_alpha^order`` on frame coefficients (F, 2): apply, and apply the inverse.

    Parameters
    ----------
    mesh : TriangleMesh
    alpha : float
        Weight of the Hodge Laplacian, in units of the mesh's area; not negative.
    order : int
        1 for the paper's norm, 2 for that of second order.
    """

    def __init__(self, mesh: TriangleMesh, alpha: float, order: int = 1) -> None:
        self.alpha, self.order = alpha, order
        self.mass = np.repeat(face_areas(mesh), 2)
        self._pair = hodge_gradients(mesh)  # not the mesh, which keeps this object: a cycle would outlive both
        self.gradients, self.transposed, self.masses = _stacked(mesh)
        self._factors: list[Solve] = []  # one list for all orders

    @property
    def _solvers(self) -> list[Solve]:
        if not self._factors:
            mass = sparse.diags_array(self.mass)
            self._factors += [
                factor(Matrix(sparse.diags_array(areas) + self.alpha * gradient.T @ mass @ gradient))
                for gradient, areas in zip(self._pair, self._split(self.masses), strict=True)
            ]
        return self._factors

    def of_order(self, order: int) -> Regularizer:
        """The same with another order; the factors are shared, also those that are not made yet."""
        other = copy(self)
        other.order = order
        return other

    def _split(self, stacked: FloatArray) -> list[FloatArray]:
        return np.split(stacked, [self._pair[0].shape[1]])

    def apply(self, v: FloatArray) -> FloatArray:
        """``R v``."""
        momentum = self._apply_once(v)
        for _ in range(self.order - 1):
            momentum = self._apply_once((momentum.ravel() / self.mass).reshape(v.shape))
        return momentum

    def inverse(self, momentum: FloatArray) -> FloatArray:
        """``R^-1 m``: two scalar solves for each order, factored at the first call."""
        v = self._invert_once(momentum)
        for _ in range(self.order - 1):
            v = self._invert_once((self.mass * v.ravel()).reshape(v.shape))
        return v

    def _apply_once(self, v: FloatArray) -> FloatArray:
        momentum = self.mass * v.ravel()
        if self.alpha > 0:
            derivatives = kernels.product(self.transposed, momentum) / self.masses
            momentum += self.alpha * self.mass * kernels.product(self.gradients, derivatives)
        return momentum.reshape(v.shape)

    def _invert_once(self, momentum: FloatArray) -> FloatArray:
        flat = momentum.ravel()
        v = flat / self.mass
        if self.alpha > 0:
            sources = self._split(kernels.product(self.transposed, flat))
            potentials = [solve(source) for solve, source in zip(self._solvers, sources, strict=True)]
            v -= self.alpha * kernels.product(self.gradients, np.concatenate(potentials))
        return v.reshape(momentum.shape)


def regularizer(mesh: TriangleMesh, alpha: float, order: int = 1) -> Regularizer:
    """The mesh's regulariser; the latest one is kept, so that only a new ``alpha`` factors again."""
    latest: Regularizer | None = mesh.cache.get("regularizer")
    if latest is None or latest.alpha != alpha:
        latest = mesh.cache["regularizer"] = Regularizer(mesh, alpha, order)
    return latest if latest.order == order else latest.of_order(order)
