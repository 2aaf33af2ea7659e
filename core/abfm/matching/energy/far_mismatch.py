"""A norm of mismatches that reaches far, for the first stages of a match.

Where source and target do not touch, the derivative of ``||f_tau - g||^2`` by the field is ``-grad(f^2)`` on the
source's own support: it says "shrink", never "move". Measured through the smoothing ``(A + s L)^-1``, with vertex
masses ``A`` and the cotangent stiffness ``L``, the mismatch is felt as far as ``sqrt(s)``. The kernel is positive
definite, so that only an exact match has none; it is the linearisation of optimal transport's distance [Peyre,
Comparison between W2 distance and H^-1 norm, and localization of Wasserstein distance, ESAIM: COCV 24 (2018)].
"""

import numpy as np
from scipy import sparse

from abfm.calculus.operators import Matrix, cotangent_laplacian, vertex_areas
from abfm.matching.energy.l2_mismatch import QuadraticMismatch
from abfm.mesh import TriangleMesh
from abfm.numerics.cholesky import factor
from abfm.types import FloatArray


class FarMismatch(QuadraticMismatch):
    """With the matrix ``c A_w (A + s L)^-1 A_w`` on vertex functions, ``s = reach^2``: one Cholesky solve.

    ``areas`` (V,) are ``A_w``, with the mask; ``reach`` is positive, in the mesh's length unit. The mismatch
    ``residuals`` (C, V), with ``weights`` (C,), shall have the same energy here and in L2, which fixes ``c``.
    """

    def __init__(
        self, mesh: TriangleMesh, areas: FloatArray, reach: float, residuals: FloatArray, weights: FloatArray
    ) -> None:
        self._areas = areas
        self._solve = factor(Matrix(sparse.diags_array(vertex_areas(mesh)) + reach**2 * cotangent_laplacian(mesh)))
        self._scale = 1.0
        near = sum(w * float(areas @ r**2) for w, r in zip(weights, residuals, strict=True))
        far = sum(w * float(r @ self(r)) for w, r in zip(weights, residuals, strict=True))
        if far > 0 and np.isfinite(near / far):
            self._scale = near / far

    def __call__(self, difference: FloatArray) -> FloatArray:
        return np.asarray(self._scale * self._areas * self._solve(self._areas * difference))
