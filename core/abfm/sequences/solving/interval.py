"""One interval between two frames: the field whose flow carries one to the other, near those of the
intervals beside it.

Gauss-Newton: energy and gradient are the exact ones of the discrete flow (Eq. 6), and its second
derivative is taken as that of the linear problem at what is carried, whose system is solved by
conjugate gradients with the norm's exact inverse as preconditioner, as far as a step needs it
[Nocedal & Wright 2006, algorithm 7.1].
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

_STEPS = 8  # of Gauss-Newton with one sigma, at most
_GAIN_SHARE_MIN = 0.05  # share of the energy; a step that gains less is the last one
_SUFFICIENT_DECREASE = 1e-4
_STEP_LENGTH_MIN = 0.1
# of conjugate gradients in a step
_ITERATIONS_MIN = 4
_ITERATIONS_MAX = 60
_RESIDUAL_SHARE = 0.25  # of the first residual, where they end
COOLING_FACTOR = 3.0
"""Factor between two sigmas."""

Apply = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, eq=False)
class Neighbour:
    """A field (F, 2) that this one is to be near, and how much that weighs: ``weight`` times
    ``1/2 ||v - field||_alpha^2``, over the time of the interval.
    """

    field: FloatArray
    weight: float


@dataclass(frozen=True, eq=False)
class FieldPoint:
    """A field (F, 2) with its evaluation, and its energy with what neighbours say."""

    field: FloatArray
    at: Evaluation
    energy: float


class Interval:
    """The minimisation between two frames, in the units of the mesh scaled to unit area; sigma is
    absolute. A shift (C, V), see `advection_defect`, is taken off what the discrete flow carries.
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

    def find(self, sigma: float, warmest: float, start: FloatArray | None) -> FieldPoint:
        """Minimise with a sigma, by way of warmer ones: from a start (F, 2) and a little warmer,
        where that carries the one frame closer to the other than they were; else from no motion,
        and from the warmest on. What a start has too much of is smoothed away by the warmer one.
        """
        objective = self._objective(sigma)
        rest = self._evaluated(objective, np.zeros(self.energy.shape[1:]))
        field, sigmas = rest.field, cooling(sigma, warmest)
        if start is not None and self._evaluated(objective, start).at.mismatch < rest.at.mismatch:
            field, sigmas = start, sigmas[-2:]
        for each in sigmas:
            point = self.go_on(each, field)
            field = point.field
        return point

    def go_on(self, sigma: float, field: FloatArray, steps: int = _STEPS) -> FieldPoint:
        """Minimise with a sigma from a field (F, 2), by steps while they pay, at most so many."""
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
            apart = self._norm.apply(point.field - each.field)
            slope = slope + (self._tau * each.weight) * apart
        direction = self._solved(self._bend(sigma, point.at), -slope)
        downhill = _inner(direction, slope)
        length = 1.0
        while length >= _STEP_LENGTH_MIN and downhill < 0:
            found = self._evaluated(objective, point.field + length * direction)
            if found.energy <= point.energy + _SUFFICIENT_DECREASE * length * downhill:
                return found
            length /= 2
        return point

    def tied(self, field: FloatArray) -> float:
        """Return what neighbours add to the energy of a field (F, 2)."""
        total = 0.0
        for each in self._neighbours:
            apart = field - each.field
            total += 0.5 * self._tau * each.weight * _inner(apart, self._norm.apply(apart))
        return total

    def _evaluated(self, objective: Objective, field: FloatArray) -> FieldPoint:
        at = objective.evaluate(field[None])
        return FieldPoint(field, at, at.energy + self.tied(field))

    @property
    def _stiffness(self) -> float:
        """How many times the norm's form stands in the energy, with that of the neighbours."""
        return self._tau * (1 + sum(each.weight for each in self._neighbours))

    def _bend(self, sigma: float, at: Evaluation) -> Apply:
        """Return the second derivative of the linear problem halfway between carried and wanted."""
        mesh, functions = self.energy.mesh, self.energy.functions
        mean, derive = averaging(mesh), gradient(mesh)
        halfway = 0.5 * (at.advected - self._shift + functions.target)
        slopes = [(derive @ each).reshape(-1, 2) for each in halfway]
        weights = functions.weights * (self._tau / sigma) ** 2
        areas, norm, stiffness = functions.areas, self._norm, self._stiffness

        def apply(field: FloatArray) -> FloatArray:
            bent = stiffness * norm.apply(field)
            for slope, weight in zip(slopes, weights, strict=True):
                changes = mean @ np.einsum("fk,fk->f", slope, field)
                bent += slope * (mean.T @ (weight * areas * changes))[:, None]
            return bent

        return apply

    def _solved(self, bend: Apply, wanted: FloatArray) -> FloatArray:
        """Solve by conjugate gradients, preconditioned by the norm alone."""
        found, residual = np.zeros_like(wanted), wanted.copy()
        direction = eased = self._norm.inverse(residual) / self._stiffness
        first = size = _inner(residual, eased)
        for count in range(1, _ITERATIONS_MAX + 1):
            if not size > 0:
                break
            bent = bend(direction)
            length = size / _inner(direction, bent)
            found += length * direction
            residual -= length * bent
            eased = self._norm.inverse(residual) / self._stiffness
            before, size = size, _inner(residual, eased)
            if count >= _ITERATIONS_MIN and size <= _RESIDUAL_SHARE**2 * first:
                break
            direction = eased + size / before * direction
        return found


def cooling(sigma: float, warmest: float) -> list[float]:
    """Return sigmas that fall to this one, from the warmest at most."""
    found = [sigma]
    while found[0] * COOLING_FACTOR <= warmest:
        found.insert(0, found[0] * COOLING_FACTOR)
    return found


def _inner(a: FloatArray, b: FloatArray) -> float:
    return inner(np.ascontiguousarray(a).ravel(), np.ascontiguousarray(b).ravel())
