import threading
from dataclasses import replace

import numpy as np
import pytest

from abfm import AbfmError, Match
from abfm_viewer.computing.run import Process
from abfm_viewer.session.bound import _Found
from tests.messages import check_message
from tests.viewer.sessions import matched, stepped, until


@pytest.fixture
def walked(session):
    """Return a session with a saved match whose path has three steps."""
    session.editor.amend(result=stepped(matched(session).result))
    session.saves.record(session.document, None)
    return session


def go(session, step):
    session.steps.show(step)
    until(lambda: session.result.step == step, session)


def test_step_replaces_the_result_until_undo(walked):
    found, steps = walked.result, walked.steps
    go(walked, 0)
    assert walked.result.residual == found.path[0].residual
    assert walked.result.fine_velocity is found.path[0].velocity
    np.testing.assert_array_equal(walked.result.advected, found.at_step(0).advected)
    assert (steps.shown, steps.solver_step) == (0, 2)
    assert walked.saves.unsaved
    assert not walked.saves.has_new_result(walked.document)
    go(walked, 1)
    assert steps.solver_step == 2
    walked.undo()
    assert (walked.result.step, steps.solver_step) == (0, 2)
    steps.show(7)  # the last step, taken from the history with its facts
    assert walked.result is found
    assert walked.document.solver_step is None
    walked.undo()
    walked.undo()
    assert walked.result is found
    again = matched(walked)
    assert (again.document.solver_step, again.steps.solver_step) == (None, again.result.step)


@pytest.fixture
def slow(walked, held):
    """Return that session, with an event until which computing a step waits."""
    _, may = held(Match, "at_step")
    yield walked, may
    may.set()


def test_the_latest_request_wins(slow):
    session, may = slow
    found = session.result
    for step in (0, 1):
        session.steps.show(step)
    assert session.busy == "computing step 2"
    may.set()
    until(lambda: session.result.step == 1, session)
    assert [step.label for step in session.editor.past].count("show step 1 of the path") == 0
    may.clear()
    session.steps.show(0)
    session.editor.amend(result=replace(found, path=(), step=0))
    may.set()
    session.update()
    assert not session.busy
    assert session.result.path != found.path


def test_step_wins_over_an_earlier_bound(slow, monkeypatch):
    session, may = slow
    found, bounded = session.result, threading.Event()

    def within(*_, **__):
        bounded.wait(30)
        return _Found(replace(found, fine_velocity=0 * found.fine_velocity), "", None)

    monkeypatch.setattr(Process, "solve", within)
    session.limit_distortion()
    session.show_step(1)
    bounded.set()
    may.set()
    until(lambda: session.result.step == 1, session)
    until(lambda: not session.busy, session)
    assert session.result.fine_velocity is found.path[1].velocity


@pytest.mark.parametrize("change", ["limit_distortion", "undo", "match"])
def test_later_change_wins_over_a_step(slow, monkeypatch, change):
    session, may = slow
    session.editor.set_spec("source", session.channels[0].source.replace("0.15", "0.16"))
    until(lambda: not session.obstacle, session)
    monkeypatch.setattr(session.bound, "start", lambda: None)
    session.show_step(0)
    getattr(session, change)()
    assert not session.steps.busy
    may.set()
    until(lambda: not session.solver.running, session)
    session.update()
    assert session.result.step != 0


def test_error_while_computing_a_step_is_shown(walked, monkeypatch):
    def fails(*_):
        raise AbfmError("too fast")

    monkeypatch.setattr(Match, "at_step", fails)
    found = walked.result
    walked.steps.show(0)
    until(lambda: not walked.busy, walked)
    check_message(walked.notices.latest.text, 1, "too fast")
    assert (walked.result, walked.steps.shown) == (found, 2)
