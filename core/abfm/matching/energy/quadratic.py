"""Mismatches that are squares of norms."""

from abc import ABC, abstractmethod

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
