"""Statistics over subjects: means, standard deviations, similarity, phase and amplitude.

Values are (V,) for each of N subjects at V vertices. The share of a subject, (V,), is its
nonnegative weight at each vertex: its weight in the population times its mask. Values with share 0
are ignored and may be unknown. Subjects are summed one at a time, so the values may be mapped from
a file.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from abfm.types import BoolArray, FloatArray, IntArray

Subjects: TypeAlias = Sequence[FloatArray] | FloatArray  # one array (V,) for each of N subjects
_CONSTANT_DEVIATION_MAX = 1e-9  # functions that vary less, relative to their norm, are constant
_VARIANCE_ROUNDING = 1e-14  # a smaller variance, relative to the mean square, is a rounding error


class Phase(NamedTuple):
    """Parts of the variance over subjects, per area; ``total = phase + amplitude``, or NaN."""

    total: float
    phase: float  # part by variation of position
    amplitude: float  # part by variation of value
    factor: float  # C_R: ratio of mean squares before and after registration


def mean(values: Subjects, shares: Subjects) -> FloatArray:
    """Return the mean over subjects, weighted by shares, (V,); NaN where all shares are 0."""
    return LeaveOneOut.of(values, shares).mean()


def deviation(values: Subjects, shares: Subjects) -> FloatArray:
    """Return the standard deviation over subjects, (V,); NaN where fewer than two have a share.

    For independent subjects of equal variance the estimate of the variance is unbiased for any
    shares ``w``. Its divisor is ``sum w - sum w^2 / sum w``, which is ``w (n - 1)`` for equal
    shares.
    """
    found = LeaveOneOut.of(values, shares)
    middle, total = np.nan_to_num(found.mean()), found.total
    squares, spread = np.zeros_like(total), np.zeros_like(total)
    for subject, share in zip(values, shares, strict=True):
        squares += share**2
        spread += share * (_known_values(subject, share) - middle) ** 2
    has_several = found.number > 1
    divisor = np.where(has_several, total - squares / np.where(has_several, total, 1), 0)
    return np.sqrt(_divide(spread, divisor))


class Shares(Sequence[FloatArray]):
    """Sequence of the share of each subject, (V,): its weight times its mask.

    With ``values``, the share is 0 where the value of the subject is not finite.
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


class LeaveOneOut(NamedTuple):
    """Sums over all subjects, from which means without one subject are computed."""

    values: Subjects
    shares: Subjects
    sums: FloatArray  # (V,), sum of shares times values
    total: FloatArray  # (V,), sum of shares
    number: IntArray  # subjects with a share at each vertex

    @classmethod
    def of(cls, values: Subjects, shares: Subjects) -> LeaveOneOut:
        sums, total = np.zeros_like(shares[0]), np.zeros_like(shares[0])
        number = np.zeros(len(total), dtype=np.int64)
        for subject, share in zip(values, shares, strict=True):
            sums += share * _known_values(subject, share)
            total += share
            number += share > 0
        return cls(values, shares, sums, total, number)

    def mean(self) -> FloatArray:
        """Return the mean over all subjects, (V,); NaN where all shares are 0."""
        return _divide(self.sums, self.total)

    def without(self, subject: int) -> FloatArray:
        """Return the mean over all other subjects, (V,); NaN where all their shares are 0."""
        share = self.shares[subject]
        remaining = np.where(self.number > (share > 0), self.total - share, 0)
        return _divide(self.sums - share * _known_values(self.values[subject], share), remaining)


def correlation(f: FloatArray, g: FloatArray, areas: FloatArray) -> float:
    """Return the area-weighted correlation of two functions (V,); NaN if one is constant.

    Only vertices with positive areas (V,) and known values of both functions count.
    """
    known = _known(f, g, areas)
    if not known.any():
        return math.nan
    weights = areas[known]
    centred = [each[known] - np.average(each[known], weights=weights) for each in (f, g)]
    sizes = [math.sqrt(weights @ each**2) for each in centred]
    norms = [math.sqrt(weights @ each[known] ** 2) for each in (f, g)]
    if any(size <= _CONSTANT_DEVIATION_MAX * norm for size, norm in zip(sizes, norms, strict=True)):
        return math.nan
    return float(np.clip(weights @ (centred[0] * centred[1]) / (sizes[0] * sizes[1]), -1, 1))


def relative_distance(f: FloatArray, g: FloatArray, areas: FloatArray) -> float:
    """Return ``||f - g||`` in L2, divided by the L2 norm of ``g`` minus its mean.

    Only vertices with positive areas (V,) and known values count. NaN if ``g`` is constant.
    """
    known = _known(f, g, areas)
    if not known.any():
        return math.nan
    weights, reference = areas[known], g[known]
    size = math.sqrt(weights @ (reference - np.average(reference, weights=weights)) ** 2)
    if size <= _CONSTANT_DEVIATION_MAX * math.sqrt(weights @ reference**2):
        return math.nan
    return math.sqrt(weights @ (f[known] - reference) ** 2) / size


@dataclass
class Moments:
    """Sums of shares, values and squared values over subjects, at P points."""

    shares: FloatArray  # (P,)
    first: FloatArray  # (P,), sum of shares times values
    second: FloatArray  # (P,), sum of shares times squared values

    @classmethod
    def at(cls, count: int) -> Moments:
        """Return the sums before a subject is added: 0 at ``count`` points."""
        return cls(*(np.zeros(count) for _ in range(3)))

    def add(self, values: FloatArray, shares: FloatArray) -> None:
        """Add the values (P,) of a subject with its shares (P,)."""
        counted = np.where(shares > 0, values, 0)
        self.shares += shares
        self.first += shares * counted
        self.second += shares * counted**2

    def integrals(self, weights: FloatArray) -> tuple[float, float]:
        """Return the integrals of the mean square and of the squared mean over subjects.

        ``weights`` (P,) are the areas of the points.
        """
        divisor = np.where(self.shares > 0, self.shares, 1)
        means, squares = self.first / divisor, self.second / divisor
        return float(weights @ squares), float(weights @ means**2)


def phase_and_amplitude(before: Moments, after: Moments, areas: FloatArray) -> Phase:
    """Split the variance into phase (position), removed by alignment, and amplitude (value).

    The functions are ``x_i`` before and ``y_i`` after alignment. Means are over subjects, and
    integrals are per area, over points with shares both before and after. Then [Kneip and Ramsay,
    JASA 2008]::

        C_R       = mean_i int x_i^2 / mean_i int y_i^2
        total     = mean_i int x_i^2 - int (mean_i x_i)^2
        amplitude = C_R (mean_i int y_i^2 - int (mean_i y_i)^2)
        phase     = C_R int (mean_i y_i)^2 - int (mean_i x_i)^2

    so that ``total = phase + amplitude``. Adding a constant to all functions changes the parts
    slightly through ``C_R``. Subtract such a constant first, for example the mean over the surface.

    Parameters
    ----------
    before, after : Moments
        Sums before and after alignment, at the same points. Interpolate the subjects in the same
        way before and after: interpolation smooths noise, and the difference would count as phase.
    areas : (P,) array
        Area that each point represents.
    """
    weights = np.where((before.shares > 0) & (after.shares > 0), areas, 0)
    if not weights.any():
        return Phase(*[math.nan] * len(Phase._fields))
    weights = weights / weights.sum()
    (squares_x, mean_x), (squares_y, mean_y) = (each.integrals(weights) for each in (before, after))
    if squares_x - mean_x <= _VARIANCE_ROUNDING * squares_x:
        return Phase(0.0, 0.0, 0.0, 1.0)
    factor = squares_x / squares_y if squares_y > 0 else 1.0
    phase, amplitude = factor * mean_y - mean_x, factor * (squares_y - mean_y)
    return Phase(squares_x - mean_x, phase, amplitude, factor)


def _known(f: FloatArray, g: FloatArray, areas: FloatArray) -> BoolArray:
    return np.asarray((areas > 0) & np.isfinite(f) & np.isfinite(g))


def _known_values(values: FloatArray, shares: FloatArray) -> FloatArray:
    return np.where(shares > 0, values, 0)


def _divide(sums: FloatArray, by: FloatArray) -> FloatArray:
    return np.divide(sums, by, out=np.full_like(sums, np.nan), where=by > 0)
