"""The session without a window: what the user does, and what the frames show of it."""

import time
from dataclasses import replace

import numpy as np
import pytest

from abfm import FunctionError, Parameters
from abfm_viewer.document.document import Channel
from abfm_viewer.session.session import Session
from tests.shapes import torus
from tests.viewer.sessions import PAIR, QUICK, SPHERE, matched, until

TORUS = torus(24, 12)


@pytest.fixture
def fresh():
    """One that has no functions yet."""
    session = Session(SPHERE, "sphere")
    yield session
    session.close()


def ready(session):
    until(lambda: not session.obstacle, session)


def test_a_new_mesh_gets_functions_to_match(fresh):
    assert "chosen" in fresh.obstacle
    fresh.match()
    assert not fresh.solver.running
    assert "chosen" in fresh.notices.latest.text
    ready(fresh)
    assert {fresh.values(side).shape for side in ("source", "target")} == {(len(SPHERE.vertices),)}
    assert (fresh.editor.undo_label, fresh.saves.unsaved) == ("", False)


def test_functions_that_cannot_be_evaluated_stand_in_the_way(session):
    session.editor.set_spec("source", "gaussian:vertex=100000,width=0.1")
    assert "computed" in session.obstacle
    until(lambda: "computed" not in session.obstacle, session)
    assert "100000" in session.obstacle
    assert session.error("source") in session.obstacle
    session.match()
    assert not session.solver.running
    assert session.notices.latest.is_error
    session.undo()
    ready(session)
    session.editor.set_mask("indicator:vertex=100000,radius=1")
    until(lambda: session.error("mask"), session)
    assert session.obstacle
    with pytest.raises(FunctionError):
        session.editor.set_mask("no such family:")
    assert session.document.mask == "indicator:vertex=100000,radius=1"


@pytest.mark.parametrize("mask", ["expression:0*x", "coordinate:x"])
def test_a_mask_without_a_meaning_stands_in_the_way(session, mask):
    session.editor.set_mask(mask)
    until(lambda: "computed" not in session.obstacle, session)
    assert session.obstacle == "the mask must not be negative, nor zero everywhere"
    session.editor.set_mask("expression:x*x")
    ready(session)


@pytest.mark.parametrize("factor", ["1e300", "1e-40"])
def test_functions_beyond_the_screens_precision_are_refused(session, factor):
    session.editor.set_spec("source", f"expression:{factor}*x")
    until(lambda: "scale it" in session.obstacle, session)
    session.undo()
    ready(session)


def test_values_of_one_mesh_are_never_shown_on_another(fresh):
    coordinates = (Channel("coordinate:x", "coordinate:y"),)
    fresh.editor.change("start", channels=coordinates)
    ready(fresh)
    fresh.set_mesh(TORUS, "torus")
    fresh.editor.change("same functions", channels=coordinates)
    for _ in range(100):
        fresh.update()
        values = fresh.values("source")
        assert values is None or len(values) == len(TORUS.vertices)
    ready(fresh)
    for _ in range(2):
        fresh.undo()
    fresh.update()
    assert fresh.surface().mesh is SPHERE
    assert len(fresh.values("source")) == len(SPHERE.vertices)


def test_what_makes_a_result_outdated_and_what_does_not(session, monkeypatch):
    matched(session)
    for change in (
        lambda: session.editor.set_parameter(alpha=0.5),
        lambda: session.editor.set_spec("source", "coordinate:x"),
        lambda: session.editor.set_spec("target", "coordinate:x"),
        lambda: session.editor.set_weight(2.0),
        lambda: session.editor.set_mask("expression:x * x"),
        lambda: session.editor.duplicate_channel(),
        lambda: session.editor.swap_channel(),
    ):
        change()
        ready(session)
        assert session.outdated
        session.undo()
        ready(session)
        assert not session.outdated
    session.set_time(0.2)
    session.editor.set_view("darken", theme="dark")
    session.editor.set_spec("source", PAIR.source + " ")  # says the same
    ready(session)
    assert not session.outdated
    monkeypatch.setattr(np, "array_equal", lambda *_: pytest.fail("asking compares in each frame"))
    for _ in range(10):
        session.update()
        assert not session.outdated


def test_a_masked_and_weighted_result_is_not_outdated(session):
    session.editor.set_mask("expression:1 + x * x")
    session.editor.set_weight(3.0)
    ready(session)
    matched(session)
    assert not session.outdated
    session.editor.set_mask("")
    assert session.outdated


def test_parameters_are_set_together_as_one_step(session):
    session.editor.set_parameter(label="preset", tau=2.0, alpha=1.0)
    assert session.editor.undo_label == "preset"
    session.editor.reset_parameters()
    assert session.parameters == Parameters()
    session.undo()
    session.undo()
    assert session.parameters == QUICK


def test_notices_do_not_stay_forever(session, monkeypatch):
    now = [1000.0]
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])

    def after(seconds):
        now[0] += seconds
        session.update()
        return session.notices.latest

    session.notices.say("saved\n here")
    assert session.notices.latest.text == after(0).text == "saved here"
    assert after(7).text == ""
    session.notices.say("it failed", is_error=True)
    assert after(7).is_error
    assert after(6).text == ""
    session.notices.say("it failed", is_error=True)
    session.editor.set_parameter(alpha=0.3)  # the next action
    assert after(0).text == ""
    for number in range(1000):  # messages that nobody reads do not pile up
        session.notices.say(f"problem {number}", is_error=True)
    assert len(session.notices.cards) <= 50
    assert session.notices.cards[0].text == "problem 999"


def test_channels_without_weight_stand_in_the_way_but_those_that_are_left_have_some(session):
    session.editor.amend(channels=(replace(session.active, weight=0.0),))
    assert session.obstacle == "all channels have the weight 0"
    session.editor.amend(channels=(PAIR,))
    session.editor.add_channel()
    session.editor.select(channel=0)
    session.editor.set_weight(0)
    session.editor.select(channel=1)
    session.editor.remove_channel()
    assert [channel.weight for channel in session.channels] == [1]
    session.undo()
    assert [channel.weight for channel in session.channels] == [0, 1]
