"""Mismatches that are squares of norms, such as the paper's: that of L2 and, with beta, of their slopes."""

from abc import ABC, abstractmethod

from abfm.calculus.operators import function_norm_matrix
from abfm.mesh import TriangleMesh
from abfm.numerics import kernels
from abfm.types import FloatArray


class QuadraticMismatch(ABC):
    """``<d, M d> / 2`` with ``d`` the advected source less the target."""

    @abstractmethod
    def __call__(self, difference: FloatArray) -> FloatArray:
        """``M`` times a function (V,)."""

    def value_and_residual(self, advected: FloatArray, target: FloatArray, weight: float) -> tuple[float, FloatArray]:
        """``weight`` times the value for one channel (V,), and its derivative (V,) by the advected source."""
        difference = advected - target
        residual = weight * self(difference)
        return 0.5 * kernels.inner(residual, difference), residual


class L2Mismatch(QuadraticMismatch):
    """``||d||_beta^2 / 2``, with the matrix ``G_V C_beta`` (section 3) and a mask (V,) or None."""

    def __init__(self, mesh: TriangleMesh, beta: float, mask: FloatArray | None) -> None:
        self._matrix = function_norm_matrix(mesh, beta, mask)

    def __call__(self, difference: FloatArray) -> FloatArray:
        return kernels.product(self._matrix, difference)
