"""Means and deviations over subjects, how alike they are, and what of them is position and what is
value.

Values are (V,) of each of N subjects at V vertices; shares (V,), not negative, say how much each
counts at each vertex: its weight, times its mask where that lies. What has no share is not looked
at, and may be unknown. Subjects are added up one by one, so values may be in a file.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from abfm.types import BoolArray, FloatArray, IntArray

Subjects: TypeAlias = Sequence[FloatArray] | FloatArray
"""An array (V,) for each of N subjects."""
_CONSTANT = 1e-9  # of a function's size: smaller deviations from its mean are rounding
_ROUNDING = 1e-14  # of squares: a variance that is less is none


class Phase(NamedTuple):
    """The variance over subjects per area, ``total = phase + amplitude``; NaN where unknown."""

    total: float
    phase: float
    amplitude: float
    factor: float  # C_R: how much larger squares are before than after


def mean(values: Subjects, shares: Subjects) -> FloatArray:
    """Return the mean over subjects, (V,); NaN where none counts."""
    return Others.of(values, shares).mean()


def deviation(values: Subjects, shares: Subjects) -> FloatArray:
    """Return the standard deviation over subjects, (V,); NaN where fewer than two count.

    The variance is unbiased for independent subjects of one variance, with any shares ``w``: its
    divisor is ``sum w - sum w^2 / sum w``, of equal ones ``w (n - 1)``.
    """
    found = Others.of(values, shares)
    middle, total = np.nan_to_num(found.mean()), found.total
    squares, spread = np.zeros_like(total), np.zeros_like(total)
    for own, share in zip(values, shares, strict=True):
        squares += share**2
        spread += share * (_counted(own, share) - middle) ** 2
    several = found.number > 1
    divisor = np.where(several, total - squares / np.where(several, total, 1), 0)
    return np.sqrt(_divided(spread, divisor))


class Shares(Sequence[FloatArray]):
    """How much each subject counts at each vertex: its weight times its mask, where its value is
    known, if values are given.
    """

    def __init__(
        self, weights: FloatArray, masks: Subjects, values: Subjects | None = None
    ) -> None:
        self._weights, self._masks, self._values = weights, masks, values

    def __len__(self) -> int:
        return len(self._weights)

    def __getitem__(self, subject: Any) -> Any:
        shares = self._weights[subject] * self._masks[subject]
        if self._values is None:
            return shares
        return np.where(np.isfinite(self._values[subject]), shares, 0)


class Others(NamedTuple):
    """What the means of all subjects but one are made of."""

    values: Subjects
    shares: Subjects
    sums: FloatArray  # (V,)
    total: FloatArray
    number: IntArray  # how many count at each vertex

    @classmethod
    def of(cls, values: Subjects, shares: Subjects) -> Others:
        sums, total = np.zeros_like(shares[0]), np.zeros_like(shares[0])
        number = np.zeros(len(total), dtype=np.int64)
        for own, share in zip(values, shares, strict=True):
            sums += share * _counted(own, share)
            total += share
            number += share > 0
        return cls(values, shares, sums, total, number)

    def mean(self) -> FloatArray:
        """Return the mean of all, (V,); NaN where none counts."""
        return _divided(self.sums, self.total)

    def without(self, subject: int) -> FloatArray:
        """Return the mean of all but this one, (V,); NaN where none of them counts."""
        own = self.shares[subject]
        left = np.where(self.number > (own > 0), self.total - own, 0)
        return _divided(self.sums - own * _counted(self.values[subject], own), left)


def correlation(f: FloatArray, g: FloatArray, areas: FloatArray) -> float:
    """Return how functions (V,) correlate where areas (V,) are above 0 and both are known; NaN
    where one is constant there.
    """
    known = _known(f, g, areas)
    if not known.any():
        return math.nan
    weights = areas[known]
    apart = [each[known] - np.average(each[known], weights=weights) for each in (f, g)]
    sizes = [math.sqrt(weights @ each**2) for each in apart]
    largest = [math.sqrt(weights @ each[known] ** 2) for each in (f, g)]
    if any(size <= _CONSTANT * most for size, most in zip(sizes, largest, strict=True)):
        return math.nan
    return float(np.clip(weights @ (apart[0] * apart[1]) / (sizes[0] * sizes[1]), -1, 1))


def relative_distance(f: FloatArray, g: FloatArray, areas: FloatArray) -> float:
    """Return ``||f - g||`` over the deviation of ``g`` from its mean, in L2 where areas (V,) are
    above 0 and both are known; NaN where ``g`` is constant there.
    """
    known = _known(f, g, areas)
    if not known.any():
        return math.nan
    weights, own = areas[known], g[known]
    size = math.sqrt(weights @ (own - np.average(own, weights=weights)) ** 2)
    if size <= _CONSTANT * math.sqrt(weights @ own**2):
        return math.nan
    return math.sqrt(weights @ (f[known] - own) ** 2) / size


@dataclass
class Moments:
    """Sums over subjects at P points, which subjects are added to one by one."""

    shares: FloatArray  # (P,)
    first: FloatArray
    second: FloatArray

    @classmethod
    def at(cls, count: int) -> Moments:
        """Return those of nobody."""
        return cls(*(np.zeros(count) for _ in range(3)))

    def add(self, values: FloatArray, shares: FloatArray) -> None:
        """Add a subject's values (P,), each with its share (P,)."""
        counted = np.where(shares > 0, values, 0)
        self.shares += shares
        self.first += shares * counted
        self.second += shares * counted**2

    def integrals(self, weights: FloatArray) -> tuple[float, float]:
        """Return the integrals of the mean of squares, and of the square of the mean."""
        divisor = np.where(self.shares > 0, self.shares, 1)
        means, squares = self.first / divisor, self.second / divisor
        return float(weights @ squares), float(weights @ means**2)


def phase_and_amplitude(before: Moments, after: Moments, areas: FloatArray) -> Phase:
    """Part the variance into what aligning removes, position, and what it leaves, value.

    With functions ``x_i`` before and ``y_i`` after, means over subjects, and integrals per area
    over where any count both before and after [Kneip and Ramsay, JASA 2008]::

        C_R       = mean_i int x_i^2 / mean_i int y_i^2
        total     = mean_i int x_i^2 - int (mean_i x_i)^2
        amplitude = C_R (mean_i int y_i^2 - int (mean_i y_i)^2)
        phase     = C_R int (mean_i y_i)^2 - int (mean_i x_i)^2

    so that ``total = phase + amplitude``. A constant that is added to all functions changes the
    parts a little, by ``C_R``: it is best taken off first, such as the mean over the surface.

    Parameters
    ----------
    before, after : Moments
        Both at the same points, at which subjects should be interpolated alike before and after:
        interpolation smooths noise, which would pass for position where only one of them is.
    areas : (P,) array
        What each point stands for.
    """
    weights = np.where((before.shares > 0) & (after.shares > 0), areas, 0)
    if not weights.any():
        return Phase(*[math.nan] * len(Phase._fields))
    weights = weights / weights.sum()
    (squares_x, mean_x), (squares_y, mean_y) = (each.integrals(weights) for each in (before, after))
    if squares_x - mean_x <= _ROUNDING * squares_x:
        return Phase(0.0, 0.0, 0.0, 1.0)
    factor = squares_x / squares_y if squares_y > 0 else 1.0
    return Phase(
        squares_x - mean_x, factor * mean_y - mean_x, factor * (squares_y - mean_y), factor
    )


def _known(f: FloatArray, g: FloatArray, areas: FloatArray) -> BoolArray:
    return np.asarray((areas > 0) & np.isfinite(f) & np.isfinite(g))


def _counted(values: FloatArray, shares: FloatArray) -> FloatArray:
    return np.where(shares > 0, values, 0)


def _divided(sums: FloatArray, by: FloatArray) -> FloatArray:
    """Return sums over divisors, NaN where these are 0."""
    return np.divide(sums, by, out=np.full_like(sums, np.nan), where=by > 0)
