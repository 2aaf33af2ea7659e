"""Closing while a match runs, and what a launch that ended badly left."""

import os
import signal
import threading
from contextlib import contextmanager

import pytest

from abfm_viewer.automation import Driver
from abfm_viewer.computing import solver
from abfm_viewer.computing.match_apart import MatchApart
from abfm_viewer.files.project import Origin, load_project, save_project
from tests.messages import check_message
from tests.shapes import icosphere
from tests.viewer.sessions import ENDLESS, SIZE, opened, solving, until


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
    gui.session.solver.pause()
    save_and_close(gui)
    frames = gui.window.frames
    gui.frames(5)
    assert gui.window.frames == frames + 5
    assert not gui.window.closing
    may_end.set()
    gui.wait(lambda _: gui.window.closing)
    saved = load_project(tmp_path / "work.abfm")[0]
    assert saved.result.velocity.any()
    assert saved.result.stop_reason == "cancelled"
    assert len(saved.runs[0].stages) > 5


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
    assert not gui.window.closing
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


def test_a_killed_process_leaves_a_card_to_go_on_with(gui, monkeypatch):
    monkeypatch.setattr(solver, "FIRST", 1e9)  # no field comes over that nobody asked for
    gui.session.editor.amend(parameters=ENDLESS.with_values(levels=1))
    for label in ("Continue", "Match again"):
        solving(gui.session)
        gui.session.solver.unfinished(
            gui.session.solver.snapshot, gui.session.functions_of(gui.session.document)
        )
        kept = gui.session.solver._course.best.shown.velocity
        os.kill(gui.session.solver._apart._worker.pid, signal.SIGKILL)
        gui.wait(lambda s: s.solver.failed)
        assert (gui.session.result.velocity == kept).all()
        check_message(gui.session.notices.cards[0].text)
        gui.click(label, within="message 1")
        gui.wait(lambda s: s.solver.snapshot is not None)
        assert gui.session.notices.cards == ()
        gui.session.solver.cancel()
        gui.wait(lambda s: not s.solver.running)


@pytest.fixture
def left(tmp_path):
    """The project that an ended launch had open, and the copy of its unsaved work."""
    session = opened()
    project = tmp_path / "work.abfm"
    save_project(project, session.document, {})
    origin = Origin.of(project)
    session.editor.set_parameter(sigma=0.25)
    copy = tmp_path / "autosave-999999999.abfm"  # more than processes are counted to
    save_project(copy, session.document, {}, origin)
    session.close()
    return project, copy


@contextmanager
def asked(tmp_path):
    """The next launch, which asks about the copy."""
    with Driver(icosphere(1), size=SIZE, state=tmp_path) as gui:
        gui.wait(lambda _: gui.window.dialogs.is_asking("Recover unsaved work?"))
        yield gui
        assert not gui.errors


@pytest.fixture
def recovered(left, tmp_path):
    with asked(tmp_path) as gui:
        gui.click("Recover")
        gui.wait(lambda s: s.parameters.sigma == 0.25)
        yield gui


@pytest.mark.parametrize(("answer", "is_kept"), [("Later", True), ("Discard", False)])
def test_a_copy_is_kept_or_discarded(left, tmp_path, answer, is_kept):
    with asked(tmp_path) as gui:
        gui.click(answer)
        gui.wait(lambda _: not gui.window.dialogs.is_open)
        assert left[1].exists() == is_kept
        assert gui.session.document.name == "mesh"


def written(gui):
    gui.wait(lambda s: not s.saves.unsaved and not gui.window.files.saving)


def test_what_is_recovered_is_saved_in_its_project(recovered, left):
    project, copy = left
    assert recovered.session.saves.title == "* work.abfm"
    recovered.key("ctrl+s")
    written(recovered)
    assert not recovered.window.dialogs.is_open
    assert load_project(project)[0].parameters.sigma == 0.25
    assert recovered.session.saves.title == "work.abfm"
    recovered.wait(lambda _: not list(copy.parent.glob("autosave-*")))
    recovered.session.editor.set_parameter(sigma=0.125)
    recovered.key("ctrl+s")  # the file is as this launch wrote it
    written(recovered)
    assert load_project(project)[0].parameters.sigma == 0.125


def test_a_project_that_was_changed_meanwhile_is_replaced_only_after_a_question(recovered, left):
    project, _ = left
    project.write_bytes(b"another's work")
    recovered.key("ctrl+s")
    recovered.frames(3)
    assert recovered.window.dialogs.is_asking("Replace a changed file?")
    recovered.click("Save as...", within="Replace a changed file?")
    recovered.frames(3)
    assert recovered.window.dialogs.is_open  # asks for a name
    recovered.key("esc")
    recovered.key("ctrl+s")
    recovered.frames(3)
    recovered.click("Go back", within="Replace a changed file?")
    assert project.read_bytes() == b"another's work"
    recovered.key("ctrl+s")
    recovered.frames(3)
    recovered.click("Replace", within="Replace a changed file?")
    written(recovered)
    assert load_project(project)[0].parameters.sigma == 0.25


def test_a_project_that_is_gone_is_forgotten(left, tmp_path):
    left[0].unlink()
    with asked(tmp_path) as gui:
        gui.click("Recover")
        gui.wait(lambda s: s.parameters.sigma == 0.25)
        assert (gui.session.saves.path, gui.session.saves.title) == (None, "* sphere")
