"""The flow that is shown of a session, and what it carries, at every time and during a run."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from abfm_viewer.shown.paint import Painter
from abfm_viewer.shown.shown import Shown
from abfm_viewer.shown.shown_flow import FlowState
from tests.viewer.sessions import matched, solving, until


@pytest.fixture
def watched():
    """What pictures show of a session."""
    made = []

    def watch(session):
        made.append(Shown(session))
        return made[-1]

    yield watch
    for shown in made:
        shown.close()


def test_after_a_match_its_end_is_shown(session, watched):
    shown = watched(matched(session))
    np.testing.assert_array_equal(shown.flow.advected(), session.result.advected[:, 0])


def test_an_outdated_end_is_not_shown_but_what_the_flow_makes_of_the_source_now(session, watched):
    shown = watched(matched(session))
    session.editor.set_spec("source", "coordinate:x")
    until(lambda: not session.obstacle, session)
    time.sleep(0.2)
    until(lambda: (shown.flow.advected(), shown.flow.settled and not shown.flow.busy)[1], session)
    expected = shown.flow.state.carry(session.values("source"), np.array([session.parameters.tau]))[
        0
    ]
    np.testing.assert_allclose(shown.flow.advected(), expected, atol=1e-12)


def test_a_channel_that_the_run_does_not_have_is_carried_by_its_field(endless, watched):
    shown = watched(endless)
    solving(endless)
    endless.solver.follow = False
    endless.solver.pause()
    time.sleep(0.1)
    endless.editor.duplicate_channel()
    assert endless.document.channel == 1
    until(lambda: (shown.flow.advected(), shown.flow.settled and not shown.flow.busy)[1], endless)
    iterate = endless.solver.snapshot.shown
    np.testing.assert_allclose(shown.flow.advected(), iterate.advected[:, 0], atol=1e-6)


def test_during_a_run_the_newest_picture_is_shown_at_tau_and_followed_elsewhere(endless, watched):
    shown = watched(endless)
    solving(endless)
    endless.solver.pause()
    time.sleep(0.1)
    iterate = endless.solver.snapshot.shown
    np.testing.assert_array_equal(shown.flow.advected(), iterate.advected[:, 0])
    assert not shown.flow.state.final
    assert shown.flow.state.velocity is iterate.velocity
    endless.set_time(0.5)
    until(lambda: (shown.flow.advected(), not shown.flow.busy)[1], endless)
    early = shown.flow.advected()
    expected = shown.flow.state.carry(endless.values("source"), np.array([0.5]))[0]
    assert np.linalg.norm(early - expected) < 5e-3 * np.linalg.norm(expected)

    endless.solver.resume()
    until(lambda: endless.solver.snapshot.iteration.iteration > iterate.iteration + 30, endless)
    # the span followed
    until(lambda: not np.allclose(shown.flow.advected(), early, atol=1e-4), endless)


def test_after_another_tau_the_shown_time_keeps_its_place_in_the_flow(session, watched):
    shown = watched(session)
    matched(session)
    session.set_time(0.5)
    session.editor.set_parameter(tau=2.0)
    assert (session.time, session.document.end) == (1.0, 4.0)
    assert shown.flow.time == 0.5
    assert session.outdated


def test_a_settled_time_is_exact(session, watched):
    shown = watched(session)
    matched(session)
    session.set_time(0.3)
    time.sleep(0.2)
    until(lambda: shown.flow.advected() is not None and not shown.flow.busy, session)
    until(lambda: (shown.flow.advected(), not shown.busy)[1], session)
    exact = session.result.advect(0.3)[:, 0]
    np.testing.assert_allclose(shown.flow.advected(), exact, atol=1e-12)


@pytest.mark.parametrize("share", [0.3, 1.0, 1.7])
def test_what_does_not_change_stays_the_same_array(session, share, watched):
    """By which the surfaces know that there is nothing to draw again."""
    shown = watched(session)
    matched(session)
    session.set_time(share * session.parameters.tau)
    until(lambda: (shown.flow.advected(), shown.flow.settled and not shown.flow.busy)[1], session)
    assert shown.flow.advected() is shown.flow.advected()
    until(lambda: shown.flow.coordinates() is not None and not shown.flow.busy, session)
    assert shown.flow.coordinates() is shown.flow.coordinates()


def test_while_the_exact_values_come_the_blended_ones_stay_the_same_array(endless, watched):
    shown = watched(endless)
    solving(endless)
    endless.solver.pause()
    endless.set_time(0.3)
    until(lambda: (shown.flow.advected(), not shown.flow.busy)[1], endless)
    assert shown.flow.advected() is shown.flow.advected()
    endless.set_time(endless.parameters.tau)
    assert shown.flow.advected() is shown.flow.advected()


def test_a_surface_says_so_while_it_shows_another_time_than_the_others(
    session, watched, monkeypatch
):
    go, carry = threading.Event(), FlowState.carry
    monkeypatch.setattr(FlowState, "carry", lambda *given: go.wait(30) and carry(*given))
    shown = watched(matched(session))
    painter = Painter(shown)
    session.editor.set_view("see more", blend=True, error=True)
    session.set_time(0.5)
    titles = [painter.paint(name).title for name in ("advected", "error", "linear blend")]
    assert titles == ["advected: computing", "error: computing", "linear blend"]
    assert not shown.is_ready
    go.set()
    until(lambda: painter.paint("advected").title == "advected", session)
    assert painter.paint("error").title == "error"
    assert shown.is_ready


def test_what_is_played_is_known_before_the_time_moves(session, watched):
    shown = watched(matched(session))
    session.set_time(0.0)
    assert not shown.is_ready  # it is asked for at time 0, too
    until(lambda: shown.is_ready, session)
    session.set_time(0.5)
    assert not np.array_equal(shown.flow.advected(), session.values("source"))
    assert not shown.flow.is_behind
