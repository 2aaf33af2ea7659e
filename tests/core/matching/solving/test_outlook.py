import pytest

from abfm.matching.solving.outlook import Outlook, Plan, expected_seconds
from abfm.workers import progress


class Clock:
    def __init__(self, monkeypatch):
        self.now, self.reports = 0.0, []
        monkeypatch.setattr(progress.time, "monotonic", lambda: self.now)
        self.outlook = Outlook(lambda seconds, name: self.reports.append((name, seconds)), 1000)

    def iterate(self, plan, iterations, seconds, vertices=1000):
        """Do some iterations of a step of the continuation, each in a number of seconds."""
        self.outlook.plan(plan)
        for _ in range(iterations):
            self.now += seconds
            self.outlook.add(vertices)

    @property
    def remaining(self):
        return self.reports[-1][1]


@pytest.fixture
def clock(monkeypatch):
    return Clock(monkeypatch)


def test_remaining_time_is_proportional_to_that_of_an_iteration(monkeypatch):
    for seconds in (0.2, 2.0):
        clock = Clock(monkeypatch)
        clock.iterate(Plan(1, steps=4), 60, seconds)
        assert clock.remaining == pytest.approx((30 + 3 * 15) * seconds, rel=0.1)


def test_first_estimate_precedes_the_first_iteration(clock):
    clock.iterate(Plan(1, steps=4), 0, 1.0)
    few = clock.remaining
    clock.iterate(Plan(1, steps=8), 0, 1.0)
    assert 0.1 < 1.5 * few < clock.remaining < 10


def test_second_attempt_is_expected_to_be_like_the_first(clock):
    counts = [4, 9, 30, 60]
    for left, count in zip((4, 3, 2, 1), counts, strict=True):
        clock.iterate(Plan(1, steps=left, attempts=1.0), count, 1.0)
    clock.iterate(Plan(1), 0, 1.0)
    clock.iterate(Plan(1, steps=4), 4, 1.0)
    assert clock.remaining == pytest.approx(sum(counts), rel=0.1)
    clock.iterate(Plan(1, steps=3), 9, 1.0)
    assert clock.remaining == pytest.approx(30 + 60, rel=0.1)


def test_long_steps_are_expected_to_continue(clock):
    clock.iterate(Plan(1, steps=3), 400, 1.0)
    assert 200 <= clock.remaining < 300
    clock.iterate(Plan(1, steps=2), 10, 1.0)
    assert clock.remaining == pytest.approx(390 + 400, rel=0.1)


def test_finer_meshes_add_to_the_remaining_time(clock):
    clock.iterate(Plan(1), 40, 1.0)
    without = clock.remaining
    clock.iterate(Plan(1, finer=(4000, 16000), finer_share=0.5), 40, 1.0)
    half = clock.remaining
    clock.iterate(Plan(1, finer=(4000, 16000), finer_share=1.0), 40, 1.0)
    assert clock.remaining - without == pytest.approx(2 * (half - without), rel=0.1)
    assert half > 50 * without
    clock.iterate(Plan(1, refined=1), 1, 1.0, 4000)
    assert clock.reports[-1][0] == "refine"


def test_preparation_of_a_mesh_is_no_iteration(clock):
    clock.iterate(Plan(1, sizes=(4000,)), 40, 1.0)
    clock.now += 1000.0
    clock.iterate(Plan(1), 5, 6.0, 4000)
    assert clock.remaining < 100


def test_pause_in_an_iteration_hardly_counts(clock):
    clock.iterate(Plan(1), 20, 1.0)
    before = clock.remaining
    clock.now += 1000.0
    clock.outlook.add(1000)
    assert before < clock.remaining < 1.5 * before


def test_usual_time_grows_with_the_mesh():
    sizes = [300, 1000, 3000, 10_000, 40_000]
    times = list(map(expected_seconds, sizes))
    assert times == sorted(times)
    assert 0.1 < times[0] < times[-1] < 20
