import os
import threading
import time
from functools import partial

import numpy as np
import pytest

from abfm import AbfmError, Parameters
from abfm_viewer.dialogs import Dialogs
from abfm_viewer.document.document import Surface
from abfm_viewer.document.kinds import MatchDocument
from abfm_viewer.files.project import load_project, save_project
from abfm_viewer.scene.textures import Textures
from abfm_viewer.window import recovery
from abfm_viewer.window.recovery_list import PICTURE_SIZE, Answer
from tests.mesh_writers import off_file
from tests.shapes import icosphere
from tests.viewer.sessions import ENDLESS, PAIR, SPHERE, end_run, matched, stepped, until


@pytest.fixture
def recoveries(desk, monkeypatch):
    """Return the recoveries of a session on a sphere, which copy at once."""
    monkeypatch.setattr(recovery, "Autosave", partial(recovery.Autosave, seconds=0.0))
    recoveries = recovery.Recoveries(desk.session, desk.state, desk.files, Dialogs(), Textures())
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


def leave_copy(state, name, alpha, seconds_ago):
    """Write the copy of a document of a launch that has ended, changed some seconds ago."""
    parameters = Parameters(alpha=alpha)
    document = MatchDocument((Surface(SPHERE, name),), (PAIR,), parameters=parameters)
    path = state.path / f"autosave-99999999{alpha:.0f}.abfm"
    state.path.mkdir(exist_ok=True)
    save_project(path, document, {})
    changed = time.time() - seconds_ago
    os.utime(path, (time.time(), changed))  # with the heartbeat of an app that has just ended
    return path, changed


@pytest.fixture
def listed(desk, recoveries):
    """Return the copies of two earlier launches when they are listed."""
    left = [leave_copy(desk.state, f"{n}.off", n, ago) for n, ago in ((1.0, 4000), (2.0, 60))]
    until(lambda: recoveries.update() or recoveries.copies, desk)
    return left


def test_copies_are_listed_with_the_times_of_their_content(listed, recoveries):
    names = [copy.name for copy in recoveries.copies]
    assert names == ["2.0.off", "1.0.off"]
    for copy, (path, changed) in zip(recoveries.copies, listed[::-1], strict=True):
        assert (copy.recovery.path, copy.recovery.changed) == (path, pytest.approx(changed))
        assert time.strftime("%H:%M", time.localtime(changed)) in copy.time
        assert copy.picture.size == PICTURE_SIZE
        assert np.asarray(copy.picture)[..., 3].any()


def test_recover_all_shows_the_latest_copy(listed, desk, recoveries):
    dialogs = recoveries._dialogs
    assert dialogs.has_question("Recover unsaved work?")
    recoveries._answered(Answer("recover", tuple(recoveries.copies)))
    until(lambda: desk.session.document.name == "2.0.off", desk)
    assert not dialogs.is_open
    assert recoveries.copies == []
    unsaved = {document.name for document in desk.session.saves.unsaved_documents}
    assert unsaved == {"1.0.off", "2.0.off"}
    desk.session.undo()
    assert desk.session.document.name == "1.0.off"
    assert not any(path.exists() for path, _ in listed)


def test_the_list_stays_until_each_copy_has_an_answer(listed, desk, recoveries):
    latest, older = recoveries.copies
    dialogs = recoveries._dialogs
    recoveries._answered(Answer("recover", (latest,)))
    until(lambda: desk.session.document.name == "2.0.off", desk)
    assert recoveries.copies == [older]
    assert dialogs.is_open
    recoveries._answered(Answer("later"))
    assert not dialogs.is_open
    assert older.recovery.path.exists()
    recoveries.list_copies()
    recoveries._answered(Answer("discard", (older,)))
    assert not dialogs.is_open
    assert not older.recovery.path.exists()
