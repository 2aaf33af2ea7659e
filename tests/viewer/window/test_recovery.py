import threading
from functools import partial

import pytest

from abfm import AbfmError
from abfm_viewer.dialogs import Dialogs
from abfm_viewer.files.project import load_project
from abfm_viewer.window import recovery
from tests.mesh_writers import off_file
from tests.shapes import icosphere
from tests.viewer.sessions import ENDLESS, end_run, matched, stepped, until


@pytest.fixture
def recoveries(desk, monkeypatch):
    """Return the recoveries of a session on a sphere, which copy at once."""
    monkeypatch.setattr(recovery, "Autosave", partial(recovery.Autosave, seconds=0.0))
    recoveries = recovery.Recoveries(desk.session, desk.state, desk.files, Dialogs())
    yield recoveries
    end_run(desk.session)
    recoveries.close(keep_unsaved=False)


@pytest.fixture
def copies(desk, recoveries):
    def now():
        recoveries.update()
        return list(desk.state.path.glob("autosave-*.abfm"))

    return now


def test_run_of_a_later_mesh_is_copied(desk, copies, tmp_path):
    desk.open(off_file(tmp_path / "later.off", icosphere(1)))
    session = desk.session
    session.editor.amend(parameters=ENDLESS)
    session.reset_history()  # as if saved
    session.match()
    until(lambda: any(load_project(copy)[0].result for copy in copies()), session)
    assert session.saves.unsaved_documents == ()


def test_copy_of_a_run_opens_after_another_step(desk, copies):
    """A run that began while another step was shown has a copy that opens."""
    session = desk.session
    other = stepped(matched(session).result).at_step(0)
    session.editor.amend(result=other, solver_step=2, parameters=ENDLESS)
    session.match()

    def is_preserved(copy):
        return load_project(copy)[0].result.stop_reason == "cancelled"

    until(lambda: any(map(is_preserved, copies())), session)


def test_copies_survive_the_end_of_the_process(desk, copies, monkeypatch):
    session, snapshots = desk.session, []

    def unfinished(*snapshot):
        snapshots.append(snapshot)
        raise AbfmError("the process that matches has ended; match again")

    monkeypatch.setattr(session.matching, "unfinished", unfinished)
    session.editor.amend(parameters=ENDLESS)
    session.match()
    # until the first copy is written, or its problem reported
    until(lambda: copies() is not None and len(snapshots) > 1, session)
    assert session.notices.cards == ()
    assert copies()


def test_saved_documents_have_no_copies(desk, recoveries, copies, tmp_path):
    def writers():
        return [one for one in threading.enumerate() if one.name.startswith("autosave")]

    path, session = off_file(tmp_path / "later.off", icosphere(1)), desk.session
    for number in range(5):
        desk.open(path)
        session.editor.set_parameter(alpha=2.0 + number)
        until(copies, session)
        session.undo()
        until(lambda: not copies(), session)
    desk.open(path)
    until(lambda: recoveries.update() or len(recoveries._autosaves) <= 1, session)
    until(lambda: not writers(), session)
