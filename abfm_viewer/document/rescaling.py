"""Scaling of a source function to the range of its target."""

from dataclasses import replace

import numpy as np

from abfm import functions
from abfm.types import FloatArray

_RANGE_TOLERANCE = 1e-3  # fraction of the target's range; smaller differences are ignored


def rescaled(spec: str, source: FloatArray, target: FloatArray) -> str:
    """Return the spec (text) of a source, scaled and shifted so that its range is the target's.

    ``source`` (V,) and ``target`` (W,) are values of the two functions. The spec stays the same if
    the ranges agree already, or if one of the functions is constant.
    """
    (low, high), (least, most) = ((float(f.min()), float(f.max())) for f in (source, target))
    if not (high > low and most > least):
        return spec
    slack = _RANGE_TOLERANCE * (most - least)
    if np.allclose((low, high), (least, most), rtol=0, atol=slack):
        return spec
    factor = (most - least) / (high - low)
    found = functions.scaled(functions.parse(spec), factor, least - factor * low)
    factor, offset = (float(f"{number:.12g}") for number in (found.factor, found.offset))
    return str(replace(found, factor=factor, offset=offset))
