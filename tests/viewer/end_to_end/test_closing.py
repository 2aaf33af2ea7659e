"""Closing while a match runs: what is waited for is shown, and there is a way out."""

from __future__ import annotations

import os
import signal
import threading
from dataclasses import replace

import pytest

from abfm_viewer.computing.match_apart import MatchApart
from abfm_viewer.files.project import load_project
from tests.viewer.sessions import ENDLESS, solving, until


@pytest.fixture
def running(gui, tmp_path, monkeypatch):
    """A run of a project that ends when `may_end` is set, after it was cancelled."""
    may_end = threading.Event()
    match = MatchApart.match

    def slow(*given):
        found = match(*given)
        assert may_end.wait(60)
        return found

    monkeypatch.setattr(MatchApart, "match", slow)
    gui.window.files.save(tmp_path / "work.abfm")
    gui.wait(lambda s: s.saves.path and not s.saves.unsaved)
    gui.session.editor.set_parameter(**ENDLESS.to_dict())
    solving(gui.session)
    yield gui, may_end
    may_end.set()
    gui.session.solver.cancel()
    until(lambda: not gui.session.solver.running, gui.session)


def save_and_close(gui):
    gui.key("ctrl+q")
    gui.click("Save", within="Save before closing?")
    gui.wait(lambda _: any(w.section == "ending the run" for w in gui.window.ui.widgets))


def test_saving_and_closing_waits_for_the_run_with_frames(running, tmp_path):
    gui, may_end = running
    save_and_close(gui)
    frames = gui.window.frames
    gui.frames(5)
    assert gui.window.frames == frames + 5
    assert not gui.window.closing
    may_end.set()
    gui.wait(lambda _: gui.window.closing)
    assert load_project(tmp_path / "work.abfm")[0].result.velocity.any()


def test_a_cancelled_close_keeps_the_window_and_the_field(running):
    gui, may_end = running
    save_and_close(gui)
    gui.click("Cancel", within="ending the run")
    may_end.set()
    gui.wait(lambda s: s.solver.finished)
    gui.frames(5)
    assert not gui.window.closing
    assert gui.session.saves.unsaved
    assert gui.session.result.velocity.any()


def test_a_second_attempt_asks_again_and_may_close_at_once(running, tmp_path):
    gui, _ = running
    save_and_close(gui)
    gui.key("ctrl+q")
    gui.click("Go back", within="Save before closing?")
    gui.frames(3)
    assert gui.window.files.waiting is None
    save_and_close(gui)
    gui.key("ctrl+q")
    gui.click("Don't save", within="Save before closing?")
    assert gui.window.closing
    assert gui.session.solver.running
    assert load_project(tmp_path / "work.abfm")[0].result is None


def test_a_run_without_a_field_is_not_waited_for(gui, tmp_path, monkeypatch):
    may_begin = threading.Event()
    monkeypatch.setattr(MatchApart, "match", lambda *_: may_begin.wait(60) and 1 / 0)
    gui.window.files.save(tmp_path / "work.abfm")
    gui.wait(lambda s: s.saves.path and not s.saves.unsaved)
    gui.session.editor.set_parameter(sigma=0.25)
    gui.click("Match")
    gui.key("ctrl+q")
    gui.click("Save", within="Save before closing?")
    gui.wait(lambda _: gui.window.closing)
    assert load_project(tmp_path / "work.abfm")[0].parameters.sigma == 0.25
    may_begin.set()
    gui.wait(lambda s: not s.solver.running)
    for card in gui.session.notices.cards:
        gui.session.notices.dismiss(card)


def test_a_killed_process_leaves_a_card_to_go_on_with(gui):
    gui.session.editor.amend(parameters=replace(ENDLESS, levels=1))
    for label in ("Continue", "Match again"):
        solving(gui.session)
        gui.session.solver.unfinished(
            gui.session.solver.snapshot, gui.session.functions_of(gui.session.document)
        )
        kept = gui.session.solver._course.newest.iteration.velocity
        os.kill(gui.session.solver._apart._worker.pid, signal.SIGKILL)
        gui.wait(lambda s: s.solver.failed)
        assert (gui.session.result.velocity == kept).all()
        assert "match again" in gui.session.notices.cards[0].text
        gui.click(label, within="message 1")
        gui.wait(lambda s: s.solver.snapshot is not None)
        assert gui.session.notices.cards == ()
        gui.session.solver.cancel()
        gui.wait(lambda s: not s.solver.running)
