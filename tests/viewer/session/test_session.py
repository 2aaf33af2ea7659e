"""The session without a window: what the user does, and what the frames show of it."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest

from abfm import FunctionError, Parameters
from abfm_viewer.document.document import Channel
from abfm_viewer.session.session import Session
from tests.shapes import torus
from tests.viewer.sessions import ENDLESS, PAIR, QUICK, SPHERE, matched, solving, until

TORUS = torus(24, 12)


# Functions


def test_a_new_mesh_gets_functions_to_match():
    session = Session(SPHERE, "sphere")
    try:
        assert "chosen" in session.obstacle
        session.match()
        assert not session.solver.running
        assert "chosen" in session.notices.latest.text
        until(lambda: not session.obstacle, session)
        assert (
            session.values("source").shape
            == session.values("target").shape
            == (len(SPHERE.vertices),)
        )
        assert (session.editor.history.undo_label, session.saves.unsaved) == ("", False)
    finally:
        session.close()


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
    until(lambda: not session.obstacle, session)


@pytest.mark.parametrize("mask", ["expression:0*x", "coordinate:x"])
def test_a_mask_without_a_meaning_stands_in_the_way(session, mask):
    session.editor.set_mask(mask)
    until(lambda: "computed" not in session.obstacle, session)
    assert session.obstacle == "the mask must not be negative, nor zero everywhere"
    session.editor.set_mask("expression:x*x")
    until(lambda: not session.obstacle, session)


def test_channels_without_weight_stand_in_the_way(session):
    session.editor.amend(channels=(replace(session.active, weight=0.0),))
    assert session.obstacle == "all channels have the weight 0"


def test_values_of_one_mesh_are_never_shown_on_another():
    session = Session(SPHERE, "sphere")
    try:
        coordinates = (Channel("coordinate:x", "coordinate:y"),)
        session.editor.change("start", channels=coordinates)
        until(lambda: not session.obstacle, session)
        session.set_mesh(TORUS, "torus")
        session.editor.change("same functions", channels=coordinates)
        for _ in range(100):
            session.update()
            values = session.values("source")
            assert values is None or len(values) == len(TORUS.vertices)
        until(lambda: not session.obstacle, session)
        for _ in range(2):
            session.undo()
        session.update()
        assert session.surface().mesh is SPHERE
        assert len(session.values("source")) == len(SPHERE.vertices)
    finally:
        session.close()


def test_a_mask_is_refused_or_found_wrong(session):
    with pytest.raises(FunctionError):
        session.editor.set_mask("no such family:")
    assert session.document.mask == ""
    session.editor.set_mask("indicator:vertex=100000,radius=1")
    until(lambda: session.error("mask"), session)
    assert session.obstacle


# Runs


def test_a_warm_start_goes_on_with_another_number_of_fields_and_another_tau(session):
    session.editor.set_parameter(method="linearised", segments=3)
    matched(session)
    linearised = session.result.mismatch
    session.editor.set_parameter(method="nonlinear", tau=3.0)
    assert session.parameters.segments == 1
    session.solver.warm = True
    matched(session)
    assert session.document.runs[-1].energies[0, 1] > 0
    assert session.result.mismatch < linearised


def test_match_during_a_run_does_nothing(endless):
    solving(endless)
    started = endless.solver.started
    endless.match()
    assert endless.solver.started == started


def test_a_change_during_a_run_restarts_it_warm(endless):
    solving(endless, 20)
    endless.editor.set_parameter(beta=1e-4)
    until(lambda: endless.solver.run.restarts, endless)
    until(lambda: len(endless.solver.run.stages) > endless.solver.run.restarts[0] + 3, endless)
    endless.solver.cancel()
    until(lambda: endless.solver.finished, endless)
    [run] = endless.document.runs
    assert run.energies[run.restarts[0], 1] > 0
    assert endless.result.parameters.beta == 1e-4
    assert not endless.outdated


def test_alpha_is_followed_when_the_mouse_lets_go(endless):
    solving(endless)
    endless.dragging = True
    for alpha in (0.1, 0.2, 0.4):
        endless.editor.set_parameter("alpha", alpha=alpha)
        endless.update()
    assert endless.solver.problem.parameters.alpha == ENDLESS.alpha
    endless.dragging = False
    endless.update()
    assert endless.solver.problem.parameters.alpha == 0.4


def test_dragging_a_gaussian_restarts_while_it_moves(endless):
    solving(endless)
    endless.dragging = True
    for number in range(60):
        endless.editor.set_spec("target", f"gaussian:x={number / 100},y=1,z=0,width=0.15", "drag")
        endless.update()
        time.sleep(0.01)
    assert len(endless.solver.run.restarts) > 1
    endless.dragging = False
    until(lambda: endless.solver.snapshot.problem == endless.problem, endless)
    endless.editor.history.seal()
    endless.undo()
    assert endless.active == PAIR  # one step


def test_the_result_for_a_mesh_that_was_replaced_is_dropped(endless):
    solving(endless)
    endless.set_mesh(TORUS, "torus")
    until(lambda: not endless.solver.running, endless)
    until(lambda: not endless.obstacle, endless)
    assert (endless.result, endless.document.runs, endless.solver.finished) == (None, (), False)
    endless.undo()
    endless.update()
    assert endless.surface().mesh is SPHERE
    assert endless.result is None


def test_undo_does_not_leave_a_mesh_that_is_being_matched(session):
    session.set_mesh(TORUS, "torus")
    session.editor.set_parameter(**ENDLESS.to_dict())
    until(lambda: not session.obstacle, session)
    solving(session)
    session.undo()
    session.undo()
    assert session.surface().mesh is TORUS
    assert "cancel the run first" in session.notices.latest.text
    session.solver.cancel()
    until(lambda: not session.solver.running, session)
    assert session.notices.cards == ()
    found = session.result
    for _ in range(2):
        session.undo()
    assert session.surface().mesh is SPHERE
    assert session.saves.unsaved_documents[-1].result is found


def test_a_run_that_fails_leaves_its_best_field(endless, monkeypatch):
    endless.editor.amend(parameters=replace(ENDLESS, levels=1))
    solving(endless)
    monkeypatch.setattr(endless.solver, "_yield_to_next", lambda: 1 / 0)
    until(lambda: endless.solver.finished, endless)
    assert endless.solver.failed
    assert "ZeroDivisionError" in endless.notices.cards[0].text
    result = endless.result
    assert result.velocity.any()
    np.testing.assert_allclose(result.advected, result.advect(result.parameters.tau), atol=1e-6)
    assert len(result.energy_history) == len(result.stages) > 1
    monkeypatch.undo()
    assert list(endless.notices.cards[0].remedies) == ["Continue", "Match again"]
    endless.notices.cards[0].remedies["Continue"]()
    assert endless.solver.running
    assert endless.notices.cards == ()


# What is shown


# Outdated


def test_what_makes_a_result_outdated_and_what_does_not(session):
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
        until(lambda: not session.obstacle, session)
        assert session.outdated
        session.undo()
        until(lambda: not session.obstacle, session)
        assert not session.outdated
    session.set_time(0.2)
    session.editor.set_view("darken", theme="dark")
    session.editor.set_spec("source", PAIR.source + " ")  # says the same
    until(lambda: not session.obstacle, session)
    assert not session.outdated


def test_a_masked_and_weighted_result_is_not_outdated(session):
    session.editor.set_mask("expression:1 + x * x")
    session.editor.set_weight(3.0)
    until(lambda: not session.obstacle, session)
    matched(session)
    assert not session.outdated
    session.editor.set_mask("")
    assert session.outdated


def test_asking_whether_a_result_is_outdated_costs_nothing_per_frame(session, monkeypatch):
    matched(session)
    assert not session.outdated
    compared = []
    monkeypatch.setattr(np, "array_equal", lambda *arrays: compared.append(arrays) or True)
    for _ in range(10):
        session.update()
        assert not session.outdated
    assert compared == []


# Parameters, undo, notices


def test_parameters_are_set_together_as_one_step(session):
    session.editor.set_parameter(label="preset", tau=2.0, alpha=1.0)
    assert session.editor.history.undo_label == "preset"
    session.editor.set_parameter(label="reset the parameters", **Parameters().to_dict())
    assert session.parameters == Parameters()
    session.undo()
    session.undo()
    assert session.parameters == QUICK


def test_notices_do_not_stay_forever(session, monkeypatch):
    now = [1000.0]
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])
    session.notices.say("saved\n here")
    assert session.notices.latest.text == "saved here"
    session.update()
    assert session.notices.latest.text
    now[0] += 7
    session.update()
    assert session.notices.latest.text == ""

    session.notices.say("it failed", is_error=True)
    now[0] += 7
    session.update()
    assert session.notices.latest.is_error
    now[0] += 6
    session.update()
    assert session.notices.latest.text == ""

    session.notices.say("it failed", is_error=True)
    session.editor.set_parameter(alpha=0.3)  # the next action
    session.update()
    assert session.notices.latest.text == ""


@pytest.mark.parametrize("factor", ["1e300", "1e-40"])
def test_functions_beyond_the_screens_precision_are_refused(session, factor):
    session.editor.set_spec("source", f"expression:{factor}*x")
    until(lambda: "scale it" in session.obstacle, session)
    session.undo()
    until(lambda: not session.obstacle, session)


def test_the_channels_that_are_left_can_be_matched(session):
    session.editor.add_channel()
    session.editor.select(channel=0)
    session.editor.set_weight(0)
    session.editor.select(channel=1)
    session.editor.remove_channel()
    assert [channel.weight for channel in session.channels] == [1]
    session.undo()
    assert [channel.weight for channel in session.channels] == [0, 1]
