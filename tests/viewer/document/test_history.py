"""Undo and redo."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from abfm_viewer.document.document import Document, Front, Look, Surface
from abfm_viewer.document.history import LONGEST, History
from tests.viewer.sessions import EGG, SPHERE


def at(history: History, time: float) -> Document:
    return replace(history.document, time=time)


def test_undo_goes_back_to_the_very_start_and_redo_to_the_end():
    start = Document((Surface(SPHERE, "sphere"),))
    history = History(start)
    for time in (1.0, 2.0, 3.0):
        history.change(at(history, time), f"move to {time:g}")
    assert history.undo_label == "move to 3"
    for _ in range(3):
        history.undo()
    assert history.document is start
    assert (history.undo_label, history.redo_label) == ("", "move to 1")
    history.undo()  # nothing left: nothing happens
    assert history.document is start
    for _ in range(4):
        history.redo()
    assert history.document.time == 3
    assert (history.undo_label, history.redo_label) == ("move to 3", "")


def test_changes_with_the_same_merge_key_are_one_step():
    history = History(Document((Surface(SPHERE, "sphere"),)))
    for time in (0.1, 0.2, 0.3):
        history.change(at(history, time), "scrub", "time")
    history.undo()
    assert history.document.time == 0
    history.redo()
    assert history.document.time == 0.3


def test_a_sealed_step_takes_nothing_more_in():
    history = History(Document((Surface(SPHERE, "sphere"),)))
    history.seal()  # nothing to seal yet
    history.change(at(history, 0.1), "scrub", "time")
    history.seal()
    history.change(at(history, 0.2), "scrub", "time")
    history.undo()
    assert history.document.time == 0.1


def test_steps_of_different_kinds_between_keep_drags_apart():
    history = History(Document((Surface(SPHERE, "sphere"),)))
    history.change(at(history, 0.1), "scrub", "time")
    history.change(replace(history.document, mask="coordinate:x"), "mask")
    history.change(at(history, 0.2), "scrub", "time")
    history.undo()
    assert (history.document.time, history.document.mask) == (0.1, "coordinate:x")


def test_after_undo_a_drag_is_a_step_of_its_own():
    history = History(Document((Surface(SPHERE, "sphere"),)))
    history.change(at(history, 0.1), "scrub", "time")
    history.undo()
    history.redo()
    history.change(at(history, 0.2), "scrub", "time")
    history.undo()
    assert history.document.time == 0.1


def test_a_change_forgets_what_was_undone():
    history = History(Document((Surface(SPHERE, "sphere"),)))
    history.change(at(history, 1), "one")
    history.undo()
    history.change(at(history, 2), "two")
    assert history.redo_label == ""
    history.redo()
    assert history.document.time == 2


def test_amending_leaves_no_step_and_undo_steps_over_it():
    start = Document((Surface(SPHERE, "sphere"),))
    history = History(start)
    history.change(at(history, 1), "one")
    history.document = at(history, 1.5)
    assert history.moves == 1
    history.undo()
    assert history.document is start


def test_what_the_mouse_turned_stays_unless_a_step_chose_another_look():
    front, side, above = (
        Look(Front((float(x), float(y), float(z)), (0.0, 0.0, 1.0))) for x, y, z in np.eye(3)
    )
    history = History(Document((Surface(SPHERE, "sphere"),)))
    history.change(at(history, 1), "move")
    history.document = replace(
        history.document, view=replace(history.document.view, look=front, large="source")
    )
    history.undo()
    assert (history.document.time, history.document.view.look, history.document.view.large) == (
        0,
        front,
        "source",
    )
    history.redo()
    history.change(
        replace(history.document, view=replace(history.document.view, look=side)),
        "look from the side",
    )
    history.document = replace(history.document, view=replace(history.document.view, look=above))
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


def test_only_the_latest_steps_are_kept():
    history = History(Document((Surface(SPHERE, "sphere"),)))
    for number in range(LONGEST + 10):
        history.change(at(history, number + 1), "step")
    for _ in range(LONGEST + 10):
        history.undo()
    assert history.document.time == 10
