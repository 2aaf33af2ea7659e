"""Tours of the panel of the solver: runs by button and key, and the verdict with its remedies."""

import re
from dataclasses import replace

import pytest

import abfm
from abfm.explanations import summary
from abfm.matching import Cause, Remedy
from abfm.workers.control import current_control
from abfm_viewer.computing.iterates import IteratePicture
from abfm_viewer.computing.run import Process
from abfm_viewer.panels.explanations import OUTCOME
from tests.messages import check_message
from tests.viewer.sessions import ENDLESS, SHORT, begin, cancel, match, restart

WINDOW = (640, 480)  # in which every line of the verdict is complete


def test_tour_of_runs(gui, walk):
    """Match, Pause, Resume, Cancel, restarts on changes, and both starts."""
    walk(gui, run_to_the_end)
    walk(gui, start_from_the_current_field, parameters=SHORT)
    walk(gui, pause_and_resume, restart_on_changes, parameters=ENDLESS)
    walk(gui, wait_without_restarts, scrub_during_a_run, parameters=ENDLESS)


def run_to_the_end(gui):
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


def start_from_the_current_field(gui):
    match(gui)
    first = gui.session.result
    start = first.energy_history[0, 2]
    finished = replace(first, verdict=replace(first.verdict, remedies=()))
    for result, label, is_continued in (
        (first, "Continue", True),
        (first, "Match from zero", False),
        (finished, "Match again", False),
        (finished, "Continue from the current field", True),
    ):
        gui.session.editor.amend(result=result)
        run_by_menu(gui, "start options", label)
        assert (gui.session.result.energy_history[0, 2] < 0.1 * start) == is_continued
    gui.session.editor.amend(result=finished)
    run_by_menu(gui, "Edit", "Match again")
    gui.session.editor.amend(result=finished)
    gui.key("ctrl+shift+enter")
    gui.wait(lambda s: s.solver.finished)
    assert gui.session.result.energy_history[0, 2] < 0.1 * start


def run_by_menu(gui, *labels):
    gui.frames(1)
    gui.menu(*labels)
    gui.wait(lambda s: s.solver.finished)


def pause_and_resume(gui, notes):
    """Pause and resume by buttons and keys, and continue from a cancelled run's best field."""
    begin(gui, 3)
    solver = gui.session.solver
    gui.click("Pause")
    assert solver.paused
    texts = "\n".join(text for text, _ in notes())
    assert re.search(r"^Match\b.*\nIteration \d+, residual .*\nMesh of \d+ vertices", texts, re.M)
    gui.click("Resume")
    assert not solver.paused
    gui.wait(lambda s: s.matching.snapshot.iteration.iteration > 5)
    cancel(gui)
    result = gui.session.result
    assert result.stop_reason == "cancelled"
    assert len(result.energy_history) > 5
    gui.click("Continue")
    gui.wait(lambda s: s.matching.snapshot is not None)
    assert gui.session.matching.snapshot.iteration.residual <= 1.01 * result.residual
    cancel(gui)
    gui.key("ctrl+enter")
    assert solver.running
    gui.wait(lambda s: s.matching.snapshot is not None)
    assert gui.session.matching.snapshot.iteration.residual <= 1.01 * result.residual
    gui.key("p")
    assert solver.paused
    gui.key("p")
    assert not solver.paused
    gui.key("esc")
    gui.wait(lambda s: s.solver.finished)
    assert gui.session.result.stop_reason == "cancelled"


def restart_on_changes(gui):
    """Change parameters while a run is paused and while it runs, which restarts it."""
    begin(gui, 3)
    gui.click("Pause")
    gui.type("sigma", "0.015")
    gui.click("Resume")
    gui.wait(lambda s: s.matching.snapshot.problem.parameters.sigma == 0.015)
    assert gui.session.matching.record.restarts
    gui.drag("sigma", 0.1)
    gui.drag("alpha", 1.0)
    gui.wait(lambda s: s.matching.snapshot.problem.parameters.alpha == s.parameters.alpha > 0.5)
    assert gui.session.solver.running
    cancel(gui)
    assert gui.session.result.parameters == gui.session.parameters
    assert gui.session.parameters.sigma == pytest.approx(0.1, rel=0.2)
    assert gui.session.document.runs[-1].restarts


def wait_without_restarts(gui):
    begin(gui, 3)
    gui.choose("during a run", "ignore changes")
    gui.type("sigma", "0.015")
    gui.frames(10)
    assert gui.session.matching.problem.parameters.sigma != 0.015
    cancel(gui)
    assert gui.session.outdated
    gui.choose("during a run", "follow changes")
    assert gui.session.matching.follow


def scrub_during_a_run(gui):
    begin(gui, 3)
    gui.drag("time", 0.4)
    assert gui.session.time == pytest.approx(0.4, abs=0.01)
    shown = gui.window.shown
    gui.wait(lambda _: shown.busy == "")
    before = shown.flow.advected().copy()
    gui.drag("time", 1.6)
    gui.wait(lambda _: abs(shown.flow.advected() - before).max() > 0.01)
    assert gui.session.solver.running


# The verdict


def long_range_pair(gui, width, **values):
    """Start a step with functions whose supports are disjoint."""
    restart(gui)
    editor = gui.session.editor
    editor.set_spec("source", f"gaussian:x=0,y=0,z=1,width={width}")
    editor.set_spec("target", f"gaussian:x=0.5,y=0,z=-0.87,width={width}")
    editor.set_parameter(**values)
    gui.wait(lambda s: not s.obstacle)


def test_tour_of_the_verdict(gui, walk):
    """The texts about results and runs are shown, and each of the buttons is used."""
    walk(gui, match_an_outdated_result_again)
    explain_the_verdict(gui)
    change_parameters_by_remedies(gui)
    walk(gui, report_a_squeezed_source, limit_the_distortion, continue_near_the_end)


def match_an_outdated_result_again(gui, notes):
    long_range_pair(gui, 0.15, iterations=8)
    match(gui)
    assert not gui.session.outdated
    gui.session.editor.set_parameter(alpha=0.02)
    kinds = dict(notes())
    assert any(text.startswith("Functions or parameters") for text in kinds)
    assert not {"good", "failure"} & set(kinds.values())
    assert "More time" not in gui.labels()
    result = gui.session.result
    gui.click("Match again")
    gui.wait(lambda s: s.solver.finished)
    assert gui.session.result is not result
    assert gui.session.result.parameters.alpha == 0.02


def explain_the_verdict(gui):
    """Show the sections about the verdict in a dialog."""
    session = gui.session
    verdict = replace(session.result.verdict, cause=Cause.SOURCE_UNMOVED)
    session.editor.amend(result=replace(session.result, verdict=verdict))
    gui.frames(2)
    for name, topic in {OUTCOME: "source unmoved", "Explain residuals": "residual"}.items():
        gui.click(name)
        shown = gui.window.dialogs._open[-1][0]
        assert shown.title == "Explanation"
        assert shown.lines[0] == (topic.capitalize(), "")
        assert shown.lines[1].startswith(summary(topic))
        gui.click("Close")


def change_parameters_by_remedies(gui):
    """Press each remedy, which changes its parameters and starts a run."""
    result = gui.session.result
    for label, parameters in {
        "Reach further": {"reach": 0.5},
        "More time": {"iterations": 60},
        "Smoother": {"alpha": 0.03, "sigma": 0.01},
        "Less smooth": {"alpha": 0.01},
        "Refine": {"refine": 1},
        "Match closer": {"sigma": 0.5},
    }.items():
        verdict = replace(result.verdict, remedies=(Remedy(label, "so", parameters),))
        offered = replace(result, verdict=verdict)
        gui.session.editor.amend(result=offered, parameters=result.parameters)
        gui.frames(1)
        gui.click(label, within="verdict")
        assert gui.session.solver.running
        assert gui.session.parameters == result.parameters.with_values(**parameters)
        gui.session.solver.cancel()  # the run may have ended by now
        gui.wait(lambda s: not s.solver.running)


def report_a_squeezed_source(gui, notes, monkeypatch):
    """Show the report of a squeezed source in a run, which later finds the target."""

    def held(process, function, number, task, on_partial, tries):
        def post(now):
            on_partial(replace(now, view=IteratePicture(now.warning, now.advected)))
            if now.iteration == 20:
                current_control().pause()

        return abfm.match(task.problem, on_iteration=post)

    monkeypatch.setattr(Process, "solve", held)
    long_range_pair(gui, 0.1, **(ENDLESS.to_dict() | {"max_displacement": 0.1}))
    begin(gui, 19)
    check_message(next(text for text, kind in notes() if kind == "failure"))
    cancel(gui)
    assert "failure" not in dict(notes()).values()
    assert any("cancelled" in text for text, kind in notes() if kind == "ink")
    remedies = [remedy.label for remedy in gui.session.result.verdict.remedies]
    assert remedies == ["Reach further", "Continue"]


def limit_the_distortion(gui):
    """Use the limit that is offered after a match that changes areas much."""
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


def continue_near_the_end(gui):
    """Continue from the field of a cancelled match that already matches."""
    session, document = gui.session, gui.session.document
    for is_changed in (False, True):
        restart(gui, document)
        match(gui)
        session.editor.amend(parameters=replace(ENDLESS, goal=0.1))  # reached after few iterations
        gui.menu("start options", "Continue from the current field")
        gui.key("p")  # otherwise it might end by itself
        gui.wait(lambda s: s.matching.snapshot is not None)
        gui.key("escape")
        gui.wait(lambda s: s.solver.finished)
        assert session.result.verdict.kind == "matched"
        if is_changed:
            session.editor.set_parameter(alpha=1.1 * session.parameters.alpha)
            gui.menu("start options", "Continue from the current field")
        else:
            gui.menu("Edit", "Continue")
        gui.wait(lambda s: s.matching.snapshot is not None)
        assert session.matching.snapshot.iteration.residual < 0.5
