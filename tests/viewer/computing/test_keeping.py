"""Which fields of a run are kept, and when, by a clock of our own."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import pytest

from abfm import AbfmError
from abfm_viewer.computing import keeping
from abfm_viewer.computing.keeping import FIRST, Keeper
from abfm_viewer.computing.problem import ProblemSpec, Snapshot
from tests.viewer.sessions import ENDLESS, problem

PROBLEM = problem(ENDLESS)


class Clock:
    """Goes on when it is told."""

    seconds = 0.0

    def __call__(self) -> float:
        return self.seconds


class Iterate:
    """Whose field takes a while."""

    def __init__(self, clock: Clock, iteration: int, seconds: float, is_known: bool = True) -> None:
        self.clock, self.iteration, self.seconds, self.is_known = (
            clock,
            iteration,
            seconds,
            is_known,
        )

    @property
    def velocity(self) -> str:
        self.clock.seconds += self.seconds
        if not self.is_known:
            raise AbfmError("ended")
        return "field"


def snapshot(iterate: object, of: ProblemSpec = PROBLEM) -> Snapshot:
    return Snapshot(of, iterate, iterate)


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.mark.parametrize(
    ("vertices", "seconds"), [(10_000, 0.007), (40_000, 0.033), (160_000, 0.15), (500, 2.0)]
)
def test_fetching_takes_a_fiftieth_of_the_time_but_for_one_field(clock, vertices, seconds):
    keeper, spent, moments = Keeper(vertices, clock), 0.0, []
    keeper.begin(PROBLEM)
    iteration = 0
    while clock.seconds < 200:
        clock.seconds += 0.01
        iteration += 1
        before = clock.seconds
        keeper.fetch(snapshot(Iterate(clock, iteration, seconds)))
        if clock.seconds > before:
            spent += seconds
            moments.append(before)
            assert spent <= 0.021 * clock.seconds + (seconds if seconds > 1 else 0)
    assert moments[0] >= FIRST
    waits = [later - sooner for sooner, later in pairwise(moments)]
    assert all(later > sooner - 0.05 for sooner, later in pairwise(waits))
    if seconds < 0.1:
        assert moments[0] < FIRST + 0.1
        assert max(waits) < keeping._LONGEST_WAIT + 0.1


def test_the_newest_of_the_present_solve_is_kept(clock):
    keeper = Keeper(10, clock)
    keeper.begin(PROBLEM)
    first, second = (snapshot(Iterate(clock, number, 0)) for number in (4, 7))
    keeper.keep(second)
    keeper.keep(first)
    assert keeper.newest is second
    other = replace(PROBLEM)
    keeper.begin(other)
    assert keeper.newest is None
    keeper.keep(second)
    assert keeper.newest is None
    third = snapshot(Iterate(clock, 1, 0), other)
    keeper.keep(third)
    assert keeper.newest is third


def test_a_start_is_no_field_and_a_process_that_ended_has_none(clock):
    keeper = Keeper(10, clock)
    keeper.begin(PROBLEM)
    clock.seconds = 3 * FIRST
    keeper.fetch(snapshot(Iterate(clock, 0, 0)))
    assert keeper.newest is None
    keeper.fetch(snapshot(Iterate(clock, 5, 0, is_known=False)))
    assert keeper.newest is None
    keeper.fetch(snapshot(SimpleNamespace(iteration=6)))  # not yet time for the next one
    assert keeper.newest is None


def test_before_anything_that_moves_was_shown_there_is_nothing_to_fetch(clock):
    keeper = Keeper(0, clock)
    keeper.begin(PROBLEM)
    clock.seconds = 2 * FIRST
    first, later = Iterate(clock, 0, 0.01), Iterate(clock, 5, 0.01)
    keeper.fetch(Snapshot(PROBLEM, later, first))
    assert keeper.newest is None
    keeper.fetch(Snapshot(PROBLEM, later, later))
    assert keeper.newest is not None
