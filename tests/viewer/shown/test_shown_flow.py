from dataclasses import dataclass, replace
from time import sleep

import numpy as np
import pytest

import abfm
from abfm import AdvectionError
from abfm.maps import chord_distortion
from abfm.mesh.subdivision import subdivided
from abfm_viewer.shown.flow_state import FlowState
from abfm_viewer.shown.paint import Painter
from abfm_viewer.shown.shown_flow import AtShownTime, span
from tests.core.fields import wavy_field
from tests.messages import check_message
from tests.viewer.sessions import PAIR, QUICK, SPHERE, hold, matched, opened, ready, solving, until


@pytest.fixture(scope="module")
def match():
    source, target = (abfm.function(SPHERE, spec) for spec in (PAIR.source, PAIR.target))
    return abfm.match(SPHERE, source, target, QUICK)


@pytest.fixture
def source(match):
    return match.source[:, 0]


@pytest.fixture
def state(match):
    return FlowState(SPHERE, match.velocity, match.parameters)


@pytest.fixture
def at_shown_time(jobs):
    return AtShownTime(jobs)


@dataclass(frozen=True, eq=False)
class Limited(FlowState):
    """A flow that cannot be computed beyond some time."""

    end: float = 1.0

    def advect(self, function, times):
        if times.max() > self.end:
            raise AdvectionError("the flow overflows")
        return super().advect(function, times)


def distance(a, b):
    return float(np.linalg.norm(a - b) / np.linalg.norm(b))


def test_span_is_exact_at_tau(match, state, source):
    over = span(state, source)
    assert over.note == ""
    assert (over.times[0], over.times[-1]) == (0, 2)
    for time, tolerance in ((0.0, 1e-7), (1.0, 1e-6), (2.0, 1e-6), (0.517, 2e-3), (1.813, 2e-3)):
        assert distance(over.at(time), match.advect(time)) < tolerance
    over = span(state, SPHERE.vertices)  # several columns at once
    assert over.frames.shape == (len(over.times), len(SPHERE.vertices), 3)
    assert distance(over.at(1.0), match.push(SPHERE.vertices, 1.0)) < 1e-6


def test_span_ends_at_tau_if_the_flow_overflows(match, source):
    over = span(Limited(SPHERE, match.velocity, match.parameters), source)
    assert over.times[-1] == 1
    check_message(over.note)
    np.testing.assert_array_equal(over.at(1.7), over.at(1.0))  # the span ends here


def test_too_fast_flow_is_an_error(match, source, at_shown_time, jobs):
    state = Limited(SPHERE, match.velocity, match.parameters, end=0.0)
    assert at_shown_time.at(state, source, 0.5, settled=True) is None
    until(lambda: not jobs.busy)
    check_message(at_shown_time.error)
    assert at_shown_time.at(state, source, 0.5, settled=True) is None


def test_settled_time_is_exact(match, state, source, at_shown_time, jobs, held):
    _, may_end = held(FlowState, "advect")
    assert at_shown_time.at(state, source, 0.0, settled=True) is source
    assert not jobs.busy
    assert at_shown_time.at(state, source, 0.3, settled=False) is None
    may_end.set()
    until(lambda: not jobs.busy)
    assert distance(at_shown_time.at(state, source, 0.3, settled=False), match.advect(0.3)) < 2e-3
    at_shown_time.at(state, source, 0.3, settled=True)
    until(lambda: not jobs.busy)
    assert distance(at_shown_time.at(state, source, 0.3, settled=True), match.advect(0.3)) < 1e-12


def test_old_flow_is_shown_until_the_new_one_is_ready(match, state, source, at_shown_time, jobs):
    at_shown_time.at(state, source, 0.5, settled=False)
    until(lambda: not jobs.busy)
    faster = FlowState(SPHERE, 1.1 * match.velocity, match.parameters, final=False)
    assert distance(at_shown_time.at(faster, source, 0.5, settled=False), match.advect(0.5)) < 2e-3
    until(lambda: not jobs.busy)
    assert distance(at_shown_time.at(faster, source, 0.5, settled=False), match.advect(0.55)) < 5e-3
    # an array of another shape cannot be shown meanwhile
    assert at_shown_time.at(faster, SPHERE.vertices, 0.5, settled=False) is None


def test_field_is_read_when_first_needed():
    calls, x = [], SPHERE.vertices[:, 0]

    def velocity():
        calls.append(1)
        return np.zeros((1, len(SPHERE.faces), 3))

    flow = FlowState(SPHERE, velocity, QUICK)
    assert calls == []
    np.testing.assert_allclose(flow.advect(x, np.array([1.0]))[0], x)
    assert flow.velocity is flow.velocity
    assert calls == [1]


def settle(shown, of_flow=lambda flow: flow.advected()):
    flow = shown.flow
    until(lambda: (of_flow(flow), flow.settled and not flow.busy)[1], shown.session)
    return of_flow(flow)


def advected(shown, time):
    return shown.flow.state.advect(shown.session.values("source"), np.array([time]))[0]


def test_outdated_result_is_not_shown(session, shown):
    session.editor.set_spec("source", "coordinate:x")
    ready(session)
    sleep(0.2)
    expected = advected(shown, session.parameters.tau)
    np.testing.assert_allclose(settle(shown), expected, atol=1e-12)


def test_new_channel_is_advected_by_the_field_of_the_run(endless, watched):
    shown = watched(endless)
    solving(endless)
    endless.matching.follow = False
    hold(endless)
    endless.editor.duplicate_channel()
    assert endless.document.channel == 1
    advected, iterate = settle(shown), endless.matching.snapshot.shown
    np.testing.assert_allclose(advected, iterate.advected[:, 0], atol=1e-6)


def test_run_shows_newest_picture_at_tau(endless, watched):
    shown = watched(endless)
    solving(endless)
    hold(endless)
    iterate = endless.matching.snapshot.shown
    np.testing.assert_array_equal(shown.flow.advected(), iterate.advected[:, 0])
    assert not shown.flow.state.final
    assert shown.flow.state.velocity is iterate.velocity
    endless.set_time(0.5)
    until(lambda: (shown.flow.advected(), not shown.flow.busy)[1], endless)
    early = shown.flow.advected()
    assert distance(early, advected(shown, 0.5)) < 5e-3

    endless.solver.resume()
    until(lambda: endless.matching.snapshot.iteration.iteration > iterate.iteration + 30, endless)
    # the new span
    until(lambda: not np.allclose(shown.flow.advected(), early, atol=1e-4), endless)


def test_end_of_a_match_is_shown(session, shown):
    np.testing.assert_array_equal(shown.flow.advected(), session.result.advected[:, 0])
    session.set_time(0.5)
    session.editor.set_parameter(tau=2.0)
    assert (session.time, session.document.end) == (1.0, 4.0)
    assert shown.flow.time == 0.5
    assert session.outdated


def test_settled_time_is_exact_after_a_match(watched):
    session = opened()
    try:
        shown = watched(session)
        matched(session)
        session.set_time(0.3)
        sleep(0.2)
        until(lambda: shown.flow.advected() is not None and not shown.flow.busy, session)
        until(lambda: (shown.flow.advected(), not shown.busy)[1], session)
        exact = session.result.advect(0.3)[:, 0]
        np.testing.assert_allclose(shown.flow.advected(), exact, atol=1e-12)
    finally:
        session.close()


def test_blend_is_the_same_array_until_exact(endless, watched):
    shown = watched(endless)
    solving(endless)
    hold(endless)
    endless.set_time(0.3)
    until(lambda: (shown.flow.advected(), not shown.flow.busy)[1], endless)
    assert shown.flow.advected() is shown.flow.advected()
    endless.set_time(endless.parameters.tau)
    assert shown.flow.advected() is shown.flow.advected()


def test_outdated_surface_is_marked(session, shown, held):
    _, may_end = held(FlowState, "advect")
    painter = Painter(shown)
    session.editor.set_view("see more", blend=True, error=True)
    session.set_time(0.5)
    titles = [painter.paint(name).title for name in ("advected", "error", "linear blend")]
    assert titles == ["advected: computing", "error: computing", "linear blend"]
    assert not shown.is_ready
    may_end.set()
    until(lambda: painter.paint("advected").title == "advected", session)
    assert painter.paint("error").title == "error"
    assert shown.is_ready


def test_playback_waits_until_all_times_are_known(session, shown):
    session.set_time(0.0)
    assert not shown.is_ready  # also at time 0
    until(lambda: shown.is_ready, session)
    session.set_time(0.5)
    assert not np.array_equal(shown.flow.advected(), session.values("source"))
    assert not shown.flow.is_behind


def test_origins_follow_flow_lines(session, shown):
    session.set_time(0.7)
    sleep(0.2)
    found = settle(shown, lambda flow: flow.coordinates())
    np.testing.assert_array_equal(found, session.result.point_map(0.7).positions)
    session.set_time(0.71)  # between two computed times
    expected = session.result.point_map(0.71).positions
    assert distance(shown.flow.coordinates(), expected) < 2e-3


def test_field_of_a_finer_mesh_advects_on_it(match, source):
    """The values are shown on the mesh itself."""
    fine = wavy_field(subdivided(SPHERE), 0)[None]
    state, flow = FlowState(SPHERE, fine, match.parameters), abfm.Flow(SPHERE, fine)
    assert state.velocity.shape == match.velocity.shape
    times = np.array([0.4, 1.0])
    np.testing.assert_allclose(state.advect(source, times), flow.push(source, times))
    on_mesh = abfm.Flow(SPHERE, state.velocity).push(source, times)
    assert not np.allclose(on_mesh, state.advect(source, times), atol=1e-3)
    named = match.problem.with_specs([PAIR.source], [PAIR.target])
    found = replace(match, problem=named, fine_velocity=fine)
    state = FlowState(SPHERE, fine, match.parameters, problem=named)
    assert distance(state.advect(source, times)[1], found.advect(1.0)) < 1e-9
    assert distance(state.advect(source, times)[1], found.push(source, 1.0)) > 1e-6


def test_distortion_is_exact_at_a_settled_time(session, shown, monkeypatch):
    quantities = shown.quantities

    def is_settled():
        settled = shown.flow.settled
        quantities.distortion()  # requested only after the time is settled
        return settled and not quantities.busy

    for time in (0.7, 0.4):
        session.set_time(time)
        until(is_settled, session)
        expected = session.result.flow.map_quality(time)
        np.testing.assert_array_equal(quantities.distortion().area, expected.distortion.area)
        assert quantities.map_quality().round_trip == expected.round_trip
    monkeypatch.setattr(type(shown.flow), "settled", False)
    session.set_time(0.5)
    until(lambda: (quantities.distortion(), not (quantities.busy or shown.flow.busy))[1], session)
    by_corners = session.result.point_map(0.5, inverse=True).positions
    expected = chord_distortion(SPHERE, by_corners).area
    assert distance(quantities.distortion().area, expected) < 0.05
