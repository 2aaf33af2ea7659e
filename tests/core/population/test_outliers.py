"""Outliers of subjects with known similarities."""

import numpy as np
import pytest

from abfm.population.outliers import (
    SUBJECTS_MIN,
    ComparisonData,
    Similarity,
    find_outliers,
    repeated_outliers,
)
from tests.messages import check_message

RNG = np.random.default_rng(8)
COMMON, AREAS = RNG.normal(size=200), RNG.uniform(0.5, 2, 200)
ALIKE = COMMON + 0.3 * RNG.normal(size=(9, 200))


def data_of(values, weights=None, masks=None):
    values = np.asarray(values)
    count = len(values)
    return ComparisonData(
        [values],
        np.ones(values.shape) if masks is None else masks,
        np.ones(count) if weights is None else np.asarray(weights, dtype=float),
        AREAS,
        [1.0],
    )


def with_outlier(outlier):
    return data_of([*ALIKE, outlier])


def test_equally_different_subjects_are_included():
    found = find_outliers(data_of(ALIKE))
    assert found.fits.all()
    assert set(found.reasons) == {""}
    assert find_outliers(data_of(COMMON + 3 * RNG.normal(size=(12, 200)))).fits.all()


def test_unrelated_function_is_an_outlier():
    found = find_outliers(with_outlier(RNG.normal(size=200)))
    assert found.fits.tolist() == [True] * 9 + [False]
    check_message(found.reasons[9])


def test_outlier_does_not_change_other_similarities():
    """A subject's similarity is that to the mean of the others, without outliers."""
    found = find_outliers(with_outlier(50 * RNG.normal(size=200)))
    assert not found.fits[9]
    alone = find_outliers(data_of(ALIKE))
    assert found.similarities[:9] == pytest.approx(alone.similarities)


@pytest.mark.parametrize(
    ("outlier", "named"),
    [(-ALIKE[0], ""), (10 * ALIKE[0], 10), (ALIKE[0] + 4, ""), (np.full(200, 3.0), "")],
)
def test_reason_names_sign_unit_or_offset(outlier, named):
    found = find_outliers(with_outlier(outlier))
    assert found.fits.tolist() == [True] * 9 + [False]
    check_message(found.reasons[9], named)


def test_few_subjects_have_no_outliers():
    few = find_outliers(data_of([*ALIKE[: SUBJECTS_MIN - 2], RNG.normal(size=200)]))
    assert few.fits.all()
    assert not find_outliers(data_of([*ALIKE[: SUBJECTS_MIN - 1], RNG.normal(size=200)])).fits.all()


def test_order_does_not_change_outliers():
    values = np.stack([*ALIKE, RNG.normal(size=200)])
    order = RNG.permutation(10)
    one, other = find_outliers(data_of(values)), find_outliers(data_of(values[order]))
    assert (one.fits[order] == other.fits).all()
    assert [one.reasons[i] for i in order] == list(other.reasons)


def test_subject_of_weight_0_is_checked():
    weights = [1] * 9 + [0]
    found = find_outliers(data_of([*ALIKE, RNG.normal(size=200)], weights))
    assert not found.fits[9]
    assert find_outliers(data_of([*ALIKE, COMMON], weights)).fits[9]
    heavy = find_outliers(data_of([*ALIKE, COMMON], [0] * 9 + [1]))
    assert heavy.fits.all()


def test_masked_values_are_ignored():
    values, masks = np.stack([*ALIKE, ALIKE[0]]), np.ones((10, 200))
    values[9, :100], masks[9, :100] = 1000, 0
    assert find_outliers(data_of(values, masks=masks)).fits.all()
    assert not find_outliers(data_of(values)).fits[9]


def test_folds_and_distortion_exclude_a_subject():
    def maps(log2_area=0.1, folded=0.0):
        similarities = [Similarity(np.nan, np.nan, 0.1 + 0.01 * i, 0.0) for i in range(8)]
        return [*similarities, Similarity(np.nan, np.nan, log2_area, folded)]

    assert find_outliers(data_of(ALIKE), maps()).fits.all()
    # larger than that of the others, but acceptable
    assert find_outliers(data_of(ALIKE), maps(log2_area=0.4)).fits.all()
    distorted = find_outliers(data_of(ALIKE), maps(log2_area=1.5))
    assert distorted.fits.tolist() == [True] * 8 + [False]
    check_message(distorted.reasons[8], "|log2 J|", "1.50")
    check_message(find_outliers(data_of(ALIKE), maps(folded=0.2)).reasons[8], "20%")


def test_repeated_outlier_stays_excluded():
    alike = find_outliers(data_of(ALIKE))
    assert alike.fits.all()
    stays_excluded = np.arange(9) == 4
    found = find_outliers(data_of(ALIKE), stays_excluded=stays_excluded)
    assert found.fits.tolist() == [i != 4 for i in range(9)]
    check_message(found.reasons[4])
    assert not any(found.reasons[:4])
    assert found.similarities[4].correlation == pytest.approx(alike.similarities[4].correlation)
    failures = ["", *["there is no file"] * 8]
    check_message(find_outliers(data_of(ALIKE), None, failures, stays_excluded).reasons[4])


def test_second_exclusion_is_permanent():
    rounds = np.array([[1, 0, 0, 1, 0], [1, 0, 1, 0, 1], [1, 0, 0, 1, 1], [1, 0, 0, 0, 1]], bool)
    assert not repeated_outliers(rounds[:2]).any()
    assert repeated_outliers(rounds[:3]).tolist() == [False, False, True, False, False]
    assert repeated_outliers(rounds).tolist() == [False, False, True, True, False]


def test_failures_are_excluded():
    values = ALIKE.copy()
    values[4] = np.nan
    masks = np.ones(values.shape)
    masks[4] = 0
    failures = [""] * 9
    failures[4] = "there is no file"
    found = find_outliers(data_of(values, masks=masks), None, failures)
    assert found.fits.tolist() == [i != 4 for i in range(9)]
    check_message(found.reasons[4])
    assert np.isnan(found.similarities[4].correlation)
