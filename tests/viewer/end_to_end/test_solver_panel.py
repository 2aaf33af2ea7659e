"""Match, Pause, Resume, Cancel, and what a match came to, with remedies at one click."""

from dataclasses import replace

import pytest

import abfm
from abfm.matching import Remedy
from abfm.workers.control import present_control
from abfm_viewer.computing.match_apart import MatchApart
from tests.messages import check_message
from tests.viewer.sessions import ENDLESS, begin, cancel, match

WINDOW = (640, 480)  # in which no line of the verdict is cut


def test_match_runs_to_its_end_and_shows_the_result(gui):
    session = gui.session
    assert gui.is_enabled("Match")
    gui.click("Match")
    assert session.solver.running
    gui.wait(lambda s: s.solver.finished)
    assert session.result.residual <= 0.05
    assert session.time == session.parameters.tau
    assert not session.outdated
    assert len(session.document.runs) == 1
    assert [gui.is_enabled(label) for label in ("Match", "Pause", "Cancel")] == [True, False, False]


def test_pause_holds_the_run_and_resume_goes_on_by_button_and_key(running):
    solver = running.session.solver
    running.click("Pause")
    running.wait(lambda s: s.solver.paused)

    def stands_still(_=None):
        held = solver.snapshot
        for _ in range(8):
            running.window.frame()
        return solver.snapshot is held

    running.wait(stands_still)  # when the evaluation that was under way has ended
    assert stands_still()
    held = solver.snapshot
    running.click("Resume")
    running.wait(lambda s: s.solver.snapshot is not held)
    running.wait(lambda s: s.solver.snapshot.iteration.iteration > 5)
    cancel(running)
    assert solver.reason == running.session.result.stop_reason == "cancelled"
    assert len(running.session.result.energy_history) > 5
    assert running.is_enabled("Match")
    running.key("ctrl+enter")  # keys do the same
    assert solver.running
    running.key("p")
    assert solver.paused
    running.key("p")
    assert not solver.paused
    running.key("esc")
    running.wait(lambda s: s.solver.finished)
    assert solver.reason == "cancelled"


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
    running.drag("sigma", 0.1)
    running.drag("alpha", 1.0)
    running.wait(lambda s: s.solver.snapshot.problem.parameters.alpha == s.parameters.alpha > 0.5)
    assert running.session.solver.running
    cancel(running)
    assert running.session.result.parameters == running.session.parameters
    assert running.session.parameters.sigma == pytest.approx(0.1, rel=0.2)
    assert running.session.document.runs[-1].restarts


def test_without_restarts_a_changed_parameter_waits_for_the_next_match(running):
    running.check("Restart on changes", False)
    running.type("sigma", "0.015")
    running.frames(10)
    assert running.session.solver.problem.parameters.sigma != 0.015
    cancel(running)
    assert running.session.outdated


@pytest.mark.parametrize("text", ["expression:1/0*x", "file:missing.npy"])
def test_a_function_that_cannot_be_computed_does_not_end_the_run(running, text):
    solver = running.session.solver
    problem = solver.problem
    running.type("spec", text, within="source")
    running.wait(lambda s: s.error("source"))
    running.frames(5)
    assert solver.running
    assert solver.problem == problem
    cancel(running)
    assert not solver.failed, solver.reason


def test_the_next_match_can_start_from_the_current_field(matched):
    first = matched.session.result
    matched.check("Start from the current field")
    match(matched)
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


# The verdict


def set_far_pair(gui, width, **values):
    editor = gui.session.editor
    editor.set_spec("source", f"gaussian:x=0,y=0,z=1,width={width}")
    editor.set_spec("target", f"gaussian:x=0.5,y=0,z=-0.87,width={width}")
    editor.set_parameter(**values)
    gui.wait(lambda s: not s.obstacle)


def blindly(gui, **values):
    """A match of a far pair that looks for nothing far away."""
    set_far_pair(gui, 0.15, iterations=8, **values)
    match(gui)


def test_a_result_of_another_problem_says_so_and_offers_a_match(gui, notes):
    blindly(gui)
    assert not gui.session.outdated
    gui.session.editor.set_parameter(alpha=0.02)
    kinds = dict(notes())
    assert "Functions or parameters changed since." in kinds
    assert not {"good", "failure"} & set(kinds.values())
    assert not {"Continue", "More time"} & set(gui.labels())
    result = gui.session.result
    gui.click("Match again")
    gui.wait(lambda s: s.solver.finished)
    assert gui.session.result is not result
    assert gui.session.result.parameters.alpha == 0.02
    assert "Match again" not in gui.labels()


@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_a_long_verdict_wraps_as_a_whole(gui, notes, scale):
    blindly(gui, reach=0.0)
    gui.session.editor.set_view("scale", ui_scale=scale)
    result, words = gui.session.result, "so many words that no line has room for them " * 4
    long = replace(result.verdict, reason=f"the residual stayed: {words}")
    gui.session.editor.amend(result=replace(result, verdict=long))
    gui.frames(2)
    assert f"{words[:1].upper()}{words[1:]}." in dict(notes())


def test_a_source_that_is_squeezed_is_told_while_it_runs(gui, notes, monkeypatch):
    """In a run that is held where it is told; 150 iterations later it finds the target."""

    def held(apart, problem, on_iteration):
        def post(now):
            on_iteration(now)
            if now.iteration == 20:
                present_control().pause()

        return abfm.match(problem, on_iteration=post)

    monkeypatch.setattr(MatchApart, "match", held)
    set_far_pair(gui, 0.1, **(ENDLESS.to_dict() | {"max_displacement": 0.1}))
    begin(gui, 19)
    check_message(next(text for text, kind in notes() if kind == "failure"))
    cancel(gui)
    assert "failure" not in dict(notes()).values()
    assert any("cancelled" in text for text, kind in notes() if kind == "ink")
    remedies = [remedy.label for remedy in gui.session.result.verdict.remedies]
    assert remedies == ["Reach further", "Continue"]


def test_a_match_that_was_cancelled_goes_on_at_one_click(running):
    running.wait(lambda s: s.solver.snapshot.iteration.iteration > 3)
    cancel(running)
    left = running.session.result.residual
    running.click("Continue", within="verdict")
    running.wait(lambda s: s.solver.snapshot is not None)
    assert running.session.solver.snapshot.iteration.residual <= 1.01 * left


@pytest.mark.parametrize("is_changed", [False, True])
def test_a_match_that_was_cancelled_near_its_end_goes_on_too(gui, notes, is_changed):
    """Its field matches already, which is no reason to begin anew without a word."""
    session = gui.session
    match(gui)
    session.editor.amend(parameters=replace(ENDLESS, goal=0.1))  # also after a few iterations
    session.solver.warm = True
    gui.click("Match")
    gui.key("p")  # else it might end by itself
    gui.wait(lambda s: s.solver.snapshot is not None)
    gui.key("escape")
    gui.wait(lambda s: s.solver.finished)
    assert session.result.verdict.kind == "matched"
    session.solver.warm = False
    if is_changed:
        session.editor.set_parameter(alpha=1.1 * session.parameters.alpha)
    else:
        check_message(next(text for text in dict(notes()) if "Continue" in text))
    gui.click("Continue", within="verdict")
    gui.wait(lambda s: s.solver.snapshot is not None)
    assert session.solver.snapshot.iteration.residual < 0.5


@pytest.mark.parametrize(
    ("label", "parameters"),
    [
        ("More time", {"iterations": 60}),
        ("Smoother", {"alpha": 0.03, "sigma": 0.01}),
        ("Refine", {"refine": 1}),
        ("Match closer", {"sigma": 0.5}),
    ],
)
def test_a_remedy_is_a_button_that_changes_what_it_says_and_starts_a_run(gui, label, parameters):
    blindly(gui)
    result = gui.session.result
    verdict = replace(result.verdict, remedies=(Remedy(label, "so", parameters),))
    gui.session.editor.amend(result=replace(result, verdict=verdict))
    gui.frames(1)
    gui.click(label, within="verdict")
    assert gui.session.solver.running
    gui.wait(lambda s: s.solver.finished)
    assert gui.session.result.parameters == result.parameters.with_values(**parameters)


def test_a_match_that_changes_areas_much_offers_to_limit_the_distortion(gui):
    match(gui)
    session, found = gui.session, gui.session.result
    step = replace(found.path[found.step], log2_area=1.0, log2_area_95=2.0)
    path = (*found.path[: found.step], step, *found.path[found.step + 1 :])
    session.editor.amend(result=replace(found, path=path))
    before = session.result
    gui.click("Match", within="steps")
    gui.type("distortion", "0.01")
    gui.click("Limit distortion", "verdict")
    assert session.bound.busy
    gui.click("Stop limiting", "verdict")
    assert not session.bound.busy
    assert session.result is before
