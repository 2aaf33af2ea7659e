"""The paper's norm of mismatches: that of L2 and, with beta, of their slopes."""

from abfm.calculus.operators import function_norm_matrix
from abfm.matching.energy.quadratic import QuadraticMismatch
from abfm.mesh import TriangleMesh
from abfm.numerics import kernels
from abfm.types import FloatArray


class L2Mismatch(QuadraticMismatch):
    """``||d||_beta^2 / 2``, with the matrix ``G_V C_beta`` (section 3) and a mask (V,) or None."""

    def __init__(self, mesh: TriangleMesh, beta: float, mask: FloatArray | None) -> None:
        self._matrix = function_norm_matrix(mesh, beta, mask)

    def __call__(self, difference: FloatArray) -> FloatArray:
        """``G_V C_beta d``."""
        return kernels.product(self._matrix, difference)
