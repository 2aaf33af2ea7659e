"""Strong Wolfe line search [Nocedal & Wright 2006, algorithms 3.5 and 3.6].

SciPy's does not survive energies that are not finite, and asks for slopes where the value alone
rules a step out.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

DECREASE = 1e-4
CURVATURE = 0.9
MOST_TRIALS = 12


class HasEnergy(Protocol):
    """What a line search needs to know of an evaluation."""

    @property
    def energy(self) -> float:
        """Value at the point."""


Point = TypeVar("Point", bound=HasEnergy)


@dataclass(frozen=True)
class Trial(Generic[Point]):
    """One step length tried: value, and slope along the direction (NaN where the value alone
    rules it out).
    """

    length: float
    value: float
    slope: float
    point: Point


def strong_wolfe(
    evaluate: Callable[[float], Point],
    slope_at: Callable[[Point], float],
    start: Trial[Point],
    first: float,
    longest: float,
) -> Trial[Point] | None:
    """Find a step length with sufficient decrease and, unless it is ``longest``, a flatter slope.

    Parameters
    ----------
    evaluate : callable
        Step length to evaluation.
    slope_at : callable
        Evaluation to slope along the direction: asked for only where the value is low enough.
    start : Trial
        The trial of length 0; its slope is negative.
    first, longest : float
        First and longest length to try.

    Returns
    -------
    The accepted trial; after twelve, the lowest with sufficient decrease. None if no length
    decreases the value. A value that is not finite counts as infinite: the step is shortened.
    """
    low, high = start, None
    length = min(first, longest)
    for _ in range(MOST_TRIALS):
        point = evaluate(length)
        value, slope = point.energy, np.nan
        if value <= start.value + DECREASE * length * start.slope and value < low.value:
            slope = slope_at(point)
        trial = Trial(length, value, slope, point)
        if not np.isfinite(slope):
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
            if abs(high.length - low.length) * max(abs(low.slope), abs(start.slope)) <= 1e-15 * abs(
                start.value
            ):
                break
    return low if low.length > 0 else None


def _interpolate(low: Trial[Point], high: Trial[Point]) -> float:
    """Minimise the cubic or, without a slope at ``high``, the parabola through both trials, kept
    off the ends.

    A tenth of the way if ``high`` is infinite.
    """
    width = high.length - low.length
    rise = high.value - low.value
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
