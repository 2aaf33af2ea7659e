"""Preconditioned L-BFGS [Nocedal & Wright 2006, ch. 7] as an iterator.

`LBFGS` has the methods ``init``, ``step`` and ``stop_reason``. SciPy's L-BFGS has no
preconditioner. It cannot stop between two iterations or reuse the pairs (steps and gradient
changes) of an earlier run. Its line search fails for energies that are not finite. It also
evaluates slopes at step lengths that are rejected by their value alone.
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
    """Energy and gradient at a point, which may be computed on access."""

    @property
    def energy(self) -> float: ...
    @property
    def gradient(self) -> FloatArray: ...


Point = TypeVar("Point", bound=Evaluation)


class Pair(NamedTuple):
    """A step ``s``, its gradient change ``y``, ``H_0 y``, and ``1 / <s, y>``, as flat arrays."""

    s: FloatArray
    y: FloatArray
    preconditioned: FloatArray
    rho: float


@dataclass(frozen=True)
class Trial(Generic[Point]):
    """A step length that a line search has tried, with the energy and its slope there.

    The slope is NaN if the energy is too high, as it is then not computed.
    """

    length: float
    value: float
    slope: float
    point: Point


@dataclass(frozen=True)
class Iterate(Generic[Point]):
    """One iterate of L-BFGS."""

    x: FloatArray  # never has a higher energy than the one before
    point: Point  # evaluation at x with gradient g
    preconditioned: FloatArray  # gradient preconditioned as H_0 g
    pairs: tuple[Pair, ...]  # the latest pairs, oldest first
    scale: float  # factor of H_0 in the next direction
    gradient_norm: float  # sqrt(<g, H_0 g>), the dual norm of the preconditioner
    first_norm: float  # gradient norm at the first iterate
    # size of the latest step; the next search begins with at most twice this size
    length: float = 0.0
    failed: bool = False  # the line search found no lower energy, so x is unchanged


@dataclass(frozen=True, eq=False)
class LBFGS(Generic[Point]):
    """Minimisation of an energy by L-BFGS with a strong Wolfe line search.

    ``evaluate`` returns the `Evaluation` at an array; its energy may be infinite. Its gradient is
    accessed only if it is needed, and for the first time before the next call of ``evaluate``.
    ``precondition`` applies ``H_0``, a symmetric positive definite approximation of the inverse
    Hessian. Without it ``H_0`` is the usual multiple of the identity, ``<s, y> / <y, y>``.
    """

    evaluate: Callable[[FloatArray], Point]
    precondition: Callable[[FloatArray], FloatArray] | None = None
    memory: int = 10  # number of stored pairs
    # returns the size of a step, in the unit of `step_size_max`
    size: Callable[[FloatArray], float] = lambda step: float(np.abs(step).max())
    step_size_max: float = np.inf
    tolerance: float = 1e-6  # converged if the gradient norm falls to this share of the first one

    def init(
        self,
        x: FloatArray,
        point: Point | None = None,
        previous: Iterate[Point] | None = None,
        curvature_ratio: float = 1.0,
    ) -> Iterate[Point]:
        """Return the first iterate at ``x``; ``point`` is the evaluation there, if it is known.

        The minimisation reuses the pairs of a ``previous`` one. The curvature of its energy is
        about ``curvature_ratio`` times that of the previous energy.
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
        """Do one iteration; if the line search fails, do it without the stored pairs."""
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
                # a step of length 1, independent of the frames of the unknowns
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
        if state.failed:
            return "line search failed"
        if state.gradient_norm <= self.tolerance * state.first_norm:
            return "converged"
        if self.precondition and state.gradient_norm**2 <= _RELATIVE_ROUNDING * abs(
            state.point.energy
        ):
            # the decrease predicted for a step of H_0 is below the rounding error of the energy
            return "converged"
        return None

    def _accept(
        self, state: Iterate[Point], trial: Trial[Point], direction: FloatArray
    ) -> Iterate[Point]:
        """Return the next iterate; store a pair only if the curvature along the step is positive.

        A preconditioner is scaled by the square root of the usual ``<s, y> / <y, H_0 y>``. The
        mismatch term of the energy has a far larger curvature than the norm that ``H_0`` inverts,
        but along few directions. Without scaling, every step is cut to 1e-5 of its length. With the
        full factor instead of its root, directions without pairs get too small steps, and thin
        parts of the surface converge more slowly.
        """
        gradient = trial.point.gradient
        preconditioned, norm = self._preconditioned(gradient)
        s, y = trial.length * direction, gradient - state.point.gradient
        change = preconditioned - state.preconditioned
        curvature = _inner(s, y)
        pairs, scale = state.pairs, state.scale
        spread = _inner(y, change)  # rounding may make it negative close to the minimum
        if curvature > 1e-12 * np.sqrt(_inner(s, s) * _inner(y, y)) and spread > 0:
            pair = Pair(s.ravel(), y.ravel(), change.ravel(), 1 / curvature)
            pairs = (*pairs, pair)[-self.memory :]
            scale = curvature / spread
            scale = float(np.sqrt(scale)) if self.precondition else scale
        x, length = state.x + s, self.size(s)
        return Iterate(x, trial.point, preconditioned, pairs, scale, norm, state.first_norm, length)

    def _inverse_hessian(self, state: Iterate[Point]) -> FloatArray:
        """Return the product of the approximate inverse Hessian and the gradient.

        The two-loop recursion (algorithm 7.4) applies ``H_0`` to sums of vectors for which ``H_0``
        times the vector is already known.
        """
        if not state.pairs:
            return state.preconditioned
        q, found = state.point.gradient.flatten(), state.preconditioned.flatten()
        weights = [first_loop_update(pair, q, found) for pair in reversed(state.pairs)]
        found *= state.scale
        for pair, weight in zip(state.pairs, reversed(weights), strict=True):
            second_loop_update(pair, weight, found)
        return found.reshape(state.x.shape)

    def _preconditioned(self, gradient: FloatArray) -> tuple[FloatArray, float]:
        """Return ``H_0 g`` and the norm ``sqrt(<g, H_0 g>)`` of a gradient g.

        The norm is NaN if the product is negative by rounding.
        """
        found = self.precondition(gradient) if self.precondition else gradient
        square = _inner(gradient, found)
        return found, float(np.sqrt(square)) if square >= 0 else math.nan


@kernel
def first_loop_update(pair: Pair, q: FloatArray, found: FloatArray) -> float:
    """Apply a pair to ``q`` and ``found = H_0 q`` in the two-loop recursion; return its weight."""
    weight: float = pair.rho * inner(pair.s, q)
    for i in range(q.size):
        q[i] -= weight * pair.y[i]
        found[i] -= weight * pair.preconditioned[i]
    return weight


@kernel
def second_loop_update(pair: Pair, weight: float, found: FloatArray) -> None:
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
    """Find a step length with sufficient decrease and a flatter slope (strong Wolfe conditions).

    At ``length_max``, a step length whose slope is still negative is also accepted. The search
    follows algorithms 3.5 and 3.6 from ``start``, of length 0 and negative slope. It begins with
    the step length ``first``, and computes slopes only where the value is low enough. After twelve
    trials it returns the lowest trial with sufficient decrease, or None if there is none. A value
    that is not finite counts as infinite, so the step is shortened.
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
    """Return the step length at the minimum of a polynomial through two trials.

    The polynomial is a cubic, or a parabola if the slope of ``high`` is unknown. The result is at
    least a tenth of the interval away from both ends. It is a tenth away from ``low`` if the value
    of ``high`` is infinite.
    """
    width, rise = high.length - low.length, high.value - low.value
    fraction = 0.5
    if not np.isfinite(rise):
        fraction = 0.1
    elif not np.isfinite(high.slope):
        above = rise - low.slope * width  # rise above the tangent at the lower end
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
