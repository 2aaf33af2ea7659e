"""What the energy is made of, and which norms it takes: another one is a file of its own and a line here."""

from typing import Protocol

from abfm.matching.energy.far_mismatch import FarMismatch
from abfm.matching.energy.l2_mismatch import L2Mismatch
from abfm.matching.energy.problem import Problem
from abfm.matching.energy.regularizer import Regularizer, regularizer
from abfm.mesh import TriangleMesh
from abfm.parameters import Parameters
from abfm.types import FloatArray


class RegularityTerm(Protocol):
    """A quadratic norm of fields, ``v^T R v / 2``, whose inverse preconditions the descent."""

    def apply(self, v: FloatArray) -> FloatArray:
        """``R v`` for frame coefficients (F, 2)."""

    def inverse(self, momentum: FloatArray) -> FloatArray:
        """``R^-1 m``, exactly or about, symmetric positive definite."""


class DataTerm(Protocol):
    """What is left between the advected source and the target, as a number; it need not be quadratic."""

    def value_and_residual(self, advected: FloatArray, target: FloatArray, weight: float) -> tuple[float, FloatArray]:
        """``weight`` times the value for one channel (V,), and its derivative (V,) by the advected source."""


def regularity_term(mesh: TriangleMesh, parameters: Parameters, alpha: float) -> RegularityTerm:
    """The norm of fields on a mesh of unit area, with this alpha; the mesh keeps that of the parameters."""
    return (regularizer if alpha == parameters.alpha else Regularizer)(mesh, alpha, parameters.order)


def data_term(problem: Problem, parameters: Parameters, reach: float) -> DataTerm:
    """The norm of mismatches, or that of early stages, which reaches farther than 0."""
    if reach:
        return FarMismatch(problem.mesh, problem.areas, reach, problem.source - problem.target, problem.weights)
    return L2Mismatch(problem.mesh, parameters.beta, problem.mask)
