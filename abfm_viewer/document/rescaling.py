"""Scaling of a function to the range of another one, and smoothing."""

import math
from dataclasses import replace

import numpy as np

from abfm import functions
from abfm.types import FloatArray

_RANGE_TOLERANCE = 1e-3  # fraction of the target's range; smaller differences are ignored
_DIGITS = 6  # of a factor or offset, relative to the range


def rescaled(spec: str, values: FloatArray, other: FloatArray) -> str:
    """Return the spec (text) of a function, scaled and shifted to the range of another one.

    ``values`` (V,) and ``other`` (W,) are values of the two functions. The spec stays the same if
    the ranges agree already, or if one of the functions is constant.
    """
    (low, high), (least, most) = ((float(f.min()), float(f.max())) for f in (values, other))
    if not (high > low and most > least):
        return spec
    slack = _RANGE_TOLERANCE * (most - least)
    if np.allclose((low, high), (least, most), rtol=0, atol=slack):
        return spec
    factor = (most - least) / (high - low)
    factor = _rounded(factor, factor * (high - low) / max(abs(low), abs(high)))
    offset = _rounded(least - factor * low, most - least)
    found = functions.scaled(functions.parse(spec), factor, offset)
    factor, offset = (float(f"{number:.12g}") for number in (found.factor, found.offset))
    return str(replace(found, factor=factor, offset=offset))


def _rounded(number: float, size: float) -> float:
    """Round a number so that the error is at most a millionth of ``size``."""
    return round(number, _DIGITS - math.floor(math.log10(size)))


def smoothed(spec: str, length: float) -> str:
    """Return the spec of a function, smoothed over a length in sqrt(area); combine smoothings."""
    tree = functions.parse(spec)
    if isinstance(tree, functions.Smoothed):
        length, tree = math.hypot(length, tree.length), tree.function
    return str(functions.Smoothed(length=float(f"{length:.4g}"), function=tree))
