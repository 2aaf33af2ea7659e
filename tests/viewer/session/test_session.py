"""The session without a window: what the user does, and what the frames show of it."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest

import abfm
from abfm import FunctionError, ParameterError, Parameters
from abfm_viewer.document.document import Channel
from abfm_viewer.session.notices import Notice
from abfm_viewer.session.session import Session
from tests.shapes import torus
from tests.viewer.sessions import ENDLESS, PAIR, QUICK, SPHERE, matched, opened, solving, until

TORUS = torus(24, 12)


# Functions


def test_a_new_mesh_gets_functions_to_match():
    session = Session(SPHERE, "sphere")
    try:
        assert "chosen" in session.obstacle
        session.match()
        assert not session.solver.running
        assert "chosen" in session.notice.text
        until(lambda: not session.obstacle, session)
        assert session.values("source").shape == session.values("target").shape == (len(SPHERE.vertices),)
        assert (session.history.undo_label, session.unsaved) == ("", False)
    finally:
        session.close()


def test_functions_that_cannot_be_evaluated_stand_in_the_way(session):
    session.set_spec("source", "gaussian:vertex=100000,width=0.1")
    assert "computed" in session.obstacle
    until(lambda: "computed" not in session.obstacle, session)
    assert "100000" in session.obstacle
    assert session.error(session.active.source) in session.obstacle
    session.match()
    assert not session.solver.running
    assert session.notice.is_error
    session.undo()
    until(lambda: not session.obstacle, session)


@pytest.mark.parametrize("mask", ["expression:0*x", "coordinate:x"])
def test_a_mask_without_a_meaning_stands_in_the_way(session, mask):
    session.set_mask(mask)
    until(lambda: "computed" not in session.obstacle, session)
    assert session.obstacle == "the mask must not be negative, nor zero everywhere"
    session.set_mask("expression:x*x")
    until(lambda: not session.obstacle, session)


def test_channels_without_weight_stand_in_the_way(session):
    session.amend(channels=(replace(session.active, weight=0.0),))
    assert session.obstacle == "all channels have the weight 0"


def test_values_of_one_mesh_are_never_shown_on_another():
    session = Session(SPHERE, "sphere")
    try:
        coordinates = (Channel("coordinate:x", "coordinate:y"),)
        session.change("start", channels=coordinates)
        until(lambda: not session.obstacle, session)
        session.set_mesh(TORUS, "torus")
        session.change("same functions", channels=coordinates)
        for _ in range(100):
            session.update()
            values = session.values("source")
            assert values is None or len(values) == len(TORUS.vertices)
        until(lambda: not session.obstacle, session)
        for _ in range(2):
            session.undo()
        session.update()
        assert session.mesh is SPHERE
        assert len(session.values("source")) == len(SPHERE.vertices)
    finally:
        session.close()


def test_a_mask_is_refused_or_found_wrong(session):
    with pytest.raises(FunctionError):
        session.set_mask("no such family:")
    assert session.document.mask == ""
    session.set_mask("indicator:vertex=100000,radius=1")
    until(lambda: session.error(session.document.mask), session)
    assert session.obstacle


# Runs


def test_match_shows_the_end_of_the_flow(session):
    session.set_time(0.4)
    session.match()
    assert session.time == 1
    assert session.history.undo_label == "move in time"  # moving to the end is not a step
    until(lambda: session.solver.finished, session)
    assert session.solver.reason == session.result.stop_reason
    assert len(session.document.runs) == 1
    assert not session.outdated
    assert session.history.undo_label == "match"


def test_a_second_run_starts_where_the_first_ended_if_asked_to(session):
    matched(session)
    end = session.document.runs[-1].energies[-1]
    session.solver.warm = True
    matched(session)
    start = session.document.runs[-1].energies[0]
    assert start[1] == pytest.approx(end[1], rel=0.2)  # the last iterate need not be the best
    session.solver.warm = False
    matched(session)
    assert session.document.runs[-1].energies[0, 1] == 0
    assert len(session.document.runs) == 3


def test_a_warm_start_goes_on_with_another_number_of_fields_and_another_tau(session):
    session.set_parameter(method="linearised", segments=3)
    matched(session)
    linearised = session.result.mismatch
    session.set_parameter(method="nonlinear", tau=3.0)
    assert session.parameters.segments == 1
    session.solver.warm = True
    matched(session)
    assert session.document.runs[-1].energies[0, 1] > 0
    assert session.result.mismatch < linearised


def test_pause_resume_and_cancel(endless):
    solving(endless)
    endless.solver.pause()
    time.sleep(0.1)
    rows = len(endless.solver.run.stages)
    for _ in range(10):
        endless.update()
    assert len(endless.solver.run.stages) == rows
    endless.solver.resume()
    until(lambda: len(endless.solver.run.stages) > rows + 5, endless)
    endless.solver.cancel()
    until(lambda: endless.solver.finished, endless)
    assert (endless.result.stop_reason, endless.solver.failed) == ("cancelled", False)
    assert len(endless.document.runs[0].stages) == len(endless.result.energy_history)


def test_match_during_a_run_does_nothing(endless):
    solving(endless)
    started = endless.solver.started
    endless.match()
    assert endless.solver.started == started


def test_a_change_during_a_run_restarts_it_warm(endless):
    solving(endless, 20)
    endless.set_parameter(beta=1e-4)
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
        endless.set_parameter("alpha", alpha=alpha)
        endless.update()
    assert endless.solver.problem.parameters.alpha == ENDLESS.alpha
    endless.dragging = False
    endless.update()
    assert endless.solver.problem.parameters.alpha == 0.4


def test_dragging_a_gaussian_restarts_while_it_moves(endless):
    solving(endless)
    endless.dragging = True
    for number in range(60):
        endless.set_spec("target", f"gaussian:x={number / 100},y=1,z=0,width=0.15", "drag")
        endless.update()
        time.sleep(0.01)
    assert len(endless.solver.run.restarts) > 1
    endless.dragging = False
    until(lambda: endless.solver.snapshot.problem == endless.problem, endless)
    endless.history.seal()
    endless.undo()
    assert endless.active == PAIR  # one step


def test_a_function_that_fails_during_a_run_does_not_end_it(endless):
    solving(endless)
    endless.set_spec("source", "gaussian:vertex=100000,width=0.1")
    until(lambda: "100000" in endless.obstacle, endless)
    rows = len(endless.solver.run.stages)
    until(lambda: len(endless.solver.run.stages) > rows + 5, endless)
    endless.undo()
    until(lambda: not endless.obstacle, endless)
    assert endless.solver.running
    assert endless.solver.run.restarts == ()


def test_an_error_in_the_solver_is_shown_and_the_next_run_works(session, monkeypatch, capsys):
    def broken(*args, **kwargs):
        raise RuntimeError("boom")

    with monkeypatch.context() as patch:
        patch.setattr(abfm, "match", broken)
        matched(session)
    assert (session.solver.failed, session.solver.reason) == (True, "RuntimeError: boom")
    assert session.notice == Notice("the solver stopped: RuntimeError: boom", True)
    assert session.result is None
    assert "boom" in capsys.readouterr().err
    matched(session)
    assert not session.solver.failed
    assert session.result is not None


def test_the_result_for_a_mesh_that_was_replaced_is_dropped(endless):
    solving(endless)
    endless.set_mesh(TORUS, "torus")
    until(lambda: not endless.solver.running, endless)
    until(lambda: not endless.obstacle, endless)
    assert (endless.result, endless.document.runs, endless.solver.finished) == (None, (), False)
    endless.undo()
    endless.update()
    assert endless.mesh is SPHERE
    assert endless.result is None


def test_undo_does_not_leave_a_mesh_that_is_being_matched(session):
    session.set_mesh(TORUS, "torus")
    session.set_parameter(**ENDLESS.to_dict())
    until(lambda: not session.obstacle, session)
    solving(session)
    session.undo()
    session.undo()
    assert session.mesh is TORUS
    assert "cancel the run first" in session.notice.text
    session.solver.cancel()
    until(lambda: not session.solver.running, session)
    assert session.cards == ()
    found = session.result
    for _ in range(2):
        session.undo()
    assert session.mesh is SPHERE
    assert session.unsaved_documents[-1].result is found


def test_a_run_that_fails_leaves_its_best_field(endless, monkeypatch):
    endless.amend(parameters=replace(ENDLESS, levels=1))
    solving(endless)
    monkeypatch.setattr(endless.solver, "_yield_to_next", lambda: 1 / 0)
    until(lambda: endless.solver.finished, endless)
    assert endless.solver.failed
    assert "ZeroDivisionError" in endless.cards[0].text
    result = endless.result
    assert result.velocity.any()
    np.testing.assert_allclose(result.advected, result.advect(result.parameters.tau), atol=1e-6)
    assert len(result.energy_history) == len(result.stages) > 1
    monkeypatch.undo()
    assert list(endless.cards[0].remedies) == ["Continue", "Match again"]
    endless.cards[0].remedies["Continue"]()
    assert endless.solver.running
    assert endless.cards == ()


# What is shown


def test_playing_moves_the_time_and_is_no_step(session):
    session.player.toggle()
    until(lambda: session.time > 0.01, session)
    assert session.history.undo_label == ""
    session.undo()
    assert not session.player.playing


# Outdated


def test_what_makes_a_result_outdated_and_what_does_not(session):
    matched(session)
    for change in (
        lambda: session.set_parameter(alpha=0.5),
        lambda: session.set_spec("source", "coordinate:x"),
        lambda: session.set_spec("target", "coordinate:x"),
        lambda: session.set_weight(2.0),
        lambda: session.set_mask("expression:x * x"),
        lambda: session.duplicate_channel(),
        lambda: session.swap_channel(),
    ):
        change()
        until(lambda: not session.obstacle, session)
        assert session.outdated
        session.undo()
        until(lambda: not session.obstacle, session)
        assert not session.outdated
    session.set_time(0.2)
    session.set_view("darken", theme="dark")
    session.set_spec("source", PAIR.source + " ")  # says the same
    until(lambda: not session.obstacle, session)
    assert not session.outdated


def test_a_masked_and_weighted_result_is_not_outdated(session):
    session.set_mask("expression:1 + x * x")
    session.set_weight(3.0)
    until(lambda: not session.obstacle, session)
    matched(session)
    assert not session.outdated
    session.set_mask("")
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


def test_a_refused_parameter_changes_nothing(session):
    before = session.document
    with pytest.raises(ParameterError, match="alpha is -1"):
        session.set_parameter(alpha=-1)
    with pytest.raises(ParameterError, match="whole"):
        session.set_parameter(segments=2.5)
    assert session.document is before


def test_parameters_are_set_together_as_one_step(session):
    session.set_parameter(label="preset", tau=2.0, alpha=1.0)
    assert session.history.undo_label == "preset"
    session.set_parameter(label="reset the parameters", **Parameters().to_dict())
    assert session.parameters == Parameters()
    session.undo()
    session.undo()
    assert session.parameters == QUICK


def test_undo_goes_back_over_everything_to_the_start():
    session = opened()
    try:
        start = session.document
        session.set_parameter(alpha=0.5)
        session.set_spec("source", "coordinate:x")
        session.add_channel()
        session.set_mask("coordinate:x")
        session.set_mask("")
        session.set_view("dark", theme="dark")
        until(lambda: not session.obstacle, session)
        matched(session)
        session.set_time(0.3)
        end = session.document
        while session.history.undo_label:
            session.undo()
            session.update()
        assert session.document is start
        while session.history.redo_label:
            session.redo()
        assert session.document is end
    finally:
        session.close()


def test_notices_do_not_stay_forever(session, monkeypatch):
    now = [1000.0]
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])
    session.say("saved\n here")
    assert session.notice.text == "saved here"
    session.update()
    assert session.notice.text
    now[0] += 7
    session.update()
    assert session.notice.text == ""

    session.say("it failed", is_error=True)
    now[0] += 7
    session.update()
    assert session.notice.is_error
    now[0] += 6
    session.update()
    assert session.notice.text == ""

    session.say("it failed", is_error=True)
    session.set_parameter(alpha=0.3)  # the next action
    session.update()
    assert session.notice.text == ""


@pytest.mark.parametrize("factor", ["1e300", "1e-40"])
def test_functions_beyond_the_screens_precision_are_refused(session, factor):
    session.set_spec("source", f"expression:{factor}*x")
    until(lambda: "scale it" in session.obstacle, session)
    session.undo()
    until(lambda: not session.obstacle, session)


def test_the_channels_that_are_left_can_be_matched(session):
    session.add_channel()
    session.select(channel=0)
    session.set_weight(0)
    session.select(channel=1)
    session.remove_channel()
    assert [channel.weight for channel in session.channels] == [1]
    session.undo()
    assert [channel.weight for channel in session.channels] == [0, 1]
