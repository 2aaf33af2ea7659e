"""Undo and redo."""

from dataclasses import replace

import numpy as np
import pytest

from abfm_viewer.document.document import Document, Front, Look, Surface
from abfm_viewer.document.history import LONGEST, History
from tests.viewer.sessions import EGG, SPHERE


@pytest.fixture
def history():
    return History(Document((Surface(SPHERE, "sphere"),)))


def move(history, time, merge="", label="move"):
    history.change(replace(history.document, time=time), label, merge)


def look(history, **view):
    return replace(history.document, view=replace(history.document.view, **view))


def test_undo_goes_back_to_the_very_start_and_redo_to_the_end(history):
    start = history.document
    for time in (1.0, 2.0, 3.0):
        move(history, time, label=f"move to {time:g}")
    assert history.undo_label == "move to 3"
    for _ in range(4):  # at last nothing is left: nothing happens
        history.undo()
    assert history.document is start
    assert (history.undo_label, history.redo_label) == ("", "move to 1")
    for _ in range(4):
        history.redo()
    assert history.document.time == 3
    assert (history.undo_label, history.redo_label) == ("move to 3", "")


def test_changes_with_the_same_merge_key_are_one_step(history):
    for time in (0.1, 0.2, 0.3):
        move(history, time, "time")
    history.undo()
    assert history.document.time == 0
    history.redo()
    assert history.document.time == 0.3


@pytest.mark.parametrize("between", ["seal", "undo and redo", "another step"])
def test_what_happens_between_two_drags_keeps_them_apart(history, between):
    history.seal()  # nothing to seal yet
    move(history, 0.1, "time")
    if between == "seal":
        history.seal()
    elif between == "another step":
        history.change(replace(history.document, mask="coordinate:x"), "mask")
    else:
        history.undo()
        history.redo()
    left = history.document
    move(history, 0.2, "time")
    history.undo()
    assert history.document is left
    assert left.time == 0.1


def test_a_change_forgets_what_was_undone(history):
    move(history, 1)
    history.undo()
    move(history, 2)
    assert history.redo_label == ""
    history.redo()
    assert history.document.time == 2


def test_amending_leaves_no_step_and_undo_steps_over_it(history):
    start = history.document
    move(history, 1)
    history.document = replace(history.document, time=1.5)
    assert history.moves == 1
    history.undo()
    assert history.document is start


def test_what_the_mouse_turned_stays_unless_a_step_chose_another_look(history):
    front, side, above = (Look(Front(tuple(axis), (0.0, 0.0, 1.0))) for axis in np.eye(3))
    move(history, 1)
    history.document = look(history, look=front, large="source")
    history.undo()
    view = history.document.view
    assert (history.document.time, view.look, view.large) == (0, front, "source")
    history.redo()
    history.change(look(history, look=side), "look from the side")
    history.document = look(history, look=above)
    history.undo()
    assert history.document.view.look == front
    history.redo()
    assert history.document.view.look == above
    ball = Document((Surface(EGG, "egg"),))
    history.change(ball, "open egg")
    history.undo()
    assert history.document.view.look == above
    history.redo()
    assert history.document is ball


def test_only_the_latest_steps_are_kept(history):
    for number in range(LONGEST + 10):
        move(history, number + 1)
    for _ in range(LONGEST + 10):
        history.undo()
    assert history.document.time == 10
