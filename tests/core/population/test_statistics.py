"""Means, standard deviations and parts of the variance, compared with NumPy and exact values."""

import math
from unittest.mock import Mock

import numpy as np
import pytest

from abfm.errors import ResultError
from abfm.population.round_result import ArrayStack
from abfm.population.statistics import (
    LeaveOneOut,
    Moments,
    Shares,
    correlation,
    deviation,
    mean,
    phase_and_amplitude,
    relative_distance,
)
from tests.messages import raises

RNG = np.random.default_rng(5)
VALUES, AREAS = RNG.normal(size=(6, 40)), RNG.uniform(0.5, 2, 40)
ONES = np.ones_like(VALUES)
ANGLES = 2 * np.pi * np.arange(400) / 400


def moments(values, shares=None):
    found = Moments.at(values.shape[1])
    for i, subject in enumerate(values):
        found.add(subject, np.ones_like(subject) if shares is None else shares[i])
    return found


def test_equal_shares_equal_numpy():
    assert mean(VALUES, 3 * ONES) == pytest.approx(VALUES.mean(axis=0))
    assert deviation(VALUES, 3 * ONES) == pytest.approx(VALUES.std(axis=0, ddof=1))


def test_shares_differ_between_vertices():
    shares = RNG.uniform(0, 2, VALUES.shape) * (RNG.uniform(size=VALUES.shape) < 0.9)
    assert mean(VALUES, shares) == pytest.approx(
        [np.average(VALUES[:, v], weights=shares[:, v]) for v in range(40)]
    )


def test_variance_of_unequal_shares_is_unbiased():
    """For any shares, the variance of many samples of variance 1 is estimated as 1 on average."""
    many = RNG.normal(size=(4, 200_000))
    shares = np.array([0.2, 1.0, 2.0, 5.0])[:, None] * np.ones_like(many)
    assert (deviation(many, shares) ** 2).mean() == pytest.approx(1, abs=0.02)


def test_values_with_share_0_are_ignored():
    values, shares = VALUES.copy(), ONES.copy()
    values[0, :10], shares[0, :10] = np.nan, 0
    values[2, 3], shares[2, 3] = np.inf, 0
    assert mean(values, shares)[:3] == pytest.approx(VALUES[1:, :3].mean(axis=0))
    assert deviation(values, shares)[5:10] == pytest.approx(VALUES[1:, 5:10].std(axis=0, ddof=1))


def test_too_few_shares_give_nan():
    """The mean needs one share at a vertex, the standard deviation two."""
    shares = ONES.copy()
    shares[:, 0], shares[1:, 1] = 0, 0
    assert math.isnan(mean(VALUES, shares)[0])
    assert mean(VALUES, shares)[1] == VALUES[0, 1]
    assert np.isnan(deviation(VALUES, shares)[:2]).all()
    assert np.isfinite(deviation(VALUES, shares)[2:]).all()


def test_mean_of_others_excludes_the_subject():
    shares = RNG.uniform(0, 2, VALUES.shape)
    shares[:, 7], shares[3, 7] = 0, 1  # where only one subject is known
    others = LeaveOneOut.of(VALUES, shares)
    for i in range(len(VALUES)):
        rest = np.arange(len(VALUES)) != i
        expected = mean(VALUES[rest], shares[rest])
        assert others.without(i) == pytest.approx(expected, nan_ok=True)
    assert math.isnan(others.without(3)[7])


def test_correlation_is_weighted_by_known_areas():
    f, g = VALUES[:2].copy()
    f[:5], areas = np.nan, AREAS.copy()
    areas[-3:] = 0
    known = slice(5, -3)
    covariance = np.cov(f[known], g[known], aweights=AREAS[known])
    expected = covariance[0, 1] / math.sqrt(covariance[0, 0] * covariance[1, 1])
    assert correlation(f, g, areas) == pytest.approx(expected)
    assert correlation(3 + 2 * f, -g, areas) == pytest.approx(-expected)


@pytest.mark.parametrize("constant", [0.0, 0.1, 1e9])
def test_constants_have_no_correlation(constant):
    assert math.isnan(correlation(np.full(40, constant), VALUES[0], AREAS))
    assert math.isnan(relative_distance(VALUES[0], np.full(40, constant), AREAS))


def test_distance_is_relative_to_deviation():
    f, g = VALUES[:2]
    expected = np.average((f - g) ** 2, weights=AREAS) / np.cov(g, aweights=AREAS, ddof=0)
    assert relative_distance(f, g, AREAS) == pytest.approx(math.sqrt(expected))
    assert relative_distance(10 * f, 10 * g, AREAS) == pytest.approx(math.sqrt(expected))


def test_phase_and_amplitude_add_up_to_variance():
    x, y = RNG.normal(size=(2, 5, 40))
    shares = RNG.uniform(0, 1, x.shape)
    part = phase_and_amplitude(moments(x, shares), moments(y), AREAS)
    means = mean(x, shares)
    squares = (shares * (x - means) ** 2).sum(axis=0) / shares.sum(axis=0)
    assert part.total == pytest.approx(np.average(squares, weights=AREAS))
    assert part.phase + part.amplitude == pytest.approx(part.total)


def test_variance_of_shifts_is_only_phase():
    """Waves shifted by plus and minus s have variance ``1/2 sin(s)^2``, 0 after alignment."""
    shift = 0.4
    x = np.stack([np.sin(ANGLES + shift), np.sin(ANGLES - shift)])
    part = phase_and_amplitude(moments(x), moments(np.stack([np.sin(ANGLES)] * 2)), np.ones(400))
    assert part.total == pytest.approx(0.5 * math.sin(shift) ** 2)
    assert part.phase == pytest.approx(part.total)
    assert part.amplitude == pytest.approx(0, abs=1e-12)
    assert part.factor == pytest.approx(1)


def test_variance_of_heights_is_only_amplitude():
    x = np.outer([0.5, 1.0, 1.5], np.sin(ANGLES))
    part = phase_and_amplitude(moments(x), moments(x), np.ones(400))
    assert part.amplitude == pytest.approx(part.total) == pytest.approx(0.5 * np.var([0.5, 1, 1.5]))
    assert part.phase == pytest.approx(0, abs=1e-12)
    equal = np.stack([np.sin(ANGLES)] * 3)
    assert phase_and_amplitude(moments(equal), moments(equal), np.ones(400))[:3] == (0, 0, 0)


def test_shifts_and_heights_are_separated():
    """For ``h sin(t + s)`` with independent h and s, the amplitude is ``1/2 var h``."""
    heights, shifts = np.array([0.8, 1.2]), np.array([-0.3, 0.3])
    x = np.stack([h * np.sin(ANGLES + s) for h in heights for s in shifts])
    y = np.stack([h * np.sin(ANGLES) for h in heights for _ in shifts])
    part = phase_and_amplitude(moments(x), moments(y), np.ones(400))
    assert part.amplitude == pytest.approx(0.5 * np.var(heights))
    assert part.phase == pytest.approx(0.5 * math.sin(0.3) ** 2)  # the mean height is 1


def test_only_points_known_before_and_after_count():
    x = np.outer([0.5, 1.5], np.sin(ANGLES))
    shares = np.ones_like(x)
    shares[:, :200] = 0
    part = phase_and_amplitude(moments(x), moments(x, shares), np.ones(400))
    expected = phase_and_amplitude(moments(x[:, 200:]), moments(x[:, 200:]), np.ones(200))
    assert part == pytest.approx(expected)
    nowhere = phase_and_amplitude(moments(x), moments(x, 0 * shares), np.ones(400))
    assert all(map(math.isnan, nowhere))


def test_array_stack_uses_a_temporary_file(tmp_path):
    stack = ArrayStack(tmp_path)
    for values in VALUES:
        stack.add(values)
    found = stack.array()
    assert np.array_equal(found, VALUES)
    with pytest.raises(ValueError, match="read-only"):
        found[0] = 1
    assert list(tmp_path.iterdir()) == []
    with raises(ResultError, "nowhere"):
        ArrayStack(tmp_path / "nowhere")


def test_full_disk_is_reported(tmp_path):
    stack = ArrayStack(tmp_path)
    stack._file = Mock(write=Mock(side_effect=OSError(28, "No space left on device")))
    with raises(ResultError, tmp_path.name, "No space left"):
        stack.add(VALUES)


def test_shares_are_weights_times_masks_where_values_are_known():
    values = VALUES.copy()
    values[1, 2] = np.nan
    shares = Shares(np.arange(6.0), 0.5 * ONES, values)
    assert len(shares) == 6
    assert shares[1][:4].tolist() == [0.5, 0.5, 0, 0.5]
    assert [each[0] for each in shares] == [0, 0.5, 1, 1.5, 2, 2.5]
