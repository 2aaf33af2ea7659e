"""Round numbers for the ticks of axes."""

import math
from collections.abc import Sequence

import numpy as np

_MANTISSAS = ((1,), (1, 3), (1, 2, 5), (1, 2, 3, 5), (1, 1.5, 2, 3, 4, 5, 6, 8))
_TICKS_MIN = 3
_TICKS_MAX = 6


def share_ticks(low: float, high: float) -> list[float]:
    """Return round fractions from ``low`` to ``high`` for ticks, at least three if possible."""
    ticks: list[float] = []
    for mantissas in _MANTISSAS:
        decades = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
        places = (float(f"{m}e{decade}") for decade in decades for m in mantissas)
        ticks = [place for place in places if low <= place <= high]
        if len(ticks) >= _TICKS_MIN:
            break
    return ticks


def factor_ticks(low: float, high: float) -> tuple[list[float], list[str]]:
    """Return ticks from ``low`` to ``high``, the base-2 logarithms of round factors, and labels."""
    first, last = 2**low, 2**high
    if last < 2 * first:
        steps = (m * 10.0**decade for decade in range(-9, 30) for m in (1, 2, 5))
        step = next(each for each in steps if last - first < _TICKS_MAX * each)
        numbers = range(math.ceil(round(first / step, 6)), math.floor(last / step) + 1)
        factors = [number * step for number in numbers]
    else:
        factors, room = [], (last / first) ** (1 / _TICKS_MAX)
        for factor in (m * 10.0**decade for decade in range(30) for m in (1, 1.5, 2, 3, 5)):
            if first <= factor <= last and (not factors or factor >= room * factors[-1]):
                factors.append(factor)
    return [math.log2(factor) for factor in factors], [f"×{factor:.6g}" for factor in factors]


def readable_ticks(places: Sequence[float], widths: Sequence[float]) -> list[int]:
    """Return the numbers of the ticks, at ascending places, whose labels do not overlap."""
    chosen: list[int] = []
    for number, (place, width) in enumerate(zip(places, widths, strict=True)):
        last = chosen[-1] if chosen else None
        if last is None or place - places[last] >= (width + widths[last]) / 2:
            chosen.append(number)
    return chosen
