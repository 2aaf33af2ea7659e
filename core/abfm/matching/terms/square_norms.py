"""Squares of norms of functions: that of L2, with slopes, and one that is felt from afar."""

from typing import Protocol

import numpy as np
from scipy import sparse

from abfm.calculus.operators import (
    Matrix,
    cotangent_laplacian,
    function_norm_matrix,
    vertex_areas,
)
from abfm.mesh import TriangleMesh
from abfm.numerics import kernels
from abfm.numerics.cholesky import factor
from abfm.types import FloatArray


class SquareNorm(Protocol):
    """``<d, M d>`` with a symmetric positive semidefinite matrix."""

    def __call__(self, difference: FloatArray) -> FloatArray:
        """Return ``M`` times a function (V,)."""
        ...


class L2Norm:
    """``||d||_beta^2``, with the matrix ``G_V C_beta`` (section 3) and a mask (V,) or None."""

    def __init__(self, mesh: TriangleMesh, beta: float, mask: FloatArray | None) -> None:
        self._matrix = function_norm_matrix(mesh, beta, mask)

    def __call__(self, difference: FloatArray) -> FloatArray:
        return kernels.product(self._matrix, difference)


class SmoothedNorm:
    """``c A_w (A + s L)^-1 A_w`` on vertex functions, ``s = reach^2``: one Cholesky solve.

    Where source and target do not touch, the derivative of ``||f_tau - g||^2`` by the field is
    ``-grad(f^2)`` on the source's own support: it says "shrink", never "move". Measured through the
    smoothing, with vertex masses ``A`` and the cotangent stiffness ``L``, the mismatch is felt as
    far as ``sqrt(s)``. The kernel is positive definite, so that only an exact match has none; it is
    the linearisation of optimal transport's distance [Peyre, Comparison between W2 distance and
    H^-1 norm, and localization of Wasserstein distance, ESAIM: COCV 24 (2018)].

    ``areas`` (V,) are ``A_w``, with the mask; ``reach`` is positive, in the mesh's length unit.
    """

    def __init__(self, mesh: TriangleMesh, areas: FloatArray, reach: float) -> None:
        self._areas = areas
        masses = sparse.diags_array(vertex_areas(mesh))
        self._solve = factor(Matrix(masses + reach**2 * cotangent_laplacian(mesh)))
        self._scale = 1.0

    def agree_with_l2(self, differences: FloatArray, weights: FloatArray) -> None:
        """Choose ``c`` so that differences (C, V), with weights (C,), measure the same as in L2."""
        pairs = list(zip(weights, differences, strict=True))
        near = sum(w * float(self._areas @ d**2) for w, d in pairs)
        far = sum(w * float(d @ self(d)) for w, d in pairs)
        if far > 0 and np.isfinite(near / far):
            self._scale = near / far

    def __call__(self, difference: FloatArray) -> FloatArray:
        return np.asarray(self._scale * self._areas * self._solve(self._areas * difference))
