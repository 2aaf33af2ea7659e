"""What a launch that ended badly left: it is offered, and stays or goes as the user says."""

from __future__ import annotations

import pytest

from abfm_viewer.automation import Driver
from abfm_viewer.files.project import Origin, load_project, save_project
from tests.shapes import icosphere
from tests.viewer.sessions import SIZE, opened


@pytest.mark.parametrize(("answer", "is_kept"), [("Later", True), ("Discard", False)])
def test_a_copy_is_kept_or_discarded(tmp_path, answer, is_kept):
    session = opened()
    copy = tmp_path / "autosave-999999999.abfm"  # more than processes are counted to
    save_project(copy, session.document, {})
    session.close()
    with Driver(icosphere(1), size=SIZE, state=tmp_path) as gui:
        gui.wait(lambda _: gui.window.dialogs.is_asking("Recover unsaved work?"))
        gui.click(answer)
        gui.wait(lambda _: not gui.window.dialogs.is_open)
        assert copy.exists() == is_kept
        assert gui.session.document.name == "mesh"
        assert not gui.errors


@pytest.fixture
def left(tmp_path):
    """The project that an ended launch had open, and the copy of its unsaved work."""
    session = opened()
    project = tmp_path / "work.abfm"
    save_project(project, session.document, {})
    origin = Origin.of(project)
    session.editor.set_parameter(sigma=0.25)
    copy = tmp_path / "autosave-999999999.abfm"
    save_project(copy, session.document, {}, origin)
    session.close()
    return project, copy


@pytest.fixture
def recovered(left, tmp_path):
    """The next launch, after Recover."""
    with Driver(icosphere(1), size=SIZE, state=tmp_path) as gui:
        gui.wait(lambda _: gui.window.dialogs.is_asking("Recover unsaved work?"))
        gui.click("Recover")
        gui.wait(lambda s: s.parameters.sigma == 0.25)
        yield gui
        assert not gui.errors


def written(gui: Driver) -> None:
    gui.wait(lambda s: not s.saves.unsaved and not gui.window.files.saving)


def test_what_is_recovered_is_saved_in_its_project(recovered, left):
    project, copy = left
    assert recovered.session.saves.title == "* work.abfm"
    recovered.key("ctrl+s")
    written(recovered)
    assert not recovered.window.dialogs.is_open
    assert load_project(project)[0].parameters.sigma == 0.25
    assert recovered.session.saves.title == "work.abfm"
    recovered.frames(2)
    assert not copy.exists()
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
    project, _ = left
    project.unlink()
    with Driver(icosphere(1), size=SIZE, state=tmp_path) as gui:
        gui.wait(lambda _: gui.window.dialogs.is_asking("Recover unsaved work?"))
        gui.click("Recover")
        gui.wait(lambda s: s.parameters.sigma == 0.25)
        assert (gui.session.saves.path, gui.session.saves.title) == (None, "* sphere")
