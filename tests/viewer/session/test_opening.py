"""Opening and saving files through a session, without a window."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest

from abfm import MeshError, Parameters, load_match, match
from abfm_viewer.document.document import Channel
from abfm_viewer.session import session_files
from abfm_viewer.session.session import Session
from abfm_viewer.session.session_files import open_session


def solved(session: Session):
    """A short match of the session's functions."""
    f, g = session.values("source"), session.values("target")
    return match(session.surface().mesh, f, g, replace(session.parameters, iterations=3))


def test_a_result_opens_with_its_functions_and_is_not_outdated(desk, tmp_path):
    session = desk.session
    f = np.stack([session.values("source"), session.values("target")], axis=1)
    mask = np.linspace(0.5, 1, len(f))
    found = match(
        session.surface().mesh,
        f,
        f[:, ::-1].copy(),
        Parameters(iterations=2),
        mask=mask,
        weights=[1, 3],
    )
    found.save(tmp_path / "two words.npz")
    desk.open(tmp_path / "two words.npz")
    assert [channel.weight for channel in session.channels] == [1, 3]
    assert np.array_equal(session.values("source"), f[:, 0])
    assert np.array_equal(session.result.velocity, found.velocity)
    assert not session.outdated
    assert not session.saves.unsaved
    assert session.time == found.parameters.tau
    desk.files.save(tmp_path / "result.abfm")
    desk.settle()
    (tmp_path / "two words.npz").unlink()
    desk.open(tmp_path / "result.abfm")
    assert np.array_equal(session.values("target"), f[:, 1])
    assert not session.outdated
    desk.settle()


def test_save_goes_to_the_file_of_the_document_that_undo_came_back_to(desk, tmp_path):
    """Not over the project that was opened in between."""
    session = desk.session
    session.editor.set_parameter(alpha=3)
    for name in ("first", "second"):
        desk.files.save(tmp_path / f"{name}.abfm")
        desk.settle()
    desk.open(tmp_path / "first.abfm")
    assert session.saves.path == tmp_path / "first.abfm"
    session.undo()
    assert session.saves.path == tmp_path / "second.abfm"
    assert not session.saves.unsaved
    session.redo()
    assert session.saves.path == tmp_path / "first.abfm"


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("notes.txt", b"", "expected a file that ends in .obj, .off"),
        ("broken.off", b"OFF 3", "broken.off"),
        ("broken.abfm", b"PK", "broken.abfm"),
        ("broken.npz", b"PK", "broken.npz"),
        ("missing.off", None, "there is no such file"),
        ("missing.abfm", None, "No such file"),
    ],
)
def test_what_cannot_be_opened_is_one_line_and_changes_nothing(desk, tmp_path, name, content, told):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    was = desk.session.document
    desk.open(tmp_path / name)
    assert desk.session.notices.latest.is_error
    assert told in desk.session.notices.latest.text
    assert desk.session.document is was
    assert desk.state.recent() == []


def test_saves_are_written_in_order_and_each_is_told(desk, tmp_path, monkeypatch):
    slow = session_files.save_project

    def write(*words):
        time.sleep(0.05)
        slow(*words)

    monkeypatch.setattr(session_files, "save_project", write)
    done = []
    for name in "abc":
        desk.files.save(tmp_path / f"{name}.abfm", then=lambda name=name: done.append(name))
    desk.files.when_saved(lambda: done.append("end"))
    assert desk.files.saving
    desk.settle()
    assert done == ["a", "b", "c", "end"]
    assert sorted(path.name for path in tmp_path.glob("*.abfm")) == ["a.abfm", "b.abfm", "c.abfm"]


def test_changes_made_while_saving_stay_unsaved(desk, tmp_path):
    desk.session.editor.set_parameter(alpha=3)
    desk.files.save(tmp_path / "a.abfm")
    desk.session.editor.set_parameter(alpha=4)
    desk.settle()
    assert desk.session.saves.unsaved
    desk.session.undo()
    assert not desk.session.saves.unsaved


def test_a_session_begins_with_any_kind_of_file_and_nothing_to_undo(desk, tmp_path):
    found = solved(desk.session)
    found.save(tmp_path / "m.npz")
    desk.session.editor.change(
        "solve", result=found, channels=(Channel("coordinate:x", "coordinate:y"),)
    )
    desk.files.save(tmp_path / "p.abfm")
    desk.settle()
    for name in ("m.npz", "p.abfm"):
        session = open_session(tmp_path / name)
        assert np.array_equal(session.result.velocity, load_match(tmp_path / "m.npz").velocity)
        assert session.editor.history.undo_label == ""
        assert not session.saves.unsaved
        assert (session.saves.path is None) == (name == "m.npz")
        session.close()
    with pytest.raises(MeshError):
        open_session(tmp_path / "missing.off")
