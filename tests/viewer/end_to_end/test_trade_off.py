"""Tour of the trade-off: a click on the curve shows a step, which files and undo preserve."""

import csv
import threading

import numpy as np
import pytest

import abfm
from abfm import Match, Parameters
from abfm.matching.path import COLUMNS
from abfm.wording import share
from abfm_viewer.computing.matching import Matching
from abfm_viewer.files.project import load_project
from abfm_viewer.panels.right_panel import STEPS
from abfm_viewer.scene.annotations import _titles
from abfm_viewer.shown.flow_state import FlowState
from tests.messages import check_message
from tests.viewer.end_to_end.test_export import exported
from tests.viewer.sessions import stepped

WINDOW = (1000, 700)  # high enough for the complete curve


def test_tour_of_the_trade_off(matched, walk):
    """On a path of three steps, steps are chosen, limited, computed, saved and exported."""
    gui = matched
    gui.session.editor.amend(result=stepped(gui.session.result))
    gui.window.ui.open_tab = "Match"
    walk(gui, choose_steps, limit_the_distortion, stop_limiting, dim_until_the_step_is_computed)
    walk(gui, dim_until_the_step_is_advected, report_save_and_export)
    walk(gui, plot_iterations_or_steps_of_a_run)


def is_at(gui, step):
    gui.wait(lambda s: s.result.step == step)
    at = gui.session.result
    assert gui.text_of("step", kind="combo").startswith(f"step {step + 1} of 3: ")
    np.testing.assert_allclose(at.advected, at.advect(at.parameters.tau), atol=1e-6)
    gui.drag("time", at.parameters.tau)
    np.testing.assert_array_equal(gui.window.shown.flow.advected(), at.advected[:, 0])


def choose_steps(walked):
    """Choose steps by clicks, keys and the list; one click goes back."""
    for step in (0, 1):
        walked.click(f"step {step + 1}")
        is_at(walked, step)
    assert walked.is_enabled("solver's choice")
    for key, step in (("up", 0), ("up", 0), ("down", 1), ("down", 2)):
        walked.key(key)
        is_at(walked, step)
    assert not walked.is_enabled("solver's choice")
    walked.choose("step", "step 1 of 3: σ 0.7")
    is_at(walked, 0)
    walked.key("ctrl+z")
    is_at(walked, 2)
    walked.key("ctrl+y")
    walked.click("solver's choice")
    is_at(walked, 2)


def titles(gui):
    return {name: title for name, title, _ in _titles(gui.window.scene)}


def dim_until_the_step_is_computed(walked, monkeypatch):
    dim_the_surface_until_the_step_is_shown(walked, monkeypatch, Match, "at_step")


def dim_until_the_step_is_advected(walked, monkeypatch):
    dim_the_surface_until_the_step_is_shown(walked, monkeypatch, FlowState, "advect")


def dim_the_surface_until_the_step_is_shown(walked, monkeypatch, owner, name):
    may_end, scene = threading.Event(), walked.window.scene
    walked.session.set_time(0.5 * walked.session.document.tau)
    walked.wait(lambda _: not walked.window.shown.busy and walked.window.shown.flow.settled)
    walked.frames(2)
    assert scene.outdated == ()
    compute = getattr(owner, name)
    monkeypatch.setattr(owner, name, lambda *given: may_end.wait(30) and compute(*given))
    before = walked.window.shown.flow.advected()

    def tabs():
        return [w.rect for w in walked.window.ui.widgets if w.section == STEPS]

    places = tabs()
    walked.click("step 1")
    walked.frames(3)
    assert scene.outdated == ("advected",)
    assert titles(walked)["advected"] == "advected: computing"
    assert tabs() == places or walked.session.steps.shown == walked.session.result.step
    if owner is FlowState:  # the step is shown, and moves the widgets below its verdict
        walked.wait(lambda s: s.result.step == 0)
        walked.frames(2)
    walked.click("step 2")  # the later step wins
    may_end.set()
    walked.wait(lambda s: s.result.step == 1 and not walked.window.shown.busy)
    walked.wait(lambda _: walked.window.shown.flow.settled and not scene.outdated)
    assert "computing" not in titles(walked)["advected"]
    now = walked.window.shown.flow.advected()
    assert not np.array_equal(now, before)
    expected = walked.session.result.advect(walked.session.time)[:, 0]
    np.testing.assert_allclose(now, expected, atol=1e-6)


def report_save_and_export(walked, tmp_path, monkeypatch):
    shown = []
    monkeypatch.setattr("polyscope.imgui.SetTooltip", shown.append)
    walked.hover("step 3")
    check_message(shown[-1].splitlines()[0], "step 3 of 3", "solver's choice")
    walked.click("step 1")
    is_at(walked, 0)
    walked.hover("step 1")
    left, areas, shapes, folded = shown[-1].splitlines()[2:]
    check_message(left, share(walked.session.result.residual), "90%")
    check_message(areas, "1.1", "0.1")
    check_message(shapes, "1.1", "0.2")
    check_message(folded, "0%")
    walked.click("Export CSV...")
    walked.type("file name", "path.csv")
    walked.wait(lambda _: (tmp_path / "path.csv").exists())
    walked.click("Export", within=STEPS)
    exported(walked, "Match data", tmp_path / "match.npz")
    walked.click("Match", within=STEPS)
    header, *rows = csv.reader((tmp_path / "path.csv").read_text().splitlines())
    assert (tuple(header), len(rows)) == (COLUMNS, 3)
    assert abfm.load(tmp_path / "match.npz").step == 0
    walked.key("ctrl+s")
    walked.type("file name", "chosen")
    walked.wait(lambda s: not s.saves.unsaved)
    document, _ = load_project(tmp_path / "chosen.abfm")
    assert (document.result.step, len(document.result.path), document.solver_step) == (0, 3, 2)


def plot_iterations_or_steps_of_a_run(walked, monkeypatch):
    session = walked.session
    walked.click("Match", within=STEPS)
    assert "trade-off plot" in walked.labels()
    walked.click("iterations")
    assert {"energy plot", "trade-off plot"} & {*walked.labels()} == {"energy plot"}
    walked.click("trade-off")
    goes_on, post = threading.Event(), Matching._post

    def held(matching, problem, now):
        post(matching, problem, now)
        assert len(now.path) < 2 or goes_on.wait(30)

    monkeypatch.setattr(Matching, "_post", held)
    session.editor.amend(parameters=Parameters())
    walked.click("Match")
    walked.wait(lambda s: s.matching.snapshot and len(s.matching.snapshot.iteration.path) > 1)
    assert "energy plot" in walked.labels()
    walked.click("trade-off")
    assert "trade-off plot" in walked.labels()
    assert not walked.is_enabled("step", "Match")
    assert not walked.is_enabled("Export CSV...")
    walked.key("up")
    assert session.steps.shown == 2
    session.editor.set_view("plot the other", trade_off=False)
    goes_on.set()
    walked.wait(lambda s: s.solver.finished)
    assert "energy plot" in walked.labels()
    walked.click("trade-off")
    assert (session.view.trade_off, session.view.trade_off_live) == (True, True)
    last = len(session.result.path)
    walked.click(f"step {1 if session.result.step else last}")
    walked.wait(lambda s: s.document.solver_step is not None)


def limit_the_distortion(walked):
    session, before = walked.session, walked.session.result
    found = before.distortion()
    most = float(f"{0.7 * max(found.log2_area.p95, found.log2_shape.p95):.3g}")
    assert not before.distortion().bound(most).is_satisfied
    walked.type("distortion", str(most))
    walked.click("Limit distortion", "Match")
    walked.wait(lambda s: not s.bound.busy)
    assert session.result.distortion().bound(most).is_satisfied
    assert session.result is not before
    assert not session.outdated
    check_message(session.notices.log[-1].text, f"{most:g}")
    kept = session.result
    walked.type("distortion", "none")
    walked.type("distortion", "4")
    walked.click("Limit distortion", "Match")
    walked.wait(lambda s: not s.bound.busy)
    assert session.result is kept
    check_message(session.notices.log[-1].text, 4)
    walked.key("ctrl+z")
    assert session.result is before


def stop_limiting(walked):
    session, before = walked.session, walked.session.result
    walked.type("distortion", "0.01")
    for _ in range(5):
        walked.click("Limit distortion", "Match")
        walked.click("Stop limiting", "Match")
        if session.result is before:
            break
        walked.key("ctrl+z")  # the run ended before the click
    else:
        pytest.fail("no search was stopped")
    assert not session.bound.busy
    walked.click("Limit distortion", "Match")
    session.editor.change("clear", result=None)
    walked.frames(2)
    assert not session.bound.busy
    walked.key("ctrl+z")
    walked.frames(2)
    assert session.result is before
