"""Opening and saving files through a session, without a window."""

from __future__ import annotations

import time
from dataclasses import fields, replace

import numpy as np
import pytest

from abfm import MeshError, Parameters, load_match, match
from abfm_viewer.document.document import Channel, Point
from abfm_viewer.session import session_files
from abfm_viewer.session.opening import open_session
from abfm_viewer.session.session import Session
from tests.mesh_writers import off_text
from tests.shapes import icosphere
from tests.viewer.desk import Desk


def solved(session: Session):
    """A short match of the session's functions."""
    f, g = session.values("source"), session.values("target")
    return match(session.mesh, f, g, replace(session.parameters, iterations=3))


def test_a_project_reopens_identical(desk, tmp_path):
    session = desk.session
    result = solved(session)
    session.set_parameter(tau=2, alpha=0.5)
    np.save(tmp_path / "values.npy", np.linspace(0, 1, len(session.mesh.vertices)))
    session.add_channel()
    session.set_spec("source", f"file:{tmp_path}/values.npy")
    session.set_weight(0.5)
    session.change("solve", result=result)
    session.add_point("lines", Point(3, (0.2, 0.3, 0.5)))
    session.set_view("look", theme="dark", isolines=True, layout="column")
    session.set_time(0.7)
    desk.settle()
    assert session.unsaved
    path = tmp_path / "my work ☃.abfm"
    desk.files.save(path)
    desk.settle()
    assert not session.unsaved
    assert session.path == path
    assert str(path) in session.notice.text
    before = session.document

    (tmp_path / "values.npy").unlink()
    again = Desk(Session(icosphere(1), "other"), tmp_path / "state")
    again.settle()
    again.open(path)
    after = again.session.document
    for entry in fields(before):
        if entry.name not in ("mesh", "result", "runs"):
            assert getattr(after, entry.name) == getattr(before, entry.name), entry.name
    assert np.array_equal(after.mesh.vertices, before.mesh.vertices)
    assert np.array_equal(after.mesh.faces, before.mesh.faces)
    assert np.array_equal(after.result.velocity, result.velocity)
    assert again.session.values("source") == pytest.approx(np.linspace(0, 1, len(after.mesh.vertices)))
    assert not again.session.unsaved
    assert again.session.path == path
    again.files.save(tmp_path / "copy.abfm")
    again.settle()
    assert (tmp_path / "copy.abfm").read_bytes() == path.read_bytes()
    assert again.state.recent() == [tmp_path / "copy.abfm", path]
    again.session.close()


def test_a_result_opens_with_its_functions_and_is_not_outdated(desk, tmp_path):
    session = desk.session
    f = np.stack([session.values("source"), session.values("target")], axis=1)
    mask = np.linspace(0.5, 1, len(f))
    found = match(session.mesh, f, f[:, ::-1].copy(), Parameters(iterations=2), mask=mask, weights=[1, 3])
    found.save(tmp_path / "two words.npz")
    desk.open(tmp_path / "two words.npz")
    assert [channel.weight for channel in session.channels] == [1, 3]
    assert np.array_equal(session.values("source"), f[:, 0])
    assert np.array_equal(session.result.velocity, found.velocity)
    assert not session.outdated
    assert not session.unsaved
    assert session.time == found.parameters.tau
    desk.files.save(tmp_path / "result.abfm")
    desk.settle()
    (tmp_path / "two words.npz").unlink()
    desk.open(tmp_path / "result.abfm")
    assert np.array_equal(session.values("target"), f[:, 1])
    assert not session.outdated
    desk.settle()


def test_meshes_open_with_default_functions_and_undo_returns(desk, tmp_path):
    session = desk.session
    sphere = icosphere(1)
    (tmp_path / "small.OFF").write_text(off_text(sphere.vertices, sphere.faces))
    session.set_parameter(alpha=3)
    was = session.document
    desk.open(tmp_path / "small.OFF")
    assert len(session.mesh.vertices) == len(sphere.vertices)
    assert session.channels[0].source.startswith("gaussian:")
    assert "Undo returns to sphere.off" in session.notice.text
    while session.document is not was:
        session.undo()
    assert session.mesh is was.mesh


def test_save_goes_to_the_file_of_the_document_that_undo_came_back_to(desk, tmp_path):
    """Not over the project that was opened in between."""
    session = desk.session
    session.set_parameter(alpha=3)
    for name in ("first", "second"):
        desk.files.save(tmp_path / f"{name}.abfm")
        desk.settle()
    desk.open(tmp_path / "first.abfm")
    assert session.path == tmp_path / "first.abfm"
    session.undo()
    assert session.path == tmp_path / "second.abfm"
    assert not session.unsaved
    session.redo()
    assert session.path == tmp_path / "first.abfm"


def test_several_components_are_offered_and_one_opened(desk, tmp_path):
    a, b = icosphere(1), icosphere(2)
    vertices = np.concatenate([a.vertices, 2 * b.vertices + 9])
    faces = np.concatenate([a.faces, b.faces + len(a.vertices)])
    (tmp_path / "two.off").write_text(off_text(vertices, faces))
    was = desk.session.document
    desk.files.open(tmp_path / "two.off")
    desk.wait(lambda: bool(desk.session.cards))
    assert desk.session.document is was
    [card] = desk.session.cards
    size = f"{len(b.vertices)} vertices and {len(b.faces)} faces"
    assert card.text == f"two.off has several components, and one is needed; the largest has {size}"
    card.remedies["Open the largest component"]()
    desk.settle()
    assert desk.session.notice.text.startswith("opened two.off; kept the largest of 2 components: ")
    assert len(desk.session.mesh.vertices) == len(b.vertices)
    assert desk.session.cards == ()


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
    assert desk.session.notice.is_error
    assert told in desk.session.notice.text
    assert desk.session.document is was
    assert desk.state.recent() == []


def test_a_failed_save_keeps_the_work_unsaved_and_does_not_go_on(desk, tmp_path):
    desk.session.set_parameter(alpha=3)
    done = []
    desk.files.save(tmp_path / "no folder" / "a.abfm", then=lambda: done.append(1))
    desk.settle()
    assert desk.session.notice.is_error
    assert desk.session.notice.text.startswith("not saved: cannot write")
    assert desk.session.unsaved
    assert not done


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
    desk.session.set_parameter(alpha=3)
    desk.files.save(tmp_path / "a.abfm")
    desk.session.set_parameter(alpha=4)
    desk.settle()
    assert desk.session.unsaved
    desk.session.undo()
    assert not desk.session.unsaved


def test_a_session_begins_with_any_kind_of_file_and_nothing_to_undo(desk, tmp_path):
    found = solved(desk.session)
    found.save(tmp_path / "m.npz")
    desk.session.change("solve", result=found, channels=(Channel("coordinate:x", "coordinate:y"),))
    desk.files.save(tmp_path / "p.abfm")
    desk.settle()
    for name in ("m.npz", "p.abfm"):
        session = open_session(tmp_path / name)
        assert np.array_equal(session.result.velocity, load_match(tmp_path / "m.npz").velocity)
        assert session.history.undo_label == ""
        assert not session.unsaved
        assert (session.path is None) == (name == "m.npz")
        session.close()
    with pytest.raises(MeshError):
        open_session(tmp_path / "missing.off")
