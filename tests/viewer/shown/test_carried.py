"""Functions carried along the flow that is shown, at any time of the time bar."""

from __future__ import annotations

import threading
from dataclasses import dataclass

import numpy as np
import pytest

import abfm
from abfm import AdvectionError
from abfm_viewer.computing.background import Jobs
from abfm_viewer.shown.shown_flow import Carried, FlowState, span
from tests.viewer.sessions import PAIR, QUICK, SPHERE, until


@pytest.fixture(scope="module")
def match():
    source, target = (abfm.function(SPHERE, spec) for spec in (PAIR.source, PAIR.target))
    return abfm.match(SPHERE, source, target, QUICK)


@pytest.fixture
def state(match):
    return FlowState(SPHERE, match.velocity, match.parameters)


@pytest.fixture
def jobs():
    jobs = Jobs()
    yield jobs
    jobs.close()


@pytest.fixture
def carried(jobs):
    return Carried(jobs)


@dataclass(frozen=True, eq=False)
class Limited(FlowState):
    """A flow that cannot be followed beyond some time."""

    end: float = 1.0

    def carry(self, function, times):
        if times.max() > self.end:
            raise AdvectionError("the flow overflows")
        return super().carry(function, times)


def distance(a, b):
    return float(np.linalg.norm(a - b) / np.linalg.norm(b))


def test_a_span_has_the_exact_function_at_tau_and_hardly_another_between(match, state):
    source = match.source[:, 0]
    over = span(state, source)
    assert over.note == ""
    assert (over.times[0], over.times[-1]) == (0, 2)
    for time, tolerance in ((0.0, 1e-7), (1.0, 1e-6), (2.0, 1e-6), (0.517, 2e-3), (1.813, 2e-3)):
        assert distance(over.at(time), match.advect(time)) < tolerance


def test_several_columns_are_carried_at_once(match, state):
    over = span(state, SPHERE.vertices)
    assert over.frames.shape == (len(over.times), len(SPHERE.vertices), 3)
    assert distance(over.at(1.0), match.push(SPHERE.vertices, 1.0)) < 1e-6


def test_where_the_flow_overflows_beyond_tau_the_span_ends_there(match):
    state = Limited(SPHERE, match.velocity, match.parameters)
    over = span(state, match.source[:, 0])
    assert over.times[-1] == 1
    assert over.note == "not beyond τ: the flow overflows"
    np.testing.assert_array_equal(over.at(1.7), over.at(1.0))  # the last one known


def test_a_flow_that_is_too_fast_for_any_time_is_an_error_and_no_end(match, carried, jobs):
    state = Limited(SPHERE, match.velocity, match.parameters, end=0.0)
    assert carried.at(state, match.source[:, 0], 0.5, settled=True) is None
    until(lambda: not jobs.busy)
    assert carried.error == "the flow overflows"
    assert carried.at(state, match.source[:, 0], 0.5, settled=True) is None


def test_at_time_0_the_function_is_there_at_once(match, state, carried, jobs):
    source = match.source[:, 0]
    assert carried.at(state, source, 0.0, settled=True) is source
    assert not jobs.busy


def test_scrubbing_shows_blends_and_a_settled_time_is_exact(
    match, state, carried, jobs, monkeypatch
):
    source, may_go_on, carry = match.source[:, 0], threading.Event(), FlowState.carry

    def late(state, function, times):
        assert may_go_on.wait(30)
        return carry(state, function, times)

    monkeypatch.setattr(FlowState, "carry", late)
    assert carried.at(state, source, 0.3, settled=False) is None
    may_go_on.set()
    until(lambda: not jobs.busy)
    assert distance(carried.at(state, source, 0.3, settled=False), match.advect(0.3)) < 2e-3
    carried.at(state, source, 0.3, settled=True)
    until(lambda: not jobs.busy)
    assert distance(carried.at(state, source, 0.3, settled=True), match.advect(0.3)) < 1e-12


def test_while_a_new_flow_is_followed_the_old_one_is_shown(match, state, carried, jobs):
    source = match.source[:, 0]
    carried.at(state, source, 0.5, settled=False)
    until(lambda: not jobs.busy)
    faster = FlowState(SPHERE, 1.1 * match.velocity, match.parameters, final=False)
    stale = carried.at(faster, source, 0.5, settled=False)
    assert distance(stale, match.advect(0.5)) < 2e-3
    until(lambda: not jobs.busy)
    assert distance(carried.at(faster, source, 0.5, settled=False), match.advect(0.55)) < 5e-3
    # of another shape: nothing to show
    assert carried.at(faster, SPHERE.vertices, 0.5, settled=False) is None


def test_a_field_is_computed_when_it_is_first_needed():
    asked: list[int] = []

    def velocity():
        asked.append(1)
        return np.zeros((1, len(SPHERE.faces), 3))

    flow = FlowState(SPHERE, velocity, QUICK)
    assert asked == []
    np.testing.assert_allclose(
        flow.carry(SPHERE.vertices[:, 0], np.array([1.0]))[0], SPHERE.vertices[:, 0]
    )
    assert flow.velocity is flow.velocity
    assert asked == [1]
