"""Preconditioned L-BFGS [Nocedal & Wright 2006, ch. 7] as an iterator: init, step, stop test.

SciPy's has no preconditioner, and cannot stop between two iterations or learn from an earlier run.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, NamedTuple, Protocol, TypeVar

import numpy as np

from abfm.numerics.kernels import inner, kernel
from abfm.numerics.line_search import HasEnergy, Trial, strong_wolfe
from abfm.types import FloatArray

_ROUNDING = 1e-16


class HasGradient(HasEnergy, Protocol):
    """What the optimiser needs to know of an evaluation."""

    @property
    def gradient(self) -> FloatArray:
        """Derivative at the point."""


Point = TypeVar("Point", bound=HasGradient)


class Pair(NamedTuple):
    """A step ``s``, the change ``y`` of gradient along it, ``H_0 y``, and ``1 / <s, y>``; arrays
    are flat.
    """

    s: FloatArray
    y: FloatArray
    preconditioned: FloatArray
    rho: float


@dataclass(frozen=True)
class State(Generic[Point]):
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
    longest: float = np.inf  # the most that the size of a step may be
    tolerance: float = 1e-6  # converged when the gradient's norm is this fraction of the first one

    def init(
        self,
        x: FloatArray,
        point: Point | None = None,
        before: State[Point] | None = None,
        steeper: float = 1.0,
    ) -> State[Point]:
        """Return the first iterate, with its evaluation if there is one already.

        What a search ``before`` has learned serves this one, whose energy bends about ``steeper``
        times as much.
        """
        point = self.evaluate(x) if point is None else point
        preconditioned = self._precondition(point.gradient)
        norm = _norm(point.gradient, preconditioned)
        if before is None:
            return State(x, point, preconditioned, (), 1.0, norm, norm)
        pairs = tuple(
            Pair(s, steeper * y, steeper * hy, rho / steeper) for s, y, hy, rho in before.pairs
        )
        return State(
            x, point, preconditioned, pairs, before.scale / steeper, norm, norm, before.length
        )

    def step(self, state: State[Point]) -> State[Point]:
        """Do one iteration; where the search fails along the quasi-Newton direction, again without
        the memory.
        """
        direction = -self._inverse_hessian(state)
        slope = _inner(direction, state.point.gradient)
        if not slope < 0:
            return self._without_memory(state)
        full = self.size(direction)
        longest = self.longest / full if full > 0 else 1.0
        first = 1.0
        if self.precondition and state.pairs:
            first = min(1.0, 2 * state.length / full)
        elif not state.pairs and not self.precondition:
            # of length 1, whatever frames the unknowns are in
            first = min(1.0, 1.0 / float(np.sqrt(-slope)))
        origin = Trial(0.0, state.point.energy, slope, state.point)
        trial = strong_wolfe(
            lambda length: self.evaluate(state.x + length * direction),
            lambda point: _inner(direction, point.gradient),
            origin,
            first,
            longest,
        )
        return self._accept(state, trial, direction) if trial else self._without_memory(state)

    def stop_reason(self, state: State[Point]) -> str | None:
        """Return why to stop at this iterate, or None to go on."""
        if state.failed:
            return "line search failed"
        if state.gradient_norm <= self.tolerance * state.first_norm:
            return "converged"
        if self.precondition and state.gradient_norm**2 <= _ROUNDING * abs(state.point.energy):
            # the decrease that a step of H_0 promises is below the energy's own rounding
            return "converged"
        return None

    def _without_memory(self, state: State[Point]) -> State[Point]:
        forgetful = replace(state, pairs=(), scale=1.0)
        return self.step(forgetful) if state.pairs else replace(forgetful, failed=True)

    def _accept(
        self, state: State[Point], trial: Trial[Point], direction: FloatArray
    ) -> State[Point]:
        """Return the next iterate; the pair is kept only if the energy bends upwards along the
        step.

        A preconditioner is scaled by the root of the usual ``<s, y> / <y, H_0 y>``. The mismatch
        bends the energy far more than the norm that ``H_0`` inverts, but only along few directions:
        unscaled, every step is cut to 1e-5 of itself in the search; with the full factor,
        directions not yet seen are starved, and thin parts converge slower.
        """
        gradient = trial.point.gradient
        preconditioned = self._precondition(gradient)
        s, y = trial.length * direction, gradient - state.point.gradient
        change = preconditioned - state.preconditioned
        curvature = _inner(s, y)
        pairs, scale = state.pairs, state.scale
        spread = _inner(y, change)  # where little is left to gain, rounding may beat it
        if curvature > 1e-12 * np.sqrt(_inner(s, s) * _inner(y, y)) and spread > 0:
            pairs = (*pairs, Pair(s.ravel(), y.ravel(), change.ravel(), 1 / curvature))[
                -self.memory :
            ]
            scale = curvature / spread
            scale = float(np.sqrt(scale)) if self.precondition else scale
        return State(
            state.x + s,
            trial.point,
            preconditioned,
            pairs,
            scale,
            _norm(gradient, preconditioned),
            state.first_norm,
            self.size(s),
        )

    def _inverse_hessian(self, state: State[Point]) -> FloatArray:
        """Apply the two-loop recursion, algorithm 7.4; ``H_0`` of what the first loop leaves is
        summed from what is known.
        """
        if not state.pairs:
            return state.preconditioned
        q, found = state.point.gradient.flatten(), state.preconditioned.flatten()
        weights = [take(pair, q, found) for pair in reversed(state.pairs)]
        found *= state.scale
        for pair, weight in zip(state.pairs, reversed(weights), strict=True):
            give(pair, weight, found)
        return found.reshape(state.x.shape)

    def _precondition(self, gradient: FloatArray) -> FloatArray:
        return self.precondition(gradient) if self.precondition else gradient


@kernel
def take(pair: Pair, q: FloatArray, found: FloatArray) -> float:
    """Take a pair out in the first loop and return its weight; its change of gradient is taken from
    ``q``, and ``H_0`` of it from ``found``.
    """
    weight: float = pair.rho * inner(pair.s, q)
    for i in range(q.size):
        q[i] -= weight * pair.y[i]
        found[i] -= weight * pair.preconditioned[i]
    return weight


@kernel
def give(pair: Pair, weight: float, found: FloatArray) -> None:
    """Add a pair's step, in the second loop."""
    share = weight - pair.rho * inner(pair.y, found)
    for i in range(found.size):
        found[i] += share * pair.s[i]


def _norm(gradient: FloatArray, preconditioned: FloatArray) -> float:
    """Return ``sqrt(<g, H_0 g>)``: NaN, which is never small, where rounding makes it negative."""
    square = _inner(gradient, preconditioned)
    return float(np.sqrt(square)) if square >= 0 else math.nan


def _inner(a: FloatArray, b: FloatArray) -> float:
    return inner(a.ravel(), b.ravel())
