"""What a match came to, in the panel: how well, why, and remedies at one click."""

from __future__ import annotations

from dataclasses import replace

import pytest

import abfm
from abfm.matching import Remedy
from abfm.workers.control import present_control
from abfm_viewer.computing.match_apart import MatchApart
from abfm_viewer.panels.right_panel import STEPS
from tests.viewer.sessions import ENDLESS

WINDOW = (640, 480)  # in which no line of the verdict is cut
FAR = ("gaussian:x=0,y=0,z=1,width=0.15", "gaussian:x=0.5,y=0,z=-0.87,width=0.15")
BLIND = ENDLESS.to_dict() | {"max_displacement": 0.1}
"""Parameters with which nothing leads a source to a target that it does not touch at first."""


@pytest.fixture
def texts(gui, monkeypatch):
    """What the panel says with its colours, in a frame."""
    said = []
    note = type(gui.window.ui).note

    def heard(ui, text, kind="muted"):
        said.append((text, kind))
        note(ui, text, kind)

    monkeypatch.setattr(type(gui.window.ui), "note", heard)

    def now():
        said.clear()
        gui.frames(1)
        return list(said)

    return now


def blindly(gui, **values):
    """A match of a far pair that looks for nothing far away."""
    gui.session.editor.set_spec("source", FAR[0])
    gui.session.editor.set_spec("target", FAR[1])
    gui.session.editor.set_parameter(**values)
    gui.wait(lambda s: not s.obstacle)
    gui.click("Match")
    gui.wait(lambda s: s.solver.finished)


def test_a_result_of_another_problem_says_so_and_offers_a_match(gui, texts):
    blindly(gui, iterations=8)
    assert not gui.session.outdated
    gui.session.editor.set_parameter(alpha=0.02)
    kinds = dict(texts())
    assert "Functions or parameters changed since." in kinds
    assert not {"good", "failure"} & set(kinds.values())
    assert not any(button in gui.labels() for button in ("Continue", "More time"))
    result = gui.session.result
    gui.click("Match again")
    gui.wait(lambda s: s.solver.finished)
    assert gui.session.result is not result
    assert gui.session.result.parameters.alpha == 0.02
    assert "Match again" not in gui.labels()


@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_nothing_below_moves_whatever_the_header_says(gui, scale):
    gui.session.editor.set_view("scale", ui_scale=scale)

    def below():
        gui.frames(2)
        [tab] = [
            widget
            for widget in gui.window.ui.widgets
            if widget.section == STEPS and widget.label == "Look"
        ]
        return tab.rect

    place = below()
    blindly(gui, reach=0.0, iterations=8)
    assert below() == place
    gui.session.editor.set_parameter(alpha=0.02)
    assert below() == place
    gui.session.editor.set_parameter(iterations=100_000, tolerance=0.0, reach=1.0)
    gui.click("Match")
    gui.wait(lambda s: s.solver.snapshot is not None)
    assert below() == place


def test_texts_without_room_are_cut_and_hovering_shows_them(gui, monkeypatch):
    blindly(gui, reach=0.0, iterations=8)
    result = gui.session.result
    long = replace(
        result.verdict,
        reason="the mismatch stayed: " + "so many words that no panel has room for them " * 4,
    )
    gui.session.editor.amend(result=replace(result, verdict=long))
    tips = []
    monkeypatch.setattr(type(gui.window.ui), "tip", lambda ui, text, **_: tips.append(text))
    gui.frames(1)
    assert any(tip.startswith("So many words") and tip.endswith("for them .") for tip in tips)


def test_a_source_that_is_squeezed_is_told_while_it_runs(gui, texts, monkeypatch):
    """In a run that is held where it is told; 150 iterations later it finds the target."""

    def held(apart, problem, on_iteration):
        def post(now):
            on_iteration(now)
            if now.iteration == 20:
                present_control().pause()

        return abfm.match(problem, on_iteration=post)

    monkeypatch.setattr(MatchApart, "match", held)
    gui.session.editor.set_spec("source", "gaussian:x=0,y=0,z=1,width=0.1")
    gui.session.editor.set_spec("target", "gaussian:x=0.5,y=0,z=-0.87,width=0.1")
    gui.session.editor.set_parameter(**BLIND)
    gui.wait(lambda s: not s.obstacle)
    gui.click("Match")
    gui.wait(lambda s: s.solver.snapshot is not None and s.solver.snapshot.iteration.iteration > 19)
    warned = (
        "The source is being squeezed to nothing instead of moved: it may be too far from the "
        "target."
    )
    assert dict(texts())[warned] == "failure"
    gui.click("Cancel")
    gui.wait(lambda s: s.solver.finished)
    assert dict(texts())["It was cancelled, and the best field so far was kept."] == "ink"
    remedies = [remedy.label for remedy in gui.session.result.verdict.remedies]
    assert remedies == ["Reach further", "Continue"]


def test_a_match_that_was_cancelled_goes_on_at_one_click(gui):
    gui.session.editor.amend(parameters=ENDLESS)
    gui.click("Match")
    gui.wait(lambda s: s.solver.snapshot is not None and s.solver.snapshot.iteration.iteration > 3)
    gui.click("Cancel")
    gui.wait(lambda s: s.solver.finished)
    left = gui.session.result.mismatch
    gui.click("Continue", within="verdict")
    gui.wait(lambda s: s.solver.snapshot is not None)
    assert gui.session.solver.snapshot.iteration.mismatch <= 1.01 * left


@pytest.mark.parametrize("is_changed", [False, True])
def test_a_match_that_was_cancelled_near_its_end_goes_on_too(gui, texts, is_changed):
    """Its field matches already, which is no reason to begin anew without a word."""
    gui.click("Match")
    gui.wait(lambda s: s.solver.finished)
    gui.session.editor.amend(parameters=ENDLESS)
    gui.session.solver.warm = True
    gui.click("Match")
    gui.key("p")  # else it might end by itself
    gui.wait(lambda s: s.solver.snapshot is not None)
    gui.key("escape")
    gui.wait(lambda s: s.solver.finished)
    assert gui.session.result.verdict.kind == "matched"
    gui.session.solver.warm = False
    if is_changed:
        gui.session.editor.set_parameter(alpha=1.1 * gui.session.parameters.alpha)
    else:
        assert "Continue, or Match starts over." in dict(texts())
    gui.click("Continue", within="verdict")
    gui.wait(lambda s: s.solver.snapshot is not None)
    assert gui.session.solver.snapshot.iteration.mismatch < 0.5


@pytest.mark.parametrize(
    ("label", "parameters"),
    [("More time", {"iterations": 60}), ("Smoother", {"alpha": 0.03, "sigma": 0.01})],
)
def test_a_remedy_is_a_button_that_changes_what_it_says_and_starts_a_run(gui, label, parameters):
    blindly(gui, iterations=8)
    result = gui.session.result
    verdict = replace(result.verdict, remedies=(Remedy(label, "so", parameters),))
    gui.session.editor.amend(result=replace(result, verdict=verdict))
    gui.frames(1)
    gui.click(label, within="verdict")
    assert gui.session.solver.running
    gui.wait(lambda s: s.solver.finished)
    assert gui.session.result.parameters == replace(result.parameters, **parameters)
