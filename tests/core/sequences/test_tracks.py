from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from abfm import AbfmError
from abfm.calculus.operators import gradient
from abfm.calculus.vector_fields import to_ambient
from abfm.sequences import critical_points
from abfm.sequences.tracking.critical_points import CriticalPoints
from abfm.sequences.tracking.episodes import episodes
from abfm.sequences.tracking.tracks import tracks
from tests.messages import raises
from tests.shapes import icosphere

SPHERE = icosphere(3)


def heights(step: float, count: int) -> list[CriticalPoints]:
    """Return critical points of height gradients along a direction that rotates about z."""
    found = []
    for t in range(count):
        direction = np.array([np.cos(step * t), np.sin(step * t), 0.2])
        field = (gradient(SPHERE) @ (SPHERE.vertices @ direction)).reshape(-1, 2)
        found.append(critical_points(SPHERE, to_ambient(SPHERE, field)))
    return found


def test_rotating_source_and_sink_are_tracked():
    found = tracks(SPHERE, heights(0.15, 12), 0.5 + np.arange(12.0))
    assert sorted((len(t), t.kind, t.index) for t in found) == [(12, "sink", 1), (12, "source", 1)]
    sink = next(t for t in found if t.kind == "sink")
    x, y, _ = sink.points.positions.T
    assert_allclose(np.unwrap(np.arctan2(y, x)), 0.15 * np.arange(12), atol=0.03)
    assert_array_equal(sink.times, 0.5 + np.arange(12.0))


def test_order_of_points_does_not_matter():
    found = heights(0.15, 6)
    swapped = list(found)
    for i, each in enumerate(found):
        if i % 2:
            values = (each.index, each.kinds, each.divergence, each.curl)
            points = each.points[np.array([1, 0])]
            swapped[i] = CriticalPoints(points, *(array[::-1] for array in values))
    one, other = (tracks(SPHERE, each, np.arange(6.0)) for each in (found, swapped))
    for first, second in zip(one, other, strict=True):
        assert_array_equal(first.points.positions, second.points.positions)


def test_jump_ends_a_track():
    still = heights(0.0, 4)
    away = heights(2.0, 2)[1:] * 4
    found = tracks(SPHERE, [*still, *away], np.arange(8.0), min_intervals=1)
    assert sorted(len(t) for t in found) == [4, 4, 4, 4]


def test_track_may_miss_one_field_but_not_two():
    found = heights(0.02, 9)
    nothing = critical_points(SPHERE, np.zeros((len(SPHERE.faces), 3)))
    gap = [*found[:4], nothing, *found[5:]]
    assert sorted(len(t) for t in tracks(SPHERE, gap, np.arange(9.0))) == [8, 8]
    gap[5] = nothing
    assert sorted(len(t) for t in tracks(SPHERE, gap, np.arange(9.0))) == [3, 3, 4, 4]


@pytest.mark.parametrize("min_intervals", [0, 1.5, "two"])
def test_min_intervals_must_be_a_positive_integer(min_intervals):
    with raises(AbfmError):
        tracks(SPHERE, [], np.empty(0), min_intervals)


def test_episodes_of_an_oscillating_speed_are_found():
    times = np.linspace(0, 4 * np.pi, 81)
    middles = (times[1:] + times[:-1]) / 2
    found = episodes(times, np.sqrt(2 + np.cos(middles)))
    kinds = [e.kind for e in found]
    assert kinds == ["transient", "stable", "transient", "stable", "transient"]
    lows = [e for e in found if e.kind == "stable"]
    for episode, middle in zip(lows, (np.pi, 3 * np.pi), strict=True):
        assert episode.extremum == pytest.approx(middle, abs=0.1)
        assert episode.start == pytest.approx(middle - np.pi / 2, abs=0.2)
        assert episode.end == pytest.approx(middle + np.pi / 2, abs=0.2)
    for before, after in pairwise(found):
        assert before.end == pytest.approx(after.start, abs=0.2)


@pytest.mark.parametrize("factor", [1e-6, 1.0, 1e6])
def test_episodes_do_not_depend_on_units(factor):
    speed = np.array([1.0, 2, 3, 2, 1, 0.5, 1, 2])
    one = episodes(np.arange(9.0), speed)
    other = episodes(factor * np.arange(9.0), factor * speed)
    assert [e.kind for e in one] == [e.kind for e in other]
    assert_allclose([e.start * factor for e in one], [e.start for e in other])


def test_steady_speed_has_no_episodes():
    assert episodes(np.arange(6.0), np.full(5, 2.0)) == []
    assert episodes(np.arange(6.0), np.zeros(5)) == []
    assert episodes(np.arange(6.0), np.array([1, 1.01, 1, 1.01, 1])) == []
