"""Tours of the tab Match: parameters, refused texts, presets, defaults, and iterations."""

import csv
import re
from dataclasses import replace

import polyscope.imgui as imgui
import pytest

from abfm import Parameters
from abfm.parameters import AREA_PRESERVING_DIVERGENCE, CHOICES, FIELDS, LAST_SIGMA, TABLE_1, TITLES
from abfm_viewer.panels.right_panel import STEPS
from tests.messages import check_message
from tests.viewer.sessions import match


def test_tour_of_parameters(gui, walk):
    walk(gui, show_five_parameters_first, set_sigma_or_auto, refuse_and_correct)
    walk(gui, forget_errors_with_the_next_change, set_presets_and_a_mask, set_every_parameter)
    walk(gui, explain_by_tooltips)


def test_tour_of_iterations(matched, tmp_path, monkeypatch):
    matched.session.editor.set_view("plot the iterations", trade_off=False)
    matched.click("Match", within=STEPS)
    export_and_hover(matched, tmp_path, monkeypatch)
    keep_earlier_runs(matched)


def set_every_parameter(gui):
    """Type, drag and undo each parameter; the method decides which ones are enabled."""
    for label, (typed, slid) in {
        "alpha": (10, 0.1),
        "beta": (0.001, 1e-2),
        "order": (1, 2),
        "sigma": (0.05, 0.5),
        "goal": (0.1, 0.02),
        "reach": (0.3, 1.4),
        "divergence": (2, 50),
        "landmark_sigma": (0.002, 0.05),
        "tau": (2, 0.5),
        "iterations": (30, 300),
        "cooling_stages": (1, 4),
        "levels": (1, 3),
        "cooling_factor": (4, 20),
        "stage_iterations": (17, 60),
        "memory": (8, 50),
        "max_displacement": (0.2, 0.05),
        "tolerance": (0.001, 0.01),
    }.items():
        default = gui.session.parameters.to_dict()[label]
        gui.type(label, f"{typed:g}")
        assert gui.session.parameters.to_dict()[label] == typed, label
        gui.drag(label, slid)
        assert gui.session.parameters.to_dict()[label] == pytest.approx(slid, rel=0.25), label
        gui.key("ctrl+z")
        assert gui.session.parameters.to_dict()[label] == typed, label
        gui.key("ctrl+z")
        assert gui.session.parameters.to_dict()[label] == default, label
    assert not gui.is_enabled("substeps")
    for gradient in ("adjoint", "bracket"):
        gui.choose("gradient", gradient)
    gui.type("substeps", "20")
    gui.drag("substeps", 40)
    gui.type("quadrature", "5")
    gui.drag("quadrature", 20)
    for choice, value in {"1": 1, "2": 2, "0": 0, "auto": None}.items():
        gui.choose("refine", choice)
        assert gui.session.parameters.refine == value
    gui.check("auto divergence", on=False)
    assert gui.session.parameters.divergence == AREA_PRESERVING_DIVERGENCE
    gui.check("auto divergence")
    assert gui.session.parameters.divergence is None
    for name in ("preconditioner", "sigma_unit"):
        for choice in CHOICES[name]:
            gui.choose(name, choice)
            assert gui.session.parameters.to_dict()[name] == choice
    gui.choose("method", "linearised")
    assert not gui.is_enabled("gradient")
    gui.type("segments", "4")
    gui.drag("segments", 6)
    p = gui.session.parameters
    assert (p.paper.method, p.solver.segments, p.paper.gradient) == ("linearised", 6, "bracket")
    match(gui)
    assert len(gui.session.result.velocity) == 6
    gui.choose("method", "nonlinear")


def set_sigma_or_auto(gui):
    def shown():
        return gui.text_of("auto sigma"), gui.text_of("sigma", kind="box")

    assert shown() == ("on", "auto")
    gui.check("auto sigma", on=False)
    assert gui.session.parameters.sigma == LAST_SIGMA
    assert shown() == ("off", f"{LAST_SIGMA:g}")
    gui.type("sigma", ".5")
    gui.check("auto sigma")
    assert gui.session.parameters.sigma is None
    gui.key("ctrl+z")
    assert gui.session.parameters.sigma == 0.5
    gui.type("sigma", "auto")
    assert gui.session.parameters.sigma is None
    gui.drag("sigma", 2.0)
    assert gui.session.parameters.sigma == pytest.approx(2, rel=0.25)
    gui.type("sigma", "0")
    assert gui.window.ui.refusals.reasons
    gui.check("auto sigma")
    assert shown() == ("on", "auto")
    assert not gui.window.ui.refusals.reasons
    gui.type("sigma", "aut")
    (reason,) = gui.window.ui.refusals.reasons.values()
    check_message(reason, "aut")


def refuse_and_correct(gui):
    """Check that a refused text stays in its box until it is corrected, or Escape."""
    reasons, start = gui.window.ui.refusals.reasons, gui.session.parameters
    for label, text in (("alpha", "-1"), ("sigma", "0"), ("tau", "much"), ("iterations", "inf")):
        before = gui.session.parameters
        gui.type(label, text)
        assert gui.session.parameters == before
        assert reasons, label
        gui.drag(label, 0.5 if label != "iterations" else 50)
        assert not reasons, label
    gui.session.editor.amend(parameters=start)
    gui.type("alpha", "1o")
    gui.frames(3)
    assert gui.text_of("alpha", kind="box") == "1o"
    (reason,) = reasons.values()
    check_message(reason, "1o")
    gui.click("alpha")
    gui.key("escape")
    gui.frames(2)
    assert gui.text_of("alpha", kind="box") == f"{Parameters().alpha:g}"
    assert not reasons
    gui.type("alpha", "-1")
    gui.type("alpha", "10")
    assert gui.session.parameters.alpha == 10
    assert not reasons
    gui.type("cooling_stages", "-1")
    (reason,) = reasons.values()  # the message names the panel
    check_message(reason, -1)
    gui.click("cooling_stages")
    gui.key("escape")


def forget_errors_with_the_next_change(gui):
    for act, *words in ((gui.key, "ctrl+z"), (gui.type, "reach", "0.5"), (gui.click, "Match")):
        gui.type("beta", "0.1")
        gui.type("sigma", "0")
        gui.frames(3)
        assert len(gui.window.ui.refusals.reasons) == 1
        act(*words)
        gui.frames(2)
        assert not gui.window.ui.refusals.reasons
        assert gui.text_of("sigma", kind="box") == "auto"
    assert gui.session.solver.running or gui.session.result
    gui.session.solver.cancel()


def show_five_parameters_first(gui):
    """Check that five parameters are shown at first, and that all have widgets and symbols."""
    gui.click("Match", within=STEPS)
    sliders = [w for w in gui.window.ui.widgets if w.kind == "slider" and w.section == "Match"]
    labels = {"alpha": "smoothness α", "sigma": "closeness σ", "beta": "slopes β", "tau": "time τ"}
    assert {w.name: w.label for w in sliders} == labels | {"reach": "reach"}
    gui.click("Advanced")
    gui.frames(3)
    widgets = gui.window.ui.widgets
    assert not [w.label for w in widgets if "_" in w.label]
    assert {*FIELDS} <= {w.name for w in widgets}
    missing = imgui.CalcTextSize("\uffff")[0]
    shapes = {imgui.CalcTextSize(20 * letter)[0] for letter in "ασβτ"}
    assert len(shapes) > 1
    assert 20 * missing not in shapes


def set_presets_and_a_mask(gui):
    rows = list(TABLE_1.values())
    for preset in (*rows[1:], rows[0]):
        gui.choose("preset", preset.label)
        assert preset.matches(gui.session.parameters)
    assert gui.text_of("preset") == rows[0].label
    gui.click("preset")
    tips = {w.label: w.tip for w in gui.window.ui.widgets if w.section.endswith("/preset")}
    gui.key("escape")
    assert [label for label in tips if label != "defaults"] == [row.label for row in rows]
    assert all(TITLES[row.figure] in tips[row.label] for row in rows)
    gui.type("alpha", "12")
    assert gui.text_of("preset") == "custom values"
    own = gui.session.parameters
    gui.choose("preset", "custom values")
    assert gui.session.parameters == own
    gui.click("Reset to defaults", within="Match")
    assert gui.session.parameters == Parameters()
    gui.key("ctrl+z")
    assert gui.session.parameters.alpha == 12
    gui.choose("preset", "defaults")
    assert gui.session.parameters == Parameters()
    gui.type("mask", "nonsense:")
    assert gui.session.document.mask == ""
    gui.type("mask", "expression:x>0")
    assert gui.session.document.mask == "expression:x>0"
    gui.wait(lambda s: not s.obstacle)
    gui.session.editor.amend(parameters=Parameters.of(iterations=5, refine=0))
    match(gui)
    assert gui.session.result.mask is not None
    gui.type("mask", "")
    assert gui.session.outdated


def explain_by_tooltips(gui, monkeypatch):
    shown = []
    monkeypatch.setattr("polyscope.imgui.BeginTooltip", lambda: shown.append(True))
    monkeypatch.setattr("polyscope.imgui.EndTooltip", lambda: None)
    gui.hover("alpha")
    assert shown
    gui.click("Match")
    gui.frames(2)
    shown.clear()
    gui.frames(40)
    assert not shown  # the mouse is still where it was clicked
    gui.hover("Pause")
    assert shown
    gui.session.solver.cancel()  # the run may have ended by now


def keep_earlier_runs(plotted):
    session = plotted.session
    assert len(session.document.runs) == 1
    assert "energy plot" in plotted.labels()
    match(plotted)
    runs = session.document.runs
    assert len(runs) == 2
    for shown in (False, True):
        plotted.check("previous runs", shown)
        assert session.view.previous_runs is shown
    plotted.click("Clear previous")
    assert session.document.runs == runs[-1:]
    assert not plotted.is_enabled("Clear previous")
    plotted.key("ctrl+z")
    assert len(session.document.runs) == 2


def export_and_hover(plotted, tmp_path, monkeypatch):
    plotted.click("Export CSV...")
    plotted.type("file name", "energies")
    path = tmp_path / "energies.csv"
    plotted.wait(lambda _: path.exists())
    rows = list(csv.reader(path.read_text().splitlines()))
    assert len(rows) == 1 + len(plotted.session.result.energy_history)
    shown = []
    monkeypatch.setattr("polyscope.imgui.SetTooltip", shown.append)
    plotted.frames(5)
    assert not shown
    plotted.hover("energy plot")
    known = len(plotted.session.result.energy_history)
    at = int(re.match(r"iteration (\d+)", shown[-1])[1])
    assert 0 < at < known - 1
    total, _, mismatch = plotted.session.result.energy_history[at]
    assert f"{total:.4g}" in shown[-1]
    assert f"{mismatch:.4g}" in shown[-1]
    [run] = plotted.session.document.runs
    terms = {"term_names": ("closeness", "landmarks"), "shares": run.energies[:, 1:]}
    plotted.session.editor.change("two terms", runs=(replace(run, **terms),))
    plotted.hover("energy plot")
    assert f"closeness {run.energies[at, 1]:.4g}\nlandmarks {mismatch:.4g}" in shown[-1]
