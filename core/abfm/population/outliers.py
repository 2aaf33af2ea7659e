"""Outliers: subjects that differ from the mean of the others far more than is usual."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from abfm.matching.judging.verdict import FOLDED_SHARE_MAX
from abfm.population.statistics import LeaveOneOut, Shares, correlation, relative_distance
from abfm.types import BoolArray, FloatArray

SUBJECTS_MIN = 5
"""Minimum number of subjects for a comparison with the usual differences. With fewer subjects, a
difference from the others excludes none of them.
"""
ROBUST_Z = 3.5
"""Robust z-score beyond which a subject is an outlier [Iglewicz and Hoaglin 1993]. The score is the
distance from the median, divided by the standard deviation that the MAD estimates.
"""
_NORMAL_MAD_RATIO = 1.4826  # standard deviation / median absolute deviation, if normal
_SPREAD_MIN = 0.02  # minimum standard deviation of z-transformed correlations and logarithms
_EXPLAINED_RATIO_MIN = 0.5  # minimum explained variance of included subjects, divided by the median
_RATIO_MAX = 2.0  # maximum distance or distortion of included subjects, divided by the median
_LOG2_AREA_MAX = 0.5  # maximum mean |log2 J| of an included subject: areas change by 41%
# thresholds of the hints on the unit and the sign of values
_SPREAD_RATIO_MAX = 2.0
_OPPOSITE_CORRELATION = -0.3


@dataclass(frozen=True)
class Similarity:
    """Similarity of a subject to the others, on the template; NaN if unknown.

    Attributes
    ----------
    correlation : float
        Correlation with the mean of the others; weighted mean over channels.
    distance : float
        L2 distance to the mean of the others; weighted root mean square over channels. It is
        divided by the L2 norm of that mean minus its average over the surface.
    log2_area : float
        Mean of ``|log2 J|``, the change of areas by the map.
    folded : float
        Fraction of the faces, 0 to 1, that the map folds.
    """

    correlation: float
    distance: float
    log2_area: float = math.nan
    folded: float = math.nan


@dataclass(frozen=True)
class OutlierAnalysis:
    """Result of `find_outliers` for N subjects."""

    fits: BoolArray  # (N,) whether each subject is included
    reasons: tuple[str, ...]  # why each subject is excluded; empty for included subjects
    similarities: tuple[Similarity, ...]  # similarity of each subject to the others


class ComparisonData(NamedTuple):
    """Data of N subjects on the template that are compared with each other."""

    values: Sequence[FloatArray]  # (N, V), values of each channel used for registration
    masks: FloatArray  # (N, V), nonnegative, 0 where a subject is unknown
    weights: FloatArray  # (N,) weights in means; subjects of weight 0 are also checked
    areas: FloatArray  # (V,), areas of the vertices
    channel_weights: Sequence[float]

    def known_areas(self, subject: int) -> FloatArray:
        """Return the areas of the vertices, (V,), set to 0 where a subject is unknown."""
        return np.where(self.masks[subject] > 0, self.areas, 0)

    def others(self, fits: BoolArray) -> list[LeaveOneOut]:
        """Return leave-one-out sums over the included subjects, ``fits`` (N,), for each channel."""
        shares = Shares(self.weights * fits, self.masks)
        return [LeaveOneOut.of(each, shares) for each in self.values]


def find_outliers(
    data: ComparisonData,
    maps: Sequence[Similarity] | None = None,
    failures: Sequence[str] | None = None,
    stays_excluded: BoolArray | None = None,
) -> OutlierAnalysis:
    """Find outliers among N subjects, by comparison with the mean of the other included ones.

    A robust z-score uses the median and MAD over all subjects. A subject is an outlier if the
    z-score of one of these measures exceeds 3.5 and the measure also differs considerably:

    - the explained variance of the subject is less than half of the median;
    - the distance of the subject to the mean is more than twice the median;
    - the distortion of its map is more than twice the median, and the mean ``|log2 J|`` is above
      0.5.

    A subject is also excluded if its map folds more than a tenth of the faces, or if its functions
    are constant. The comparison is repeated without the outliers until there are no new ones.

    Parameters
    ----------
    data : ComparisonData
        Values and weights of the subjects on the template.
    maps : sequence of Similarity, optional
        Measures ``log2_area`` and ``folded`` of the map of each subject; by default unknown.
    failures : sequence of str, optional
        Reason why a subject must be excluded in any case; empty if there is none.
    stays_excluded : (N,) array of bool, optional
        Subjects that stay excluded even if they are similar to the others, see `repeated_outliers`.
    """
    count = len(data.masks)
    known = maps or [Similarity(math.nan, math.nan)] * count
    reasons = list(failures or [""] * count)
    for i in range(count):
        if not reasons[i] and _is_constant_or_unknown(data, i):
            reasons[i] = "its functions are constant or unknown everywhere"
    compared = np.array([not reason for reason in reasons])
    excluded = np.zeros(count, bool) if stays_excluded is None else compared & stays_excluded
    fits = compared & ~excluded
    while True:
        others = data.others(fits)
        found = [_similarity(data, others, i, known[i]) for i in range(count)]
        differences = _differences(found, compared)
        reasons = [new or before for new, before in zip(differences, reasons, strict=True)]
        remaining = fits & np.array([not each for each in differences])
        if (remaining == fits).all():
            break
        fits = remaining
    for i in np.flatnonzero(compared & ~fits).tolist():
        reasons[i] += _sign_and_unit(data, others, i)
        if not reasons[i] and excluded[i]:
            reasons[i] = "it was an outlier in two earlier rounds, and was included between them"
    return OutlierAnalysis(fits, tuple(reasons), tuple(found))


def repeated_outliers(rounds: Sequence[BoolArray]) -> BoolArray:
    """Return which subjects were excluded, included again, and excluded again, (N,).

    They stay excluded, as the mean would not converge otherwise. ``rounds`` are the included
    subjects, (N,), of each round.
    """
    fitted = np.stack([np.ones_like(rounds[0]), *rounds])
    return np.asarray((fitted[:-1] & ~fitted[1:]).sum(axis=0) > 1)


def _is_constant_or_unknown(data: ComparisonData, subject: int) -> bool:
    known_areas = data.known_areas(subject)
    functions = [each[subject] for each in data.values]
    return any(math.isnan(correlation(each, each, known_areas)) for each in functions)


def _similarity(
    data: ComparisonData, others: Sequence[LeaveOneOut], subject: int, of_map: Similarity
) -> Similarity:
    known_areas = data.known_areas(subject)
    pairs = [
        (each[subject], rest.without(subject), known_areas)
        for each, rest in zip(data.values, others, strict=True)
    ]
    correlations = [correlation(*pair) for pair in pairs]
    distances = [relative_distance(*pair) ** 2 for pair in pairs]
    weights = data.channel_weights
    correlated = float(np.average(correlations, weights=weights))
    distance = math.sqrt(np.average(distances, weights=weights))
    return Similarity(correlated, distance, of_map.log2_area, of_map.folded)


def _differences(found: Sequence[Similarity], compared: BoolArray) -> list[str]:
    """Return for each subject a text on its differences from the others, or an empty text."""
    differences = ["" for _ in found]
    for i, each in enumerate(found):
        if compared[i] and each.folded > FOLDED_SHARE_MAX:
            differences[i] = f"its map folds {100 * each.folded:.3g}% of the faces"
    if compared.sum() < SUBJECTS_MIN:
        return differences
    correlations, distances, changes = (
        np.array([getattr(each, name) for each in found])
        for name in ("correlation", "distance", "log2_area")
    )
    common = np.sign(correlations) * correlations**2
    z_correlations = _robust_z(np.arctanh(np.clip(correlations, -1 + 1e-9, 1 - 1e-9)), compared)
    z_distances, z_changes = (
        _robust_z(np.log(np.maximum(each, 1e-9)), compared) for each in (distances, changes)
    )
    is_distorted = (changes > _RATIO_MAX * _median(changes, compared)) & (changes > _LOG2_AREA_MAX)
    rules = (
        (
            (z_correlations < -ROBUST_Z)
            & (common < _EXPLAINED_RATIO_MIN * _median(common, compared)),
            correlations,
            "its correlation with the mean of the others is {:.2f} (median of all subjects {:.2f})",
        ),
        (
            (z_distances > ROBUST_Z) & (distances > _RATIO_MAX * _median(distances, compared)),
            distances,
            "its distance to the mean of the others is {:.2g} standard deviations "
            "(median of all subjects {:.2g})",
        ),
        (
            (z_changes > ROBUST_Z) & is_distorted,
            changes,
            "its map changes areas by a mean |log2 J| of {:.2f} (median of all subjects {:.2f})",
        ),
    )
    for is_outlier, numbers, words in rules:
        for i in np.flatnonzero(is_outlier & compared).tolist():
            reason = words.format(numbers[i], _median(numbers, compared))
            differences[i] = f"{differences[i]}; {reason}" if differences[i] else reason
    return differences


def _median(values: FloatArray, compared: BoolArray) -> float:
    known = values[compared & np.isfinite(values)]
    return float(np.median(known)) if len(known) else math.nan


def _robust_z(values: FloatArray, compared: BoolArray) -> FloatArray:
    """Return robust z-scores of values (N,), by median and MAD of the compared subjects."""
    known = compared & np.isfinite(values)
    if not known.any():
        return np.full(len(values), np.nan)
    median = float(np.median(values[known]))
    spread = _NORMAL_MAD_RATIO * float(np.median(np.abs(values[known] - median)))
    return np.asarray((values - median) / max(spread, _SPREAD_MIN))


def _sign_and_unit(data: ComparisonData, others: Sequence[LeaveOneOut], subject: int) -> str:
    """Return a hint if a subject's values seem to have another sign, unit or offset, else ''."""
    for each, rest in zip(data.values, others, strict=True):
        values, mean_of_others = each[subject], rest.without(subject)
        known = (data.known_areas(subject) > 0) & np.isfinite(values) & np.isfinite(mean_of_others)
        if not known.any():
            continue
        weights = data.areas[known] / data.areas[known].sum()
        value_mean, mean = weights @ values[known], weights @ mean_of_others[known]
        value_deviations, deviations = values[known] - value_mean, mean_of_others[known] - mean
        own_norm, norm = (math.sqrt(weights @ one**2) for one in (value_deviations, deviations))
        if norm == 0:
            continue
        if weights @ (value_deviations * deviations) < _OPPOSITE_CORRELATION * own_norm * norm:
            return "; its values have the opposite sign"
        if not 1 / _SPREAD_RATIO_MAX < own_norm / norm < _SPREAD_RATIO_MAX:
            ratio = own_norm / norm
            return f"; its values vary {ratio:.2g} times as much as the mean, as in another unit"
        if abs(value_mean - mean) > norm:
            shift = (value_mean - mean) / norm
            return f"; its mean differs from that of the others by {shift:.2g} standard deviations"
    return ""
