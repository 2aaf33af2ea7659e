"""Nothing is lost unasked: what is in no file is known, and no run is ended by opening
something.
"""

from __future__ import annotations

from functools import partial

import pytest

from abfm import Parameters, TriangleMesh
from abfm_viewer.window.figure_document import figure_document
from tests.mesh_writers import off_text
from tests.shapes import icosphere
from tests.viewer.desk import Desk
from tests.viewer.sessions import ENDLESS, QUICK, matched, solving

SMALL = icosphere(1)


@pytest.fixture
def small(tmp_path):
    """A mesh file."""
    return written(SMALL, tmp_path / "small.off")


def written(mesh: TriangleMesh, path):
    """The mesh in a file."""
    path.write_text(off_text(mesh.vertices, mesh.faces))
    return path


@pytest.fixture
def solved(desk: Desk):
    """A desk with a result that is in no file."""
    desk.session.editor.amend(parameters=QUICK)
    matched(desk.session)
    return desk


def names(desk: Desk) -> list[str]:
    """Of the documents that would be lost."""
    return [document.name for document in desk.session.saves.unsaved_documents]


def test_a_result_that_was_left_is_unsaved_until_it_is_saved(solved, small, tmp_path):
    session, found = solved.session, solved.session.result
    solved.open(small)
    assert not session.saves.unsaved
    [left] = session.saves.unsaved_documents
    assert left.result is found
    assert session.saves.has_new_result(left)
    solved.files.save(tmp_path / "left.abfm", document=left)
    solved.settle()
    assert session.saves.unsaved_documents == ()
    session.undo()
    assert session.result is found
    assert session.saves.path == tmp_path / "left.abfm"
    assert not session.saves.unsaved


def test_changes_that_were_left_are_unsaved_too_in_the_order_of_what_was_left(desk, small):
    desk.session.editor.set_parameter(alpha=3)
    desk.open(small)
    desk.session.editor.set_parameter(alpha=4)
    assert names(desk) == ["small.off", "sphere.off"]
    desk.open(small)
    assert names(desk) == ["sphere.off", "small.off"]


def test_what_undo_and_redo_leave_is_unsaved(desk, small):
    desk.open(small)
    desk.session.editor.set_parameter(alpha=3)
    for _ in range(2):
        desk.session.undo()
    assert names(desk) == []  # the change was taken back, too
    for _ in range(2):
        desk.session.redo()
    assert names(desk) == ["small.off"]
    matched(desk.session)
    for _ in range(3):
        desk.session.undo()
    assert desk.session.surface().mesh.vertices.shape == icosphere(2).vertices.shape
    assert names(desk) == ["small.off"]
    assert desk.session.saves.unsaved_documents[0].result is not None


def test_a_result_that_was_taken_back_is_unsaved_until_another_state_is_saved(solved, tmp_path):
    session, found = solved.session, solved.session.result
    session.undo()
    session.editor.amend(parameters=Parameters())
    assert not session.saves.unsaved
    [document] = session.saves.unsaved_documents
    assert document.result is found
    solved.files.save(tmp_path / "chosen.abfm")
    solved.settle()
    assert session.saves.unsaved_documents == ()


def test_a_later_result_is_not_settled_by_a_save_that_began_before_it(solved, small, tmp_path):
    session = solved.session
    solved.files.save(tmp_path / "a.abfm")
    matched(session)
    later = session.result
    solved.settle()
    solved.open(small)
    assert [document.result for document in session.saves.unsaved_documents] == [later]


def test_many_steps_later_it_is_still_known(solved, small):
    solved.open(small)
    for step in range(300):
        solved.session.editor.set_parameter(alpha=1 + step / 100)
    assert "sphere.off" in names(solved)


@pytest.mark.parametrize("what", ["mesh", "figure", "drop"])
def test_opening_during_a_run_asks(desk, small, what):
    session = desk.session
    session.editor.amend(parameters=ENDLESS)
    solving(session)
    opening = {
        "mesh": lambda: desk.files.open(small),
        "figure": lambda: desk.files.open_made("figure 1", partial(figure_document, 1)),
        "drop": lambda: desk.files.open_first([small]),
    }[what]
    opening()
    [(title, text, answers)] = desk.questions
    assert title == "End the run?"
    assert "sphere.off is being matched" in text
    assert answers["Go back"] is None
    for _ in range(10):
        desk.update()
    assert session.solver.running
    assert session.loading.now is None
    answers["End the run"]()
    desk.wait(lambda: session.surface().mesh.vertices.shape != icosphere(2).vertices.shape)
    assert [document.result is not None for document in session.saves.unsaved_documents] == [True]
    session.undo()
    assert session.result.velocity.any()


def test_a_run_does_not_start_while_its_mesh_is_about_to_be_replaced(desk, small):
    session = desk.session
    desk.files.open(small)
    assert session.loading.replacing == "opening small.off"
    session.match()
    assert not session.solver.running
    assert "opening small.off" in session.notices.latest.text
    session.loading.cancel()
    assert session.loading.replacing == ""
    desk.settle()
    assert session.document.name == "sphere.off"
    desk.open(small)
    assert session.document.name == "small.off"


def test_a_file_of_another_kind_is_refused_without_asking(desk, tmp_path):
    desk.session.editor.amend(parameters=ENDLESS)
    solving(desk.session)
    desk.files.open(tmp_path / "song.mp3")
    assert desk.questions == []
    assert desk.session.solver.running
