"""What is kept of work that is in no file."""

import threading
from functools import partial

import pytest

from abfm import AbfmError
from abfm_viewer.dialogs import Dialogs
from abfm_viewer.files.project import load_project
from abfm_viewer.window import recovery
from abfm_viewer.window.recovery import Recoveries
from tests.mesh_writers import off_file
from tests.shapes import icosphere
from tests.viewer.sessions import ENDLESS, end_run, until


@pytest.fixture
def recoveries(desk, monkeypatch):
    """Of a session on a sphere, with copies at once."""
    monkeypatch.setattr(recovery, "Autosave", partial(recovery.Autosave, seconds=0.0))
    recoveries = Recoveries(desk.session, desk.state, desk.files, Dialogs())
    yield recoveries
    end_run(desk.session)
    recoveries.close(keep_unsaved=False)


def test_a_run_of_a_mesh_that_was_opened_later_is_kept(desk, recoveries, tmp_path):
    path = off_file(tmp_path / "later.off", icosphere(1))
    desk.open(path)
    session = desk.session
    session.editor.amend(parameters=ENDLESS)
    session.reset_history()  # as if it had been saved
    session.match()

    def kept():
        recoveries.update()
        return any(load_project(copy)[0].result for copy in desk.state.path.glob("autosave-*.abfm"))

    until(kept, session)
    assert session.saves.unsaved_documents == ()


def test_a_run_whose_process_has_just_ended_is_no_problem_of_copies(desk, recoveries, monkeypatch):
    asked = []

    def unfinished(*snapshot):
        asked.append(snapshot)
        raise AbfmError("the process that matches has ended; match again")

    session = desk.session
    monkeypatch.setattr(session.solver, "unfinished", unfinished)
    session.editor.amend(parameters=ENDLESS)
    session.match()

    def kept():
        recoveries.update()
        return len(asked) > 1  # the first copy was written, or its problem told

    until(kept, session)
    assert session.notices.cards == ()
    assert list(desk.state.path.glob("autosave-*.abfm"))


def test_meshes_that_were_left_with_nothing_unsaved_have_no_copies_and_no_threads(
    desk, recoveries, tmp_path
):
    path = off_file(tmp_path / "later.off", icosphere(1))
    session = desk.session
    for number in range(5):
        desk.open(path)
        session.editor.set_parameter(alpha=2.0 + number)

        def copied():
            recoveries.update()
            return bool(list(desk.state.path.glob("autosave-*.abfm")))

        until(copied, session)
        session.undo()

        def let_go():
            recoveries.update()
            return not list(desk.state.path.glob("autosave-*.abfm"))

        until(let_go, session)
    desk.open(path)
    until(lambda: recoveries.update() or len(recoveries._autosaves) <= 1, session)
    until(
        lambda: not [each for each in threading.enumerate() if each.name.startswith("autosave")],
        session,
    )
