"""Strong Wolfe line search [Nocedal & Wright 2006, algorithms 3.5 and 3.6] that survives non-finite values."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

DECREASE = 1e-4
CURVATURE = 0.9
_MOST_TRIALS = 12


class HasEnergy(Protocol):
    """What a line search needs to know of an evaluation."""

    @property
    def energy(self) -> float:
        """Value at the point."""


Point = TypeVar("Point", bound=HasEnergy)


@dataclass(frozen=True)
class Trial(Generic[Point]):
    """One step length tried: value and slope along the direction."""

    length: float
    value: float
    slope: float
    point: Point


def strong_wolfe(
    evaluate: Callable[[float], tuple[Point, float]], start: Trial[Point], first: float, longest: float
) -> Trial[Point] | None:
    """Find a step length with sufficient decrease and, unless it is ``longest``, a flatter slope.

    Parameters
    ----------
    evaluate : callable
        Step length to evaluation and slope along the direction.
    start : Trial
        The trial of length 0; its slope is negative.
    first, longest : float
        First and longest length to try.

    Returns
    -------
    The accepted trial. None if no length decreases the value. A value that is not finite counts as infinite: the step
    is shortened.
    """
    low, high = start, None
    length = min(first, longest)
    for _ in range(_MOST_TRIALS):
        point, slope = evaluate(length)
        value = point.energy if np.isfinite(point.energy) and np.isfinite(slope) else np.inf
        trial = Trial(length, value, slope, point)
        if value > start.value + DECREASE * length * start.slope or value >= low.value:
            high = trial
        elif abs(slope) <= -CURVATURE * start.slope or (slope < 0 and length >= longest):
            return trial
        else:
            if slope * ((high.length if high else np.inf) - low.length) >= 0:
                high = low
            low = trial
        if high is None:
            length = min(length * 4, longest)
        else:
            length = _interpolate(low, high)
            if abs(high.length - low.length) * max(abs(low.slope), abs(start.slope)) <= 1e-15 * abs(start.value):
                break
    return low if low.length > 0 else None


def _interpolate(low: Trial[Point], high: Trial[Point]) -> float:
    """Minimiser of the cubic through both trials, kept off the ends; a tenth of the way if ``high`` is infinite."""
    width = high.length - low.length
    if not np.isfinite(high.value):
        return low.length + 0.1 * width
    bend = low.slope + high.slope - 3 * (low.value - high.value) / (low.length - high.length)
    under = bend**2 - low.slope * high.slope
    fraction = 0.5
    if under >= 0:
        root = np.sign(width) * np.sqrt(under)
        bottom = high.slope - low.slope + 2 * root
        if bottom != 0:
            fraction = 1 - (high.slope + root - bend) / bottom
    return low.length + width * float(np.clip(fraction, 0.1, 0.9))
