"""Regularity of the fields plus the data terms of what they carry, and its gradient."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Protocol

import numpy as np

from abfm.errors import AdvectionError
from abfm.flow.advection import Advection
from abfm.flow.exponential import Trajectory
from abfm.matching.terms.data_term import Measure
from abfm.numerics import kernels
from abfm.types import FloatArray


@dataclass(frozen=True)
class Evaluation:
    """The objective at one point.

    Attributes
    ----------
    energy, regularity, mismatch : float
        Total and its two terms; infinite where the flow overflows.
    advected : (C, V) array
        What the data terms want carried, carried to the end time.
    differentiate : callable
        Computes the gradient; faster before than after the next evaluation.
    """

    energy: float
    regularity: float
    mismatch: float
    advected: FloatArray
    differentiate: Callable[[], FloatArray]

    @cached_property
    def gradient(self) -> FloatArray:
        """Derivative by the frame coefficients of the fields, (N, F, 2), made when asked for."""
        return self.differentiate()


class RegularityTerm(Protocol):
    """A quadratic norm of fields, ``v^T R v / 2``, whose inverse preconditions the descent."""

    def apply(self, v: FloatArray) -> FloatArray:
        """Return ``R v`` for frame coefficients (F, 2)."""
        ...

    def inverse(self, momentum: FloatArray) -> FloatArray:
        """Return ``R^-1 m``, exactly or about, symmetric positive definite."""
        ...


class Gradient(Protocol):
    """How the derivative by the fields is made of that by what they carry."""

    def carry(self, flow: Advection, f: FloatArray) -> list[Trajectory]:
        """Carry a function (V,) to the end time, with what is needed later."""
        ...

    def of_fields(
        self,
        flow: Advection,
        trajectories: Sequence[list[Trajectory]],
        residuals: FloatArray,
    ) -> FloatArray:
        """Return the derivative (N, F, 2), for that by the carried functions (C, V)."""
        ...


class Adjoint:
    """The exact derivative of the discrete flow, by its adjoint."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self._shape = shape

    def carry(self, flow: Advection, f: FloatArray) -> list[Trajectory]:
        """Carry a function (V,), and keep the terms that its adjoint needs."""
        return flow.forward(f, keep=True)

    def of_fields(
        self,
        flow: Advection,
        trajectories: Sequence[list[Trajectory]],
        residuals: FloatArray,
    ) -> FloatArray:
        gradient = np.zeros(self._shape)
        for trajectory, residual in zip(trajectories, residuals, strict=True):
            flow.backward(trajectory, residual, gradient)
        return gradient


@dataclass(frozen=True, eq=False)
class Mismatch:
    """Data terms with one sigma, and what they want carried.

    Attributes
    ----------
    carried : (C, V) array
        Functions to be carried.
    measure : Measure
    sigma : float
    offset : (C, V) array, optional
        What may be left of them.
    """

    carried: FloatArray
    measure: Measure
    sigma: float
    offset: FloatArray | None = None


class Objective:
    """``dtau/2 sum_j v_j^T R v_j`` plus data terms of what the flow of the fields carries (Eq. 6).

    Parameters
    ----------
    regularity : RegularityTerm
    mismatch : Mismatch
    advect : callable
        The flow of frame coefficients (N, F, 2).
    step : float
        ``dtau``, the time of each field.
    gradient : callable
        How the derivative is made at frame coefficients (N, F, 2).
    """

    def __init__(
        self,
        regularity: RegularityTerm,
        mismatch: Mismatch,
        advect: Callable[[FloatArray], Advection],
        step: float,
        gradient: Callable[[FloatArray], Gradient],
    ) -> None:
        self.regularity, self.mismatch, self.step = regularity, mismatch, step
        self._advect, self._gradient = advect, gradient

    def evaluate(self, fields: FloatArray) -> Evaluation:
        """Evaluate energy and gradient at frame coefficients (N, F, 2)."""
        with np.errstate(over="ignore", invalid="ignore"):  # an unstable flow ends in any numbers
            momentum = self.step * np.stack([self.regularity.apply(v) for v in fields])
            regularity = 0.5 * kernels.inner(momentum.ravel(), np.ascontiguousarray(fields).ravel())
            try:
                mismatch, advected, differentiate = self._missed(fields)
            except AdvectionError:
                mismatch, differentiate = np.inf, partial(np.full, fields.shape, np.nan)
                advected = np.full_like(self.mismatch.carried, np.nan)
        total = regularity + mismatch
        return Evaluation(total, regularity, mismatch, advected, lambda: momentum + differentiate())

    def _missed(self, fields: FloatArray) -> tuple[float, FloatArray, Callable[[], FloatArray]]:
        """Return the data terms, what was carried, and what computes their gradient."""
        goal, flow, gradient = self.mismatch, self._advect(fields), self._gradient(fields)
        trajectories, advected = [], np.empty_like(goal.carried)
        for c, f in enumerate(goal.carried):
            trajectories.append(gradient.carry(flow, f))
            advected[c] = trajectories[c][-1].end
            if not np.isfinite(advected[c]).all():
                raise AdvectionError("the advected function overflows")
        value, residuals = goal.measure.value_and_residual(advected, goal.sigma, goal.offset)
        if not np.isfinite(value):
            raise AdvectionError("the mismatch overflows")
        differentiate = partial(gradient.of_fields, flow, trajectories, residuals)
        return value, advected, differentiate
