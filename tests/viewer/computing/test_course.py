"""Which fields of a run are kept, and when, by a clock of our own."""

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import pytest

from abfm import AbfmError
from abfm_viewer.computing import solver
from abfm_viewer.computing.solver import FIRST, Course, Snapshot
from tests.viewer.sessions import ENDLESS, problem

PROBLEM = problem(ENDLESS)


@pytest.fixture
def clock(monkeypatch):
    """Goes on when it is told."""
    clock = SimpleNamespace(seconds=0.0, perf_counter=lambda: clock.seconds)
    monkeypatch.setattr(solver, "clock", clock)
    return clock


class Iterate:
    """Whose field takes a while."""

    def __init__(self, clock, iteration, seconds, is_known=True):
        self.clock, self.iteration, self.seconds = clock, iteration, seconds
        self.is_known = is_known

    @property
    def velocity(self):
        self.clock.seconds += self.seconds
        if not self.is_known:
            raise AbfmError("ended")
        return "field"


def snapshot(iterate, of=PROBLEM):
    return Snapshot(of, iterate, iterate)


def begun(vertices, problem=PROBLEM):
    course = Course(vertices)
    course.begin(problem)
    return course


@pytest.mark.parametrize(
    ("vertices", "seconds"), [(10_000, 0.007), (40_000, 0.033), (160_000, 0.15), (500, 2.0)]
)
def test_fetching_takes_a_fiftieth_of_the_time_but_for_one_field(clock, vertices, seconds):
    course, spent, moments, iteration = begun(vertices), 0.0, [], 0
    while clock.seconds < 200:
        clock.seconds += 0.01
        iteration += 1
        before = clock.seconds
        course.fetch(snapshot(Iterate(clock, iteration, seconds)))
        if clock.seconds > before:
            spent += seconds
            moments.append(before)
            assert spent <= 0.021 * clock.seconds + (seconds if seconds > 1 else 0)
    assert moments[0] >= FIRST
    waits = [later - sooner for sooner, later in pairwise(moments)]
    assert all(later > sooner - 0.05 for sooner, later in pairwise(waits))
    if seconds < 0.1:
        assert moments[0] < FIRST + 0.1
        assert max(waits) < solver._LONGEST_WAIT + 0.1


def test_the_newest_of_the_present_solve_is_kept(clock):
    course = begun(10)
    first, second = (snapshot(Iterate(clock, number, 0)) for number in (4, 7))
    course.keep(second)
    course.keep(first)
    assert course.newest is second
    other = replace(PROBLEM)
    course.begin(other)
    assert course.newest is None
    course.keep(second)
    assert course.newest is None
    third = snapshot(Iterate(clock, 1, 0), other)
    course.keep(third)
    assert course.newest is third


def test_a_start_is_no_field_and_a_process_that_ended_has_none(clock):
    course = begun(10)
    clock.seconds = 3 * FIRST
    for iterate in (
        Iterate(clock, 0, 0),
        Iterate(clock, 5, 0, is_known=False),
        SimpleNamespace(iteration=6),  # not yet time for the next one
    ):
        course.fetch(snapshot(iterate))
        assert course.newest is None


def test_before_anything_that_moves_was_shown_there_is_nothing_to_fetch(clock):
    course = begun(0)
    clock.seconds = 2 * FIRST
    first, later = Iterate(clock, 0, 0.01), Iterate(clock, 5, 0.01)
    course.fetch(Snapshot(PROBLEM, later, first))
    assert course.newest is None
    course.fetch(Snapshot(PROBLEM, later, later))
    assert course.newest is not None
