"""Preconditioned L-BFGS [Nocedal & Wright 2006, ch. 7] as an iterator: init, step, stop test.

SciPy's has no preconditioner, and cannot stop between two iterations or learn from an earlier run;
its line search does not survive energies that are not finite, and asks for slopes where the value
alone rules a step out.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, NamedTuple, Protocol, TypeVar

import numpy as np

from abfm.numerics.kernels import inner, kernel
from abfm.types import FloatArray

WOLFE_DECREASE = 1e-4
WOLFE_CURVATURE = 0.9
TRIALS_MAX = 12
_RELATIVE_ROUNDING = 1e-16


class Evaluation(Protocol):
    """What the optimiser needs to know of an energy at a point."""

    @property
    def energy(self) -> float: ...
    @property
    def gradient(self) -> FloatArray: ...


Point = TypeVar("Point", bound=Evaluation)


class Pair(NamedTuple):
    """A step ``s``, the change ``y`` of gradient along it, ``H_0 y``, and ``1 / <s, y>``; flat."""

    s: FloatArray
    y: FloatArray
    preconditioned: FloatArray
    rho: float


@dataclass(frozen=True)
class Trial(Generic[Point]):
    """One step length: value, and slope along the direction (NaN where the value rules it out)."""

    length: float
    value: float
    slope: float
    point: Point


@dataclass(frozen=True)
class Iterate(Generic[Point]):
    """One iterate of L-BFGS."""

    x: FloatArray  # never has a higher energy than the one before
    point: Point  # evaluation at x, with gradient g
    preconditioned: FloatArray  # H_0 g
    pairs: tuple[Pair, ...]  # latest ones, oldest first
    scale: float  # factor of H_0 in the next direction
    gradient_norm: float  # sqrt(<g, H_0 g>), the norm dual to the preconditioner's
    first_norm: float  # the same at the first iterate
    # size of the latest step; the next search begins with at most twice as much
    length: float = 0.0
    failed: bool = False  # the line search found no lower energy: x is the iterate before


@dataclass(frozen=True, eq=False)
class LBFGS(Generic[Point]):
    """Minimise an energy by L-BFGS with a strong Wolfe search.

    ``evaluate`` makes an evaluation of an array; the energy may be infinite. The gradient is asked
    for only where it is needed, at the latest before the next evaluation. ``precondition`` is
    ``H_0``: it applies a symmetric positive definite approximation of the inverse Hessian. Without
    it ``H_0`` is the usual multiple of the identity, ``<s, y> / <y, y>``.
    """

    evaluate: Callable[[FloatArray], Point]
    precondition: Callable[[FloatArray], FloatArray] | None = None
    memory: int = 10  # pairs kept
    # of a step as the user measures it
    size: Callable[[FloatArray], float] = lambda step: float(np.abs(step).max())
    step_size_max: float = np.inf  # the most that the size of a step may be
    tolerance: float = 1e-6  # converged when the gradient's norm is this fraction of the first one

    def init(
        self,
        x: FloatArray,
        point: Point | None = None,
        previous: Iterate[Point] | None = None,
        curvature_ratio: float = 1.0,
    ) -> Iterate[Point]:
        """Return the first iterate, with its evaluation if there is one already.

        Reuse what the ``previous`` search learned. The curvature of this energy is about
        ``curvature_ratio`` times as large.
        """
        point = self.evaluate(x) if point is None else point
        preconditioned, norm = self._preconditioned(point.gradient)
        if previous is None:
            return Iterate(x, point, preconditioned, (), 1.0, norm, norm)
        pairs = tuple(
            Pair(s, curvature_ratio * y, curvature_ratio * hy, rho / curvature_ratio)
            for s, y, hy, rho in previous.pairs
        )
        scale = previous.scale / curvature_ratio
        return Iterate(x, point, preconditioned, pairs, scale, norm, norm, previous.length)

    def step(self, state: Iterate[Point]) -> Iterate[Point]:
        """Do one iteration; where the search fails, again without the memory."""
        direction = -self._inverse_hessian(state)
        slope = _inner(direction, state.point.gradient)
        trial = None
        if slope < 0:
            full = self.size(direction)
            length_max = self.step_size_max / full if full > 0 else 1.0
            first = 1.0
            if self.precondition and state.pairs:
                first = min(1.0, 2 * state.length / full)
            elif not state.pairs and not self.precondition:
                # of length 1, whatever frames the unknowns are in
                first = min(1.0, 1.0 / float(np.sqrt(-slope)))
            trial = strong_wolfe(
                lambda length: self.evaluate(state.x + length * direction),
                lambda point: _inner(direction, point.gradient),
                Trial(0.0, state.point.energy, slope, state.point),
                first,
                length_max,
            )
        if trial:
            return self._accept(state, trial, direction)
        without_pairs = replace(state, pairs=(), scale=1.0)
        return self.step(without_pairs) if state.pairs else replace(without_pairs, failed=True)

    def stop_reason(self, state: Iterate[Point]) -> str | None:
        """Return why to stop at this iterate, or None to go on."""
        if state.failed:
            return "line search failed"
        if state.gradient_norm <= self.tolerance * state.first_norm:
            return "converged"
        if self.precondition and state.gradient_norm**2 <= _RELATIVE_ROUNDING * abs(
            state.point.energy
        ):
            # the decrease that a step of H_0 promises is below the energy's own rounding
            return "converged"
        return None

    def _accept(
        self, state: Iterate[Point], trial: Trial[Point], direction: FloatArray
    ) -> Iterate[Point]:
        """Return the next iterate; a pair is kept only if the energy bends upwards along the step.

        A preconditioner is scaled by the root of the usual ``<s, y> / <y, H_0 y>``: the mismatch
        bends the energy far more than the norm that ``H_0`` inverts, but along few directions.
        Unscaled, every step is cut to 1e-5 of itself; with the full factor, directions not yet seen
        are starved, and thin parts converge slower.
        """
        gradient = trial.point.gradient
        preconditioned, norm = self._preconditioned(gradient)
        s, y = trial.length * direction, gradient - state.point.gradient
        change = preconditioned - state.preconditioned
        curvature = _inner(s, y)
        pairs, scale = state.pairs, state.scale
        spread = _inner(y, change)  # where little is left to gain, rounding may beat it
        if curvature > 1e-12 * np.sqrt(_inner(s, s) * _inner(y, y)) and spread > 0:
            pair = Pair(s.ravel(), y.ravel(), change.ravel(), 1 / curvature)
            pairs = (*pairs, pair)[-self.memory :]
            scale = curvature / spread
            scale = float(np.sqrt(scale)) if self.precondition else scale
        x, length = state.x + s, self.size(s)
        return Iterate(x, trial.point, preconditioned, pairs, scale, norm, state.first_norm, length)

    def _inverse_hessian(self, state: Iterate[Point]) -> FloatArray:
        """Apply the two-loop recursion, algorithm 7.4, with ``H_0`` summed from what is known."""
        if not state.pairs:
            return state.preconditioned
        q, found = state.point.gradient.flatten(), state.preconditioned.flatten()
        weights = [first_loop_update(pair, q, found) for pair in reversed(state.pairs)]
        found *= state.scale
        for pair, weight in zip(state.pairs, reversed(weights), strict=True):
            second_loop_update(pair, weight, found)
        return found.reshape(state.x.shape)

    def _preconditioned(self, gradient: FloatArray) -> tuple[FloatArray, float]:
        """Return ``H_0 g`` and ``sqrt(<g, H_0 g>)``: NaN, never small, where rounding makes the
        product negative.
        """
        found = self.precondition(gradient) if self.precondition else gradient
        square = _inner(gradient, found)
        return found, float(np.sqrt(square)) if square >= 0 else math.nan


@kernel
def first_loop_update(pair: Pair, q: FloatArray, found: FloatArray) -> float:
    """Take a pair out in the first loop: its change from ``q``, ``H_0`` of it from ``found``."""
    weight: float = pair.rho * inner(pair.s, q)
    for i in range(q.size):
        q[i] -= weight * pair.y[i]
        found[i] -= weight * pair.preconditioned[i]
    return weight


@kernel
def second_loop_update(pair: Pair, weight: float, found: FloatArray) -> None:
    """Add a pair's step, in the second loop."""
    share = weight - pair.rho * inner(pair.y, found)
    for i in range(found.size):
        found[i] += share * pair.s[i]


def _inner(a: FloatArray, b: FloatArray) -> float:
    return inner(a.ravel(), b.ravel())


def strong_wolfe(
    evaluate: Callable[[float], Point],
    slope_at: Callable[[Point], float],
    start: Trial[Point],
    first: float,
    length_max: float,
) -> Trial[Point] | None:
    """Find a step length with sufficient decrease and, below ``length_max``, a flatter slope.

    Algorithms 3.5 and 3.6, from ``start`` of length 0 and negative slope; ``first`` is tried first,
    and slopes are asked for only where the value is low enough. After twelve trials, the lowest
    with sufficient decrease will do; None if there is none. A value that is not finite counts as
    infinite: the step is shortened.
    """
    low, high = start, None
    length = min(first, length_max)
    for _ in range(TRIALS_MAX):
        point = evaluate(length)
        value, slope = point.energy, np.nan
        if value <= start.value + WOLFE_DECREASE * length * start.slope and value < low.value:
            slope = slope_at(point)
        trial = Trial(length, value, slope, point)
        if not np.isfinite(slope):
            high = trial
        elif abs(slope) <= -WOLFE_CURVATURE * start.slope or (slope < 0 and length >= length_max):
            return trial
        else:
            if slope * ((high.length if high else np.inf) - low.length) >= 0:
                high = low
            low = trial
        if high is None:
            length = min(length * 4, length_max)
        else:
            length = _interpolate(low, high)
            change = abs(high.length - low.length) * max(abs(low.slope), abs(start.slope))
            if change <= 1e-15 * abs(start.value):
                break
    return low if low.length > 0 else None


def _interpolate(low: Trial[Point], high: Trial[Point]) -> float:
    """Minimise the cubic or, without a slope at ``high``, the parabola, kept off the ends.

    A tenth of the way if ``high`` is infinite.
    """
    width, rise = high.length - low.length, high.value - low.value
    fraction = 0.5
    if not np.isfinite(rise):
        fraction = 0.1
    elif not np.isfinite(high.slope):
        above = rise - low.slope * width  # the tangent at low
        if above > 0:
            fraction = -0.5 * low.slope * width / above
    else:
        bend = low.slope + high.slope - 3 * rise / width
        under = bend**2 - low.slope * high.slope
        if under >= 0:
            root = np.sign(width) * np.sqrt(under)
            bottom = high.slope - low.slope + 2 * root
            if bottom != 0:
                fraction = 1 - (high.slope + root - bend) / bottom
    return low.length + width * float(np.clip(fraction, 0.1, 0.9))
