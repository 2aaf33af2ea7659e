"""Functions between two frames: the linear blend, and motion along the field."""

from __future__ import annotations

import abfm.flow
from abfm.types import FloatArray


def interpolate(
    flow: abfm.flow.Flow, before: FloatArray, after: FloatArray, shares: FloatArray, motion: float
) -> FloatArray:
    """Return the function at fractions ``shares`` (T,) of an interval, (T, V) or (T, V, C).

    The frames ``before`` and ``after``, (V,) or (V, C), are advected along the flow of the interval
    to each time. They are then blended in proportion to their distance in time. ``motion``
    interpolates between the linear blend of the frames (0) and this blend of advected frames (1).
    """
    weights = shares.reshape(-1, *[1] * before.ndim)
    blend = (1 - weights) * before + weights * after
    if motion == 0:
        return blend
    tau = flow.tau
    ahead, back = flow.push(before, shares * tau), flow.push(after, (shares - 1) * tau)
    moved = (1 - weights) * ahead + weights * back
    return moved if motion == 1 else blend + motion * (moved - blend)
