"""Undo and redo."""

from dataclasses import replace

import numpy as np
import pytest

from abfm_viewer.document.document import Document, Front, Look, Surface
from abfm_viewer.session.editor import LONGEST, Editor
from tests.viewer.sessions import EGG, SPHERE


@pytest.fixture
def editor():
    return Editor(Document((Surface(SPHERE, "sphere"),)))


def move(editor, time, merge="", label="move"):
    editor.go_to(replace(editor.document, time=time), label, merge)


def look(editor, **view):
    return replace(editor.document, view=replace(editor.document.view, **view))


def test_undo_goes_back_to_the_very_start_and_redo_to_the_end(editor):
    start = editor.document
    for time in (1.0, 2.0, 3.0):
        move(editor, time, label=f"move to {time:g}")
    assert editor.undo_label == "move to 3"
    for _ in range(4):  # at last nothing is left: nothing happens
        editor.undo()
    assert editor.document is start
    assert (editor.undo_label, editor.redo_label) == ("", "move to 1")
    for _ in range(4):
        editor.redo()
    assert editor.document.time == 3
    assert (editor.undo_label, editor.redo_label) == ("move to 3", "")


def test_changes_with_the_same_merge_key_are_one_step(editor):
    for time in (0.1, 0.2, 0.3):
        move(editor, time, "time")
    editor.undo()
    assert editor.document.time == 0
    editor.redo()
    assert editor.document.time == 0.3


@pytest.mark.parametrize("between", ["seal", "undo and redo", "another step"])
def test_what_happens_between_two_drags_keeps_them_apart(editor, between):
    editor.seal()  # nothing to seal yet
    move(editor, 0.1, "time")
    if between == "seal":
        editor.seal()
    elif between == "another step":
        editor.go_to(replace(editor.document, mask="coordinate:x"), "mask")
    else:
        editor.undo()
        editor.redo()
    left = editor.document
    move(editor, 0.2, "time")
    editor.undo()
    assert editor.document is left
    assert left.time == 0.1


def test_a_change_forgets_what_was_undone(editor):
    move(editor, 1)
    editor.undo()
    move(editor, 2)
    assert editor.redo_label == ""
    editor.redo()
    assert editor.document.time == 2


def test_amending_leaves_no_step_and_undo_steps_over_it(editor):
    start = editor.document
    move(editor, 1)
    editor.document = replace(editor.document, time=1.5)
    assert editor.moves == 1
    editor.undo()
    assert editor.document is start


def test_what_the_mouse_turned_stays_unless_a_step_chose_another_look(editor):
    front, side, above = (Look(Front(tuple(axis), (0.0, 0.0, 1.0))) for axis in np.eye(3))
    move(editor, 1)
    editor.document = look(editor, look=front, large="source")
    editor.undo()
    view = editor.document.view
    assert (editor.document.time, view.look, view.large) == (0, front, "source")
    editor.redo()
    editor.go_to(look(editor, look=side), "look from the side")
    editor.document = look(editor, look=above)
    editor.undo()
    assert editor.document.view.look == front
    editor.redo()
    assert editor.document.view.look == above
    ball = Document((Surface(EGG, "egg"),))
    editor.go_to(ball, "open egg")
    editor.undo()
    assert editor.document.view.look == above
    editor.redo()
    assert editor.document is ball


def test_only_the_latest_steps_are_kept(editor):
    for number in range(LONGEST + 10):
        move(editor, number + 1)
    for _ in range(LONGEST + 10):
        editor.undo()
    assert editor.document.time == 10
