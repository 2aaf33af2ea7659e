"""Tours of closing during a match, and of unsaved work of an earlier launch."""

import os
import signal
import threading
from contextlib import contextmanager

import pytest

from abfm_viewer.automation import Driver
from abfm_viewer.computing.run import Process
from abfm_viewer.files.project import Origin, load_project, save_project
from tests.messages import check_message
from tests.shapes import icosphere
from tests.viewer.sessions import ENDLESS, SIZE, opened, restart, solving, until


@contextmanager
def running(gui, path):
    """Start a run of a project that ends when the event is set, after a cancellation."""
    may_end = threading.Event()
    solve = Process.solve

    def slow(*given, **named):
        found = solve(*given, **named)
        assert may_end.wait(60)
        return found

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Process, "solve", slow)
        gui.window.files.save(path)
        gui.wait(lambda s: s.saves.path == path and not s.saves.unsaved)
        gui.session.editor.set_parameter(**ENDLESS.to_dict())
        solving(gui.session)
        yield may_end
        may_end.set()
        gui.session.solver.cancel()
        until(lambda: not gui.session.solver.running, gui.session)
    gui.window.closing = False


def test_tour_of_closing(gui, tmp_path, monkeypatch):
    """The window is closed during a match, before its first field, and after a killed process."""
    document = gui.session.document
    for step in (wait_for_the_run, cancel_closing, try_again):
        path = tmp_path / f"{step.__name__}.abfm"
        with running(gui, path) as may_end:
            step(gui, may_end, path)
        restart(gui, document)
    with monkeypatch.context() as patched:
        wait_for_no_run_without_a_field(gui, tmp_path, patched)
    restart(gui, document)
    resume_after_a_killed_process(gui)


def save_and_close(gui):
    gui.key("ctrl+q")
    gui.click("Save", within="Save before closing?")
    gui.wait(lambda _: any(w.section == "ending the run" for w in gui.window.ui.widgets))


def wait_for_the_run(gui, may_end, path):
    """Save and close: frames are drawn until the run has ended."""
    gui.session.solver.pause()
    save_and_close(gui)
    frames = gui.window.frames
    gui.frames(5)
    assert gui.window.frames == frames + 5
    assert not gui.window.closing
    may_end.set()
    gui.wait(lambda _: gui.window.closing)
    saved = load_project(path)[0]
    assert saved.result.velocity.any()
    assert saved.result.stop_reason == "cancelled"
    assert len(saved.runs[0].stages) > 5


def cancel_closing(gui, may_end, path):
    """Check that the window and the field stay."""
    save_and_close(gui)
    gui.click("Cancel", within="ending the run")
    may_end.set()
    gui.wait(lambda s: s.solver.finished)
    gui.frames(5)
    assert not gui.window.closing
    assert gui.session.saves.unsaved
    assert gui.session.result.velocity.any()


def try_again(gui, may_end, path):
    """Close a second time: the question appears again, and can end the window at once."""
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
    assert load_project(path)[0].result is None


def wait_for_no_run_without_a_field(gui, folder, monkeypatch):
    may_begin = threading.Event()
    monkeypatch.setattr(Process, "solve", lambda *_, **__: may_begin.wait(60) and 1 / 0)
    gui.window.files.save(folder / "no field.abfm")
    gui.wait(lambda s: s.saves.path and not s.saves.unsaved)
    gui.session.editor.set_parameter(sigma=0.25)
    gui.click("Match")
    gui.key("ctrl+q")
    gui.click("Save", within="Save before closing?")
    gui.wait(lambda _: gui.window.closing)
    assert load_project(folder / "no field.abfm")[0].parameters.sigma == 0.25
    may_begin.set()
    gui.wait(lambda s: not s.solver.running)
    for card in gui.session.notices.cards:
        gui.session.notices.dismiss(card)


def resume_after_a_killed_process(gui):
    gui.session.editor.amend(parameters=ENDLESS.with_values(levels=1))
    for label in ("Continue", "Match again"):
        solving(gui.session)
        gui.session.matching.unfinished(
            gui.session.matching.snapshot, gui.session.functions.of_document(gui.session.document)
        )
        best = gui.session.matching._best.shown
        os.kill(gui.session.solver.process._worker.pid, signal.SIGKILL)
        gui.wait(lambda s: s.solver.failed)
        result = gui.session.result
        # meanwhile there may be a better field
        assert (result.velocity == best.velocity).all() or result.residual <= best.residual
        check_message(gui.session.notices.cards[0].text)
        gui.click(label, within="message 1")
        gui.wait(lambda s: s.matching.snapshot is not None)
        assert gui.session.notices.cards == ()
        gui.session.solver.cancel()
        gui.wait(lambda s: not s.solver.running)


def leave_unsaved_work(folder, number=9):
    """Write the project of an ended launch and the copy of its unsaved work."""
    session = opened()
    project = folder / "work.abfm"
    save_project(project, session.document, {})
    origin = Origin.of(project)
    session.editor.set_parameter(sigma=0.25)
    copy = folder / f"autosave-99999999{number}.abfm"  # larger than any process id
    save_project(copy, session.document, {}, origin)
    session.close()
    return project, copy


@contextmanager
def next_launch(state):
    """Open the next launch, which shows a question about the copy."""
    with Driver(icosphere(1), size=SIZE, state=state) as gui:
        gui.wait(lambda _: gui.window.dialogs.has_question("Recover unsaved work?"))
        yield gui
        assert not gui.errors


def test_tour_of_recovery(tmp_path):
    """Copies of unsaved work are ignored, recovered, saved, discarded, or without a project."""
    left = project, copy = leave_unsaved_work(tmp_path)
    with next_launch(tmp_path) as gui:
        gui.click("Later")
        gui.wait(lambda _: not gui.window.dialogs.is_open)
        assert copy.exists()
        assert gui.session.document.name == "mesh"
    with next_launch(tmp_path) as gui:
        gui.click("Recover")
        gui.wait(lambda s: s.parameters.sigma == 0.25)
        assert gui.session.saves.title == "* work.abfm"
        replace_a_changed_project(gui, left)
        save_again(gui, left)
    leave_unsaved_work(tmp_path)
    with next_launch(tmp_path) as gui:
        gui.click("Discard")
        gui.wait(lambda _: not gui.window.dialogs.is_open)
        assert not copy.exists()
        assert gui.session.document.name == "mesh"
    leave_unsaved_work(tmp_path)
    with next_launch(tmp_path) as gui:
        gui.click("Recover")
        gui.wait(lambda s: s.parameters.sigma == 0.25)
        gui.key("ctrl+s")
        written(gui)
        assert not gui.window.dialogs.is_open
        assert load_project(project)[0].parameters.sigma == 0.25
    leave_unsaved_work(tmp_path)
    project.unlink()
    with next_launch(tmp_path) as gui:
        gui.click("Recover")
        gui.wait(lambda s: s.parameters.sigma == 0.25)
        assert (gui.session.saves.path, gui.session.saves.title) == (None, "* sphere")


def test_each_copy_of_several_has_its_buttons(tmp_path):
    copies = [leave_unsaved_work(tmp_path, number)[1] for number in range(4)]
    with next_launch(tmp_path) as gui:
        gui.click("Discard", within="copy 2")
        assert sum(copy.exists() for copy in copies) == 3
        gui.click("Recover", within="copy 3")
        gui.wait(lambda s: s.parameters.sigma == 0.25)
        gui.wait(lambda _: gui.window.dialogs.is_open)
        gui.click("Later")
        gui.menu("File", "Recover unsaved work...")
        gui.click("Recover all")
        gui.wait(lambda _: gui.window.recoveries.copies == [])
        assert not any(copy.exists() for copy in copies)
        assert len(gui.session.saves.unsaved_documents) == 3


def save_again(recovered, left):
    """Check that the file is as this launch wrote it, and that no copy remains."""
    project, copy = left
    assert recovered.session.saves.title == "work.abfm"
    recovered.wait(lambda _: not list(copy.parent.glob("autosave-*")))
    recovered.session.editor.set_parameter(sigma=0.125)
    recovered.key("ctrl+s")
    written(recovered)
    assert load_project(project)[0].parameters.sigma == 0.125


def written(gui):
    gui.wait(lambda s: not s.saves.unsaved and not gui.window.files.saving)


def replace_a_changed_project(recovered, left):
    """Check that a changed project is only replaced after a question."""
    project, _ = left
    project.write_bytes(b"another's work")
    recovered.key("ctrl+s")
    recovered.frames(3)
    assert recovered.window.dialogs.has_question("Replace a changed file?")
    recovered.click("Save as...", within="Replace a changed file?")
    recovered.frames(3)
    assert recovered.window.dialogs.is_open  # a dialog for the name opens
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
