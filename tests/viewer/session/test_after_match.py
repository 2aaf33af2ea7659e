"""What is shown of a match that has ended."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from abfm_viewer.document.document import View
from abfm_viewer.files.origin import Origin
from abfm_viewer.session.session import Session
from tests.viewer.sessions import SPHERE, matched, opened, solving, until


@pytest.fixture
def session():
    """One that shows its flow after a match."""
    session = opened()
    session.switch_flow_after_match()
    yield session
    session.close()


def test_the_flow_is_shown_and_played_once_from_0_to_tau(session):
    session.player.repeat, session.player.speed = "loop", 4.0
    before = session.editor.history.undo_label
    matched(session)
    assert session.player.playing
    assert session.time == 0
    assert session.view.arrows != session.view.streaks
    times = []
    until(lambda: times.append(session.time) or not session.player.playing, session)
    assert session.time == session.parameters.tau
    assert times == sorted(times)
    assert session.editor.history.undo_label == "match"
    session.undo()
    assert session.editor.history.undo_label == before
    assert session.result is None
    assert not (session.view.arrows)
    assert not (session.view.streaks)


def test_it_waits_for_what_it_would_show(session):
    session.player.held = True
    matched(session)
    session.update()
    assert session.time == 0
    session.player.held = False
    until(lambda: session.time > 0, session)


@pytest.mark.parametrize("touch", ["time", "play", "undo", "match", "switch"])
def test_what_the_user_does_stops_it(session, touch):
    matched(session)
    do = {
        "time": lambda: session.set_time(0.5),
        "play": session.player.toggle,
        "undo": session.undo,
        "match": session.match,
        "switch": session.switch_flow_after_match,
    }
    do[touch]()
    assert not session.player.playing


def test_saved_work_stays_saved(session, tmp_path):
    matched(session)
    session.saves.mark(session.document, Origin.of(tmp_path / "a.abfm"))
    session.player.speed = 4.0
    until(lambda: not session.player.playing, session)
    assert not session.saves.unsaved


def test_a_cancelled_run_shows_what_it_has(endless):
    endless.switch_flow_after_match()
    solving(endless).solver.cancel()
    until(lambda: endless.solver.finished, endless)
    assert endless.result.stop_reason == "cancelled"
    assert endless.player.playing


def test_a_flow_that_is_switched_off_is_not_played(session):
    session.switch_flow_after_match()
    matched(session)
    assert not session.player.playing
    assert session.time == session.parameters.tau
    assert not (session.view.arrows)
    assert not (session.view.streaks)


@pytest.fixture
def ball():
    """A session whose view may be given anew, and told of a match."""
    session = Session(SPHERE, "ball")

    def view_of_flow(velocity=1.0, **view):
        session.editor.amend(view=View(**view))
        match = SimpleNamespace(mesh=SPHERE, velocity=np.full((1, len(SPHERE.faces), 3), velocity))
        return session._view_of_flow(match)

    session.view_of_flow = view_of_flow
    yield session
    session.close()


@pytest.mark.parametrize("quickly", [False, True])
def test_streaks_on_small_meshes_where_drawing_is_quick(ball, quickly):
    ball.draws_quickly = quickly
    view = ball.view_of_flow()
    assert (view.arrows, view.streaks) == (not quickly, quickly)


def test_what_the_user_hid_stays_hidden(ball):
    shown = ball.view_of_flow()
    ball.editor.amend(view=shown)
    assert ball.view_of_flow(arrows=True) == View(arrows=True)
    assert ball.view_of_flow() is ball.view
    for _ in range(2):
        ball.switch_flow_after_match()
    assert ball.view_of_flow().arrows


@pytest.mark.parametrize("chosen", [{"streaks": True}, {"coloring": "speed"}])
def test_what_the_user_chose_stays_chosen(ball, chosen):
    assert ball.view_of_flow(**chosen) is ball.view


def test_a_field_of_zeros_has_no_flow_to_see(ball):
    assert ball.view_of_flow(velocity=0.0) is None
    assert ball.view_of_flow(flow_after_match=False) is None
