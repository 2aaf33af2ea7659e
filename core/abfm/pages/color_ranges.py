"""Ranges of values that colours show, without a few extreme values, and round numbers in them.

A range has all values of its functions, unless extremes stretch it to over 4 times the range from
2nd to 98th percentile (by area). Then ends far beyond these percentiles are clipped there. A narrow
Gaussian differs from its median only on a small part of the surface. The percentiles of such a
function are those of this part, so the range reaches the peak. Quantities such as distortion are
clipped if extremes stretch the range to over twice.
"""

import math
from collections.abc import Sequence
from itertools import repeat
from typing import Literal

import numpy as np

from abfm.pages.colormaps import ColorRange
from abfm.types import FloatArray

Quantity = Literal["function", "magnitude", "signed"]
"""What values are: a function; a magnitude, shown from 0; or signed, shown symmetric about 0."""
_PERCENTILES = 0.02, 0.98
# clipped ranges are so many times as long as that of the percentiles: of functions, and of others
_STRETCH_MIN = 4.0
_QUANTITY_STRETCH_MIN = 2.0
_EXCESS_MIN = 0.5  # excess of a clipped end, relative to the range of the percentiles
_DIFFERENCE_MIN = 0.1  # from the median, relative to the range of the percentiles
_PART_MAX = 1 / 8  # largest share of the area that is a small part of the surface
_NOISE = 1e-9  # differences that count as rounding errors, relative to the range of all values
_SAMPLES_MAX = 2_000_000  # values of which percentiles are computed
_ZERO_SHARE = 0.02  # smaller ends count as 0, relative to the largest value
_SIGNED_MIN = 0.05  # ratio of both ends of a function that counts as signed


def color_range(
    *functions: FloatArray,
    areas: FloatArray | Sequence[FloatArray] | None = None,
    quantity: Quantity = "function",
    end_min: float = 0.0,
    is_full: bool = False,
) -> ColorRange:
    """Return a colour map, and one range of values for all functions; see this module.

    Parameters
    ----------
    *functions : (N,) or (T, N) arrays
        Values at N vertices or faces, at T times. Values that are not finite are ignored. The range
        contains that of each function at each time.
    areas : (N,) array or sequence of them, optional
        Areas of the vertices or faces, for all functions or for each; by default equal.
    quantity : {"function", "magnitude", "signed"}
        The range of a function is symmetric about 0 if it has both signs, and starts at 0 if its
        minimum is almost 0.
    end_min : float
        Smallest end of the range of a magnitude or a signed quantity.
    is_full : bool
        Whether no value is clipped.
    """
    of_each = areas if isinstance(areas, list | tuple) else repeat(areas)
    stride = -(-sum(values.size for values in functions) // _SAMPLES_MAX) or 1
    found = [
        (float(known.min()), float(known.max()), *_percentiles(known, weights, stride))
        for values, area in zip(functions, of_each, strict=False)
        for row in np.atleast_2d(values)
        if (known := row[is_known := np.isfinite(row)]).size
        for weights in [np.ones(known.size) if area is None else area[is_known]]
    ] or [(0.0,) * 4]
    low, high, bottom, top = (
        end(column)
        for end, column in zip((min, max, min, max), zip(*found, strict=True), strict=True)
    )
    ends, length = (low, high), top - bottom
    stretch_min = _STRETCH_MIN if quantity == "function" else _QUANTITY_STRETCH_MIN
    if not is_full and high - low > stretch_min * length > 0:
        ends = (
            bottom if bottom - low > _EXCESS_MIN * length else low,
            top if high - top > _EXCESS_MIN * length else high,
        )
    return ColorRange(*_shown(*ends, quantity, end_min), low, high)


def _percentiles(values: FloatArray, areas: FloatArray, stride: int) -> tuple[float, float]:
    """Return the percentiles of values (N,) with areas (N,), or of their small varying part.

    The percentiles are those of one value in ``stride``.
    """
    values, areas = values[::stride], areas[::stride]
    low, median, high = _quantiles(values, areas, (_PERCENTILES[0], 0.5, _PERCENTILES[1]))
    slack = max(_DIFFERENCE_MIN * (high - low), _NOISE * float(np.ptp(values)))
    is_away = np.abs(values - median) > slack
    if is_away.any() and areas[is_away].sum() < _PART_MAX * areas.sum():
        low, high = _quantiles(values[is_away], areas[is_away], _PERCENTILES)
    return min(low, median), max(high, median)


def _quantiles(values: FloatArray, weights: FloatArray, shares: Sequence[float]) -> list[float]:
    order = np.argsort(values)
    below = np.cumsum(weights[order])
    places = np.searchsorted(below, np.array(shares) * below[-1])
    return [float(value) for value in values[order[np.minimum(places, len(order) - 1)]]]


def _shown(low: float, high: float, quantity: Quantity, end_min: float) -> tuple[str, float, float]:
    """Return the colour map of a range of values, and the range that it shows."""
    largest = max(-low, high)
    if quantity == "magnitude":
        return "abfm sequential", 0.0, max(high, end_min) or 1.0
    if quantity == "signed" or min(-low, high) > _SIGNED_MIN * largest:
        largest = max(abs(low), abs(high), end_min) or 1.0
        return "abfm diverging", -largest, largest
    if high - low <= 1e-12 * max(largest, 1e-300):
        # 0.5 is rounded away next to large numbers, but a colour bar needs a length
        margin = max(0.5, 1e-12 * largest)
        return "abfm sequential", low - margin, high + margin
    return "abfm sequential", 0.0 if abs(low) < _ZERO_SHARE * largest else low, high


def few_ticks(low: float, high: float) -> list[float]:
    """Return three or four round numbers between two values, or up to seven if they are narrow."""
    return next(found for count in (4, 5, 6, 7) if len(found := ticks(low, high, count)) > 2)


def ticks(low: float, high: float, count: int = 7) -> list[float]:
    """Return at most ``count`` round numbers between two values; at least three if it is 7."""
    rough = (high - low) / (count - 1)
    power = 10 ** math.floor(math.log10(rough))
    step = next(factor * power for factor in (1, 2, 2.5, 5, 10) if factor * power >= rough)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [step * k for k in range(first, last + 1)]
