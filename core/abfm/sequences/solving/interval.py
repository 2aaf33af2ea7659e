"""The field of one interval: its flow maps one frame to the next, close to adjacent fields.

The field is found by Gauss-Newton. Energy and gradient are those of the discrete flow (Eq. 6),
without approximation. The second derivative is that of the linear problem at the advected frame.
The linear system is solved by conjugate gradients, to the accuracy that a step needs [Nocedal &
Wright 2006, algorithm 7.1]. The preconditioner is the exact inverse of the norm.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from abfm.calculus.operators import averaging, gradient
from abfm.matching.objective.matching_energy import Evaluation, MatchingEnergy, Objective
from abfm.numerics.kernels import inner
from abfm.types import FloatArray
from abfm.workers.control import checkpoint

_STEPS_MAX = 8  # Gauss-Newton steps for one sigma
_GAIN_SHARE_MIN = 0.05  # the last step lowers the energy by a smaller share
_SUFFICIENT_DECREASE = 1e-4
_STEP_LENGTH_MIN = 0.1
# iterations of conjugate gradients in a step
_ITERATIONS_MIN = 4
_ITERATIONS_MAX = 60
_RESIDUAL_SHARE = 0.25  # conjugate gradients stop at this share of their first residual
COOLING_FACTOR = 3.0  # ratio of consecutive sigmas

Apply = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, eq=False)
class Neighbour:
    """The field (F, 2) of an adjacent interval, to which the field ``v`` should be close.

    It adds ``weight`` times ``1/2 ||v - field||_alpha^2`` times the duration of the interval to the
    energy.
    """

    field: FloatArray
    weight: float


@dataclass(frozen=True, eq=False)
class FieldPoint:
    """A field (F, 2), its evaluation, and its energy with the terms of adjacent fields."""

    field: FloatArray
    at: Evaluation
    energy: float


class Interval:
    """The minimisation of the energy of one interval, on the mesh scaled to unit area.

    Sigmas are absolute. A shift (C, V), see `advection_defect`, is subtracted from functions
    advected by the discrete flow.
    """

    def __init__(
        self,
        energy: MatchingEnergy,
        neighbours: Sequence[Neighbour] = (),
        shift: FloatArray | float = 0.0,
    ) -> None:
        self.energy, self._shift = energy, shift
        self._neighbours = [each for each in neighbours if each.weight > 0]
        self._norm, self._tau = energy.regularizer(), energy.parameters.tau

    def minimise_by_cooling(
        self, sigma: float, sigma_max: float, start: FloatArray | None
    ) -> FieldPoint:
        """Minimise the energy with decreasing sigmas, down to ``sigma``.

        The minimisation begins at ``start`` (F, 2) with the second smallest sigma, if the flow of
        ``start`` reduces the mismatch. This sigma smooths excess motion of ``start``. Otherwise the
        minimisation begins with no motion and the largest sigma.
        """
        objective = self._objective(sigma)
        zero_point = self._evaluated(objective, np.zeros(self.energy.shape[1:]))
        field, sigmas = zero_point.field, cooling(sigma, sigma_max)
        if (
            start is not None
            and self._evaluated(objective, start).at.mismatch < zero_point.at.mismatch
        ):
            field, sigmas = start, sigmas[-2:]
        for each in sigmas:
            point = self.minimise(each, field)
            field = point.field
        return point

    def minimise(self, sigma: float, field: FloatArray, steps: int = _STEPS_MAX) -> FieldPoint:
        """Minimise the energy from a field (F, 2), in at most ``steps`` steps.

        Stop after a step that hardly reduces the energy.
        """
        objective = self._objective(sigma)
        point = self._evaluated(objective, field)
        for _ in range(steps):
            checkpoint()
            found = self._step(objective, sigma, point)
            gained = point.energy - found.energy
            point = found
            if not gained > _GAIN_SHARE_MIN * point.energy:
                break
        return point

    def _objective(self, sigma: float) -> Objective:
        return self.energy.objective(sigma, shift=self._shift)

    def _step(self, objective: Objective, sigma: float, point: FieldPoint) -> FieldPoint:
        slope = point.at.gradient[0]
        for each in self._neighbours:
            difference = self._norm.apply(point.field - each.field)
            slope = slope + (self._tau * each.weight) * difference
        direction = self._conjugate_gradients(self._hessian(sigma, point.at), -slope)
        slope_along = _inner(direction, slope)
        length = 1.0
        while length >= _STEP_LENGTH_MIN and slope_along < 0:
            found = self._evaluated(objective, point.field + length * direction)
            if found.energy <= point.energy + _SUFFICIENT_DECREASE * length * slope_along:
                return found
            length /= 2
        return point

    def coupling_energy(self, field: FloatArray) -> float:
        total = 0.0
        for each in self._neighbours:
            difference = field - each.field
            square = _inner(difference, self._norm.apply(difference))
            total += 0.5 * self._tau * each.weight * square
        return total

    def _evaluated(self, objective: Objective, field: FloatArray) -> FieldPoint:
        at = objective.evaluate(field[None])
        return FieldPoint(field, at, at.energy + self.coupling_energy(field))

    @property
    def _stiffness(self) -> float:
        """Factor of the squared norm of the field in the energy, with adjacent fields."""
        return self._tau * (1 + sum(each.weight for each in self._neighbours))

    def _hessian(self, sigma: float, at: Evaluation) -> Apply:
        """Return a function that applies the Hessian of the linearised problem to a field (F, 2).

        The problem is linearised halfway between the advected frame and the target.
        """
        mesh, functions = self.energy.mesh, self.energy.functions
        mean, derive = averaging(mesh), gradient(mesh)
        halfway = 0.5 * (at.advected - self._shift + functions.target)
        slopes = [(derive @ each).reshape(-1, 2) for each in halfway]
        weights = functions.weights * (self._tau / sigma) ** 2
        areas, norm, stiffness = functions.areas, self._norm, self._stiffness

        def apply(field: FloatArray) -> FloatArray:
            product = stiffness * norm.apply(field)
            for slope, weight in zip(slopes, weights, strict=True):
                changes = mean @ np.einsum("fk,fk->f", slope, field)
                product += slope * (mean.T @ (weight * areas * changes))[:, None]
            return product

        return apply

    def _conjugate_gradients(self, hessian: Apply, right_side: FloatArray) -> FloatArray:
        """Solve ``hessian(x) = right_side`` by conjugate gradients, preconditioned by the norm."""
        found, residual = np.zeros_like(right_side), right_side.copy()
        direction = preconditioned = self._norm.inverse(residual) / self._stiffness
        first = size = _inner(residual, preconditioned)
        for count in range(1, _ITERATIONS_MAX + 1):
            if not size > 0:
                break
            product = hessian(direction)
            length = size / _inner(direction, product)
            found += length * direction
            residual -= length * product
            preconditioned = self._norm.inverse(residual) / self._stiffness
            before, size = size, _inner(residual, preconditioned)
            if count >= _ITERATIONS_MIN and size <= _RESIDUAL_SHARE**2 * first:
                break
            direction = preconditioned + size / before * direction
        return found


def cooling(sigma: float, sigma_max: float) -> list[float]:
    """Return sigmas that decrease to ``sigma`` by `COOLING_FACTOR`, from at most ``sigma_max``."""
    found = [sigma]
    while found[0] * COOLING_FACTOR <= sigma_max:
        found.insert(0, found[0] * COOLING_FACTOR)
    return found


def _inner(a: FloatArray, b: FloatArray) -> float:
    return inner(np.ascontiguousarray(a).ravel(), np.ascontiguousarray(b).ravel())
