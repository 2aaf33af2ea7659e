"""Match, Pause, Resume, Cancel, and what happens to a run when something changes."""

from __future__ import annotations

import pytest


def test_match_runs_to_its_end_and_shows_the_result(gui):
    assert gui.is_enabled("Match")
    gui.click("Match")
    assert gui.session.solver.running
    gui.wait(lambda s: s.solver.finished)
    session = gui.session
    assert session.result.mismatch < 0.05
    assert session.time == session.parameters.tau
    assert not session.outdated
    assert len(session.document.runs) == 1
    assert gui.is_enabled("Match")
    assert not gui.is_enabled("Pause")
    assert not gui.is_enabled("Cancel")


def test_pause_holds_the_run_and_resume_goes_on(running):
    running.click("Pause")
    running.wait(lambda s: s.solver.paused)
    for _ in range(15):  # half a second, in which the evaluation that was under way ends
        running.window.frame()
    held = running.session.solver.snapshot
    running.frames(10)
    assert running.session.solver.snapshot is held
    running.click("Resume")
    running.wait(lambda s: s.solver.snapshot is not held)
    running.click("Cancel")
    running.wait(lambda s: s.solver.finished)
    assert running.session.solver.reason == "cancelled"


def test_cancel_keeps_the_best_field(running):
    running.wait(lambda s: s.solver.snapshot.iteration.iteration > 5)
    running.click("Cancel")
    running.wait(lambda s: s.solver.finished)
    result = running.session.result
    assert result.stop_reason == "cancelled"
    assert len(result.energy_history) > 5
    assert running.is_enabled("Match")


def test_keys_do_the_same(gui, running):
    gui.key("p")
    assert gui.session.solver.paused
    gui.key("p")
    assert not gui.session.solver.paused
    gui.key("esc")
    gui.wait(lambda s: s.solver.finished)
    assert gui.session.solver.reason == "cancelled"
    gui.key("ctrl+enter")
    assert gui.session.solver.running


@pytest.mark.parametrize("paused", [False, True])
def test_a_changed_parameter_restarts_the_run_from_its_field(running, paused):
    running.wait(lambda s: s.solver.snapshot.iteration.iteration > 3)
    if paused:
        running.click("Pause")
    running.type("sigma", "0.015")
    if paused:
        running.click("Resume")
    running.wait(lambda s: s.solver.snapshot.problem.parameters.sigma == 0.015)
    assert running.session.solver.run.restarts
    running.drag("alpha", 1.0)
    running.wait(lambda s: s.solver.snapshot.problem.parameters.alpha == s.parameters.alpha > 0.5)
    assert running.session.solver.running


def test_without_restarts_a_changed_parameter_waits_for_the_next_match(running):
    running.check("Restart on changes", False)
    running.type("sigma", "0.015")
    running.frames(10)
    assert running.session.solver.problem.parameters.sigma != 0.015
    running.click("Cancel")
    running.wait(lambda s: s.solver.finished)
    assert running.session.outdated


@pytest.mark.parametrize("text", ["expression:1/0*x", "file:missing.npy"])
def test_a_function_that_cannot_be_computed_does_not_end_the_run(running, text):
    running.wait(lambda s: s.solver.snapshot is not None)
    problem = running.session.solver.problem
    running.type("spec", text, within="source")
    running.wait(lambda s: s.error("source"))
    running.frames(5)
    assert running.session.solver.running
    assert running.session.solver.problem == problem
    running.click("Cancel")
    running.wait(lambda s: s.solver.finished)
    assert not running.session.solver.failed, running.session.solver.reason


def test_the_next_match_can_start_from_the_current_field(matched):
    first = matched.session.result
    matched.check("Start from the current field")
    matched.click("Match")
    matched.wait(lambda s: s.solver.finished)
    again = matched.session.result
    assert again is not first
    assert again.energy_history[0, 2] < 0.1 * first.energy_history[0, 2]


def test_scrubbing_and_dragging_go_on_during_a_run(running):
    running.drag("time", 0.4)
    assert running.session.time == pytest.approx(0.4, abs=0.01)
    shown = running.window.shown
    running.wait(lambda _: shown.busy == "")
    before = shown.flow.advected().copy()
    running.drag("time", 1.6)
    running.wait(lambda _: abs(shown.flow.advected() - before).max() > 0.01)
    assert running.session.solver.running
