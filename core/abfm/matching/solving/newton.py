"""Gauss-Newton search for landmarks, whose term has a known approximate second derivative.

If a changed field leads a flow line past the other side of a vertex, the line may end elsewhere,
and the energy jumps. A descent would stop at each jump, even if only one landmark causes it. This
search therefore lets the energy rise, and the caller selects the best iterate. A landmark that did
not move as its derivative predicted has a smaller weight in the next step.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.linalg import cho_factor, cho_solve

from abfm.matching.objective.matching_energy import Evaluation
from abfm.matching.terms.landmarks import LandmarkCurvature
from abfm.types import FloatArray
from abfm.workers.control import checkpoint

_DECREASE_SHARE = 1e-4  # sufficient decrease, relative to the prediction of the slope
_TRIALS_MAX = 6
_RISE_SHARE_MAX = 0.5  # largest accepted rise, relative to the energy
_ROUNDING_SHARE = 1e-16  # rounding errors of the energy, relative to it
# usual errors of the predicted position of a landmark: in sqrt(area), and relative to its motion
_ERROR_USUAL = 0.01
_ERROR_SHARE = 0.3

Inverse = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class Iterate:
    """An iterate of the Gauss-Newton search."""

    x: FloatArray
    point: Evaluation
    trust: FloatArray | float = 1.0  # weights of the derivatives of the landmarks, (L,), 0 to 1
    predicted: float = np.inf  # decrease of the energy that the last step predicted
    failed: bool = False


@dataclass(frozen=True, eq=False)
class GaussNewton:
    """The search for the minimum of an energy whose second derivative is about ``A + J^T D J``.

    ``A`` belongs to the norm of fields. ``J`` is the derivative of the ends of the landmarks, and
    ``D`` is diagonal, with the weights of the landmarks.
    """

    evaluate: Callable[[FloatArray], Evaluation]
    inverse: Inverse  # applies the inverse of A
    curvature: Callable[[FloatArray], LandmarkCurvature]  # J and D at given fields
    size: Callable[[FloatArray], float]  # the size of a step, at most ``size_max``
    size_max: float

    def init(
        self,
        x: FloatArray,
        point: Evaluation | None = None,
        before: object = None,
        steeper: float = 1.0,
    ) -> Iterate:
        """Return the first iterate; arguments that only `LBFGS` needs have no effect."""
        point = self.evaluate(x) if point is None else point
        return Iterate(x, point)

    def step(self, state: Iterate) -> Iterate:
        jacobian, weights, away = self.curvature(state.x)
        trusted = weights * np.repeat(state.trust, 2 if np.ndim(state.trust) else len(weights))
        gradient = state.point.gradient
        less = (jacobian.T @ ((weights - trusted) * away)).reshape(gradient.shape)
        direction = -with_landmarks(self.inverse, jacobian, trusted)(gradient - less)
        moved = (jacobian @ direction.ravel()).reshape(-1, 2)
        slope, full = float((direction * gradient).sum()), self.size(direction)
        length = min(1.0, self.size_max / full) if full > 0 else 1.0
        before, tried = state.point.energy, list[tuple[Evaluation, float]]()
        while len(tried) < _TRIALS_MAX:
            tried.append((self.evaluate(state.x + length * direction), length))
            if tried[-1][0].energy <= before + _DECREASE_SHARE * length * slope:
                break
            length /= 2
        point, length = min(tried, key=lambda trial: trial[0].energy)
        if point.energy > (1 + _RISE_SHARE_MAX) * before or point.landmark_errors is None:
            return replace(state, failed=True)
        trust = _trust(point.landmark_errors, away.reshape(-1, 2), length * moved)
        return Iterate(point.x, point, trust, abs(slope))

    def stop_reason(self, state: Iterate) -> str | None:
        if state.failed:
            return "line search failed"
        return "converged" if state.predicted <= _ROUNDING_SHARE * abs(state.point.energy) else None


def _trust(errors: FloatArray, away: FloatArray, moved: FloatArray) -> FloatArray:
    """Return weights (L,) of landmarks, smaller for those that did not move as predicted.

    ``errors`` (L,) are measured after the step, and ``away`` (L, 2) are the residuals before it.
    The predicted motion is ``moved`` (L, 2).
    """
    expected = np.linalg.norm(away + moved, axis=1)
    usual = np.maximum(_ERROR_USUAL, _ERROR_SHARE * np.linalg.norm(moved, axis=1))
    return np.asarray(1 / (1 + ((errors - expected) / usual) ** 2))


def with_landmarks(inverse: Inverse, jacobian: sparse.csr_array, curvature: FloatArray) -> Inverse:
    """Return the inverse of ``A + J^T D J`` from that of A, by the Woodbury identity.

    J is ``jacobian`` (M, n), and D the diagonal matrix of ``curvature`` (M,). The first call
    applies the inverse of A once for each row of J.
    """
    rows, curvature = jacobian[curvature > 0], curvature[curvature > 0]
    known: list[tuple[FloatArray, tuple[FloatArray, bool]]] = []

    def applied(gradient: FloatArray) -> FloatArray:
        if not known:  # the first call computes the factors
            moved = np.empty((len(curvature), gradient.size))
            for number in range(len(curvature)):
                checkpoint()
                row = rows[[number]].toarray().reshape(gradient.shape)
                moved[number] = inverse(row).ravel()
            inner = np.diag(1 / curvature) + rows @ moved.T
            known.append((moved, cho_factor((inner + inner.T) / 2)))
        moved, factor = known[0]
        correction = moved.T @ cho_solve(factor, moved @ gradient.ravel())
        found: FloatArray = inverse(gradient) - correction.reshape(gradient.shape)
        return found

    return applied
