import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import abfm
from abfm.calculus.operators import vertex_areas
from abfm.pages.color_ranges import color_range, few_ticks, ticks
from tests.shapes import icosphere

BALL = icosphere(4)
AREAS = vertex_areas(BALL)
NOISE = np.random.default_rng(0).normal(size=len(AREAS))


def ends(*functions, **options):
    found = color_range(*functions, **options)
    return found.low, found.high


def one_large(value=1e6):
    values = NOISE.copy()
    values[7] = value
    return values


@pytest.mark.parametrize("width", [0.02, 0.05, 0.1, 0.3])
def test_gaussian_keeps_its_peak(width):
    bump = abfm.function(BALL, f"gaussian:vertex=12,width={width}")
    found = color_range(bump, areas=AREAS)
    assert (found.high, found.clipped) == (1.0, (False, False))
    assert found.low == pytest.approx(0, abs=0.03)


@pytest.mark.parametrize(
    "values",
    [
        abfm.function(BALL, "gaussian:vertex=12,width=0.05") + 0.02 * NOISE,
        abfm.function(BALL, "gaussian:vertex=12,width=0.05")
        - abfm.function(BALL, "gaussian:vertex=40,width=0.05"),
        abfm.function(BALL, "indicator:vertex=12,radius=0.05"),
        np.arange(len(AREAS)) == 5,
        np.arange(len(AREAS)) % 35,
        NOISE,
        BALL.vertices[:, 2],
    ],
    ids=["noise", "two signs", "indicator", "one vertex", "labels", "normal", "height"],
)
def test_functions_without_extremes_are_not_clipped(values):
    values = values.astype(float)
    assert color_range(values, areas=AREAS).clipped == (False, False)
    assert color_range(values, areas=AREAS) == color_range(values, areas=AREAS, is_full=True)


def test_few_extremes_do_not_set_the_range():
    low, high = ends(one_large(), areas=AREAS)
    assert 2 < high == -low < 5
    found = color_range(one_large(), areas=AREAS)
    assert found.clipped == (False, True)
    assert found.full[1] == 1e6
    heavy = np.exp(2 * NOISE)
    found = color_range(heavy, areas=AREAS)
    assert (found.low, found.clipped) == (0, (False, True))
    assert found.high == pytest.approx(np.quantile(heavy, 0.98), rel=0.2)


def test_percentiles_are_by_area():
    values, areas = np.linspace(0, 1, 1000), np.ones(1000)
    values[::4], areas[::4] = 20, 1e-3
    assert ends(values, areas=areas)[1] < 1
    assert ends(values)[1] == 20


def test_all_functions_have_one_range():
    pair = NOISE, 3 * one_large()
    low, high = ends(*pair, areas=[AREAS, AREAS])
    assert 5 < high < 15
    assert ends(np.stack(pair), areas=AREAS) == (low, high)
    event = np.stack([0.02 * NOISE] * 30)
    event[4] += abfm.function(BALL, "gaussian:vertex=12,width=0.05")
    assert ends(event, areas=AREAS)[1] == pytest.approx(1, abs=0.05)  # a peak in one frame of many


@given(factor=st.sampled_from([1e-30, 1e-3, 7.0, 1e50]), is_negative=st.booleans())
def test_range_scales_with_the_function(factor, is_negative):
    for values in (NOISE, one_large(100), np.exp(NOISE)):
        low, high = ends(values, areas=AREAS)
        scaled = ends((-factor if is_negative else factor) * values, areas=AREAS)
        expected = (-high, -low) if is_negative else (low, high)
        if low == 0 and is_negative:  # only positive functions start at 0
            continue
        assert scaled == pytest.approx((factor * expected[0], factor * expected[1]), rel=0.05)


def test_range_does_not_depend_on_numbering():
    order = np.random.default_rng(1).permutation(len(AREAS))
    assert ends(one_large(), areas=AREAS) == ends(one_large()[order], areas=AREAS[order])


def test_magnitudes_start_at_zero_and_signed_are_symmetric():
    assert ends(np.array([2.0, 3.0]), quantity="magnitude") == (0, 3)
    assert ends(np.array([2.0, 3.0]), quantity="signed") == (-3, 3)
    assert ends(np.zeros(5), quantity="magnitude", end_min=0.5) == (0, 0.5)
    assert ends(np.zeros(5), quantity="signed") == (-1, 1)


def test_missing_values_do_not_count():
    values = np.array([np.nan, 1.0, 3.0, np.inf])
    assert ends(values) == (1, 3)
    assert ends(np.full(3, np.nan)) == ends(np.zeros(3))


@pytest.mark.parametrize(
    ("minimum", "expected"),
    [
        (-0.01, ("sequential", 0, 1)),
        (-0.04, ("sequential", -0.04, 1)),
        (-2.0, ("diverging", -2, 2)),
    ],
)
def test_signed_functions_have_a_symmetric_range(minimum, expected):
    shared = color_range(np.array([0.0, 0.4]), np.array([minimum, 1.0]))
    assert (shared.colormap, shared.low, shared.high) == (f"abfm {expected[0]}", *expected[1:])


@pytest.mark.parametrize("value", [0.0, -3.0, 1e-300, 1e17, -1e30])
def test_constant_is_inside_its_range(value):
    shared = color_range(np.full(4, value))
    assert shared.low < value < shared.high


def test_range_from_just_above_zero_begins_at_zero():
    assert [color_range(np.array([low, 1.0])).low for low in (0.01, 0.1)] == [0, 0.1]


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (0, 1, [0, 0.5, 1]),
        (-1, 1, [-1, 0, 1]),
        (0.604, 1.69, [0.75, 1, 1.25, 1.5]),
        (1012.0, 1013.0, [1012, 1012.5, 1013]),
    ],
)
def test_few_ticks_are_round(low, high, expected):
    assert few_ticks(low, high) == pytest.approx(expected)


@given(low=st.floats(-1e6, 1e6), width=st.floats(1e-3, 1e6))
def test_three_to_seven_ticks_are_in_the_range(low, width):
    for values in (ticks(low, low + width), few_ticks(low, low + width)):
        assert 3 <= len(values) <= 7
        assert values[0] >= low - 1e-6 * width
        assert values[-1] <= low + width + 1e-6 * width


def test_quantities_are_clipped_earlier_than_functions():
    values = np.concatenate([np.linspace(-1, 1, 1000), [3.0]])
    assert ends(values) == (-3, 3)
    assert ends(values, quantity="signed") == pytest.approx((-1, 1), abs=0.05)
