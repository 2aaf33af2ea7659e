"""Who does not fit: subjects that are unlike all others, far beyond how much these differ."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from abfm.matching.judging.verdict import FOLDED_SHARE_MAX
from abfm.population.statistics import Others, Shares, correlation, relative_distance
from abfm.types import BoolArray, FloatArray

SUBJECTS_MIN = 5
"""Subjects that tell what is usual; of fewer none is left out for being unlike the others."""
ROBUST_Z = 3.5
"""Deviations from the median beyond which one is an outlier [Iglewicz and Hoaglin 1993]."""
_NORMAL = 1.4826  # times the MAD is the standard deviation of a normal distribution
_SPREAD_MIN = 0.02  # of z-transformed correlations or logarithms, at least: less is no difference
_EXPLAINED_RATIO_MIN = 0.5  # times the usual share of variance in common, below which one is unlike
_RATIO_MAX = 2.0  # times the usual distance or distortion
_LOG2_AREA_MAX = 0.5  # mean |log2 J|: areas change by 41%
# a ratio of spreads, and a correlation, that are told
_SPREAD_RATIO_MAX = 2.0
_OPPOSITE_CORRELATION = -0.3


@dataclass(frozen=True)
class Likeness:
    """How like the others a subject is, on the template; NaN where that is unknown.

    Attributes
    ----------
    correlation : float
        With the mean of the others; of several channels the mean, by their weights.
    distance : float
        From it, over its deviation over the surface, in L2; of several channels the root of the
        mean square, by their weights.
    log2_area : float
        Mean of ``|log2 J|``, by which its map changes areas.
    folded : float
        Share of the faces, 0 to 1, that its map folds.
    """

    correlation: float
    distance: float
    log2_area: float = math.nan
    folded: float = math.nan


@dataclass(frozen=True)
class Judged:
    """Who counts (N,), why others do not, empty for those who do, and how like all are."""

    fits: BoolArray
    reasons: tuple[str, ...]
    likeness: tuple[Likeness, ...]


class Compared(NamedTuple):
    """What N subjects are held against each other by, on the template."""

    values: Sequence[FloatArray]  # (N, V), for each channel that counts
    masks: FloatArray  # (N, V): how much each is known at each vertex, not negative
    weights: FloatArray  # (N,): how much each counts for the others; those of 0 are judged, too
    areas: FloatArray  # (V,)
    channel_weights: Sequence[float]

    def seen(self, subject: int) -> FloatArray:
        """Return the areas (V,) of where a subject is known."""
        return np.where(self.masks[subject] > 0, self.areas, 0)

    def others(self, fits: BoolArray) -> list[Others]:
        """Return what means of others are made of, by channels, of those that fit."""
        shares = Shares(self.weights * fits, self.masks)
        return [Others.of(each, shares) for each in self.values]


def judge(
    compared: Compared,
    maps: Sequence[Likeness] | None = None,
    failures: Sequence[str] | None = None,
    for_good: BoolArray | None = None,
) -> Judged:
    """Say who does not fit, and why; who does not is left out of what the others are held against.

    A subject is left out that is unlike the mean of the others by a robust z-score of more than 3.5
    (by median and MAD over all), and by much: it shares less than half of the variance with them
    that others do; is twice as far from them; or has twice their distortion, and a mean
    ``|log2 J|`` above 0.5. Also one whose map folds a tenth of its faces, or whose functions are
    constant.

    Parameters
    ----------
    compared : Compared
    maps : sequence of Likeness, optional
        Of each subject, from which distortions are taken.
    failures : sequence of str, optional
        Why a subject cannot count, whatever it is like; else empty.
    for_good : (N,) array of bool, optional
        Who stays left out, also where it is like the others, see `left_for_good`.
    """
    count = len(compared.masks)
    known = maps or [Likeness(math.nan, math.nan)] * count
    reasons = list(failures or [""] * count)
    for i in range(count):
        if not reasons[i] and _says_nothing(compared, i):
            reasons[i] = "its functions are constant, or known nowhere"
    counting = np.array([not reason for reason in reasons])
    stays = np.zeros(count, bool) if for_good is None else counting & for_good
    fits = counting & ~stays
    while True:
        others = compared.others(fits)
        found = [_likeness(compared, others, i, known[i]) for i in range(count)]
        told = _unlike(found, counting)
        reasons = [new or before for new, before in zip(told, reasons, strict=True)]
        left = fits & np.array([not each for each in told])
        if (left == fits).all():
            break
        fits = left
    for i in np.flatnonzero(counting & ~fits).tolist():
        reasons[i] += _sign_and_unit(compared, others, i)
        if not reasons[i] and stays[i]:
            reasons[i] = "it hardly fits: it was left out twice, and came back between"
    return Judged(fits, tuple(reasons), tuple(found))


def left_for_good(rounds: Sequence[BoolArray]) -> BoolArray:
    """Say who was left out, came back, and was left out again, (N,), by who fitted at the ends of
    rounds: the mean would not come to rest if one came and went for ever.
    """
    fitted = np.stack([np.ones_like(rounds[0]), *rounds])
    return np.asarray((fitted[:-1] & ~fitted[1:]).sum(axis=0) > 1)


def _says_nothing(compared: Compared, subject: int) -> bool:
    seen = compared.seen(subject)
    own = [each[subject] for each in compared.values]
    return any(math.isnan(correlation(each, each, seen)) for each in own)


def _likeness(
    compared: Compared, others: Sequence[Others], subject: int, of_map: Likeness
) -> Likeness:
    seen = compared.seen(subject)
    pairs = [
        (each[subject], rest.without(subject), seen)
        for each, rest in zip(compared.values, others, strict=True)
    ]
    alike = [correlation(*pair) for pair in pairs]
    apart = [relative_distance(*pair) ** 2 for pair in pairs]
    weights = compared.channel_weights
    return Likeness(
        float(np.average(alike, weights=weights)),
        math.sqrt(np.average(apart, weights=weights)),
        of_map.log2_area,
        of_map.folded,
    )


def _unlike(found: Sequence[Likeness], counting: BoolArray) -> list[str]:
    """Say of each of N in what it is unlike the others; empty where it is not."""
    told = ["" for _ in found]
    for i, each in enumerate(found):
        if counting[i] and each.folded > FOLDED_SHARE_MAX:
            told[i] = f"its map folds {100 * each.folded:.3g}% of the faces"
    if counting.sum() < SUBJECTS_MIN:
        return told
    alike, apart, changes = (
        np.array([getattr(each, name) for each in found])
        for name in ("correlation", "distance", "log2_area")
    )
    common = np.sign(alike) * alike**2
    z_alike = _robust_z(np.arctanh(np.clip(alike, -1 + 1e-9, 1 - 1e-9)), counting)
    z_apart, z_changes = (
        _robust_z(np.log(np.maximum(each, 1e-9)), counting) for each in (apart, changes)
    )
    is_distorted = (changes > _RATIO_MAX * _usual(changes, counting)) & (changes > _LOG2_AREA_MAX)
    rules = (
        (
            (z_alike < -ROBUST_Z) & (common < _EXPLAINED_RATIO_MIN * _usual(common, counting)),
            alike,
            "it correlates with the mean of the others by {:.2f}, where the median is {:.2f}",
        ),
        (
            (z_apart > ROBUST_Z) & (apart > _RATIO_MAX * _usual(apart, counting)),
            apart,
            "it is {:.2g} deviations from the mean of the others, where the median is {:.2g}",
        ),
        (
            (z_changes > ROBUST_Z) & is_distorted,
            changes,
            "its map changes areas by a mean |log2 J| of {:.2f}, where the median is {:.2f}",
        ),
    )
    for is_unlike, numbers, words in rules:
        for i in np.flatnonzero(is_unlike & counting).tolist():
            reason = words.format(numbers[i], _usual(numbers, counting))
            told[i] = f"{told[i]}; {reason}" if told[i] else reason
    return told


def _usual(values: FloatArray, counting: BoolArray) -> float:
    known = values[counting & np.isfinite(values)]
    return float(np.median(known)) if len(known) else math.nan


def _robust_z(values: FloatArray, counting: BoolArray) -> FloatArray:
    """Return how many deviations values (N,) are from their median, the deviation by the MAD."""
    known = counting & np.isfinite(values)
    if not known.any():
        return np.full(len(values), np.nan)
    middle = float(np.median(values[known]))
    spread = _NORMAL * float(np.median(np.abs(values[known] - middle)))
    return np.asarray((values - middle) / max(spread, _SPREAD_MIN))


def _sign_and_unit(compared: Compared, others: Sequence[Others], subject: int) -> str:
    """Say what its values, held against those of the others, tell of their sign and unit."""
    for each, rest in zip(compared.values, others, strict=True):
        own, usual = each[subject], rest.without(subject)
        known = (compared.seen(subject) > 0) & np.isfinite(own) & np.isfinite(usual)
        if not known.any():
            continue
        weights = compared.areas[known] / compared.areas[known].sum()
        middle_own, middle = weights @ own[known], weights @ usual[known]
        off_own, off = own[known] - middle_own, usual[known] - middle
        size_own, size = (math.sqrt(weights @ one**2) for one in (off_own, off))
        if size == 0:
            continue
        if weights @ (off_own * off) < _OPPOSITE_CORRELATION * size_own * size:
            return "; its values have the other sign"
        if not 1 / _SPREAD_RATIO_MAX < size_own / size < _SPREAD_RATIO_MAX:
            told = f"its values spread {size_own / size:.2g} times as much over the surface"
            return f"; {told}, as in another unit"
        if abs(middle_own - middle) > size:
            shift = (middle_own - middle) / size
            return f"; its values lie {shift:.2g} deviations from theirs on average"
    return ""
