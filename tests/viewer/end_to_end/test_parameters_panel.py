"""Parameters: every box, slider and combo, what is refused, presets and defaults."""

from __future__ import annotations

from dataclasses import fields

import pytest

from abfm import Parameters
from abfm.experiments.table_1 import TABLE_1
from abfm.parameters import CHOICES
from abfm_viewer.panels.right_panel import STEPS


@pytest.mark.parametrize(
    ("label", "text", "slid"),
    [
        ("alpha", "10", 0.1),
        ("beta", "0.001", 1e-2),
        ("order", "1", 2),
        ("sigma", "0.05", 1e-3),
        ("reach", "0.3", 1.4),
        ("tau", "2", 0.5),
        ("iterations", "30", 300),
        ("cooling_stages", "1", 4),
        ("levels", "1", 3),
        ("balance", "0.25", 0.8),
        ("cooling_factor", "4", 20),
        ("stage_iterations", "17", 60),
        ("memory", "8", 50),
        ("max_displacement", "0.2", 0.05),
        ("tolerance", "0.001", 0.01),
    ],
)
def test_a_number_is_typed_and_dragged_and_undone(gui, label, text, slid):
    default = getattr(gui.session.parameters, label)
    gui.type(label, text)
    assert getattr(gui.session.parameters, label) == float(text)
    gui.drag(label, slid)
    assert getattr(gui.session.parameters, label) == pytest.approx(slid, rel=0.25)
    gui.key("ctrl+z")
    assert getattr(gui.session.parameters, label) == float(text)
    gui.key("ctrl+z")
    assert getattr(gui.session.parameters, label) == default
    assert gui.errors == {}


def test_the_method_decides_what_can_be_set(gui):
    assert not gui.is_enabled("substeps")
    for gradient in ("adjoint", "bracket"):
        gui.choose("gradient", gradient)
    gui.type("substeps", "20")
    gui.drag("substeps", 40)
    gui.type("quadrature", "5")
    gui.drag("quadrature", 20)
    for name in ("preconditioner", "sigma_unit"):
        for choice in CHOICES[name]:
            gui.choose(name, choice)
            assert getattr(gui.session.parameters, name) == choice
    gui.choose("method", "linearised")
    assert not gui.is_enabled("gradient")
    gui.type("segments", "4")
    gui.drag("segments", 6)
    parameters = gui.session.parameters
    assert (parameters.method, parameters.segments, parameters.gradient) == ("linearised", 6, "bracket")
    gui.click("Match")
    gui.wait(lambda s: s.solver.finished)
    assert len(gui.session.result.velocity) == 6
    gui.choose("method", "nonlinear")


@pytest.mark.parametrize(("label", "text"), [("alpha", "-1"), ("sigma", "0"), ("tau", "much"), ("iterations", "inf")])
def test_what_makes_no_sense_is_refused_in_place(gui, label, text):
    gui.type(label, text)
    assert gui.session.parameters == Parameters()
    assert gui.window.ui.refusals.reasons
    gui.drag(label, 0.5 if label != "iterations" else 50)
    assert not gui.window.ui.refusals.reasons


def test_presets_set_and_defaults_return(gui):
    rows = list(TABLE_1.values())
    for preset in (*rows[1:], rows[0]):
        gui.choose("preset", preset.name)
        assert preset.holds(gui.session.parameters)
    assert gui.text_of("preset") == rows[0].name
    gui.type("alpha", "12")
    assert gui.text_of("preset") == "own values"
    gui.click("Reset to defaults", within="Match")
    assert gui.session.parameters == Parameters()
    gui.key("ctrl+z")
    assert gui.session.parameters.alpha == 12


def test_a_mask_weighs_the_mismatch(gui):
    gui.type("mask", "nonsense:")
    assert gui.session.document.mask == ""
    gui.type("mask", "expression:x>0")
    assert gui.session.document.mask == "expression:x>0"
    gui.wait(lambda s: not s.obstacle)
    gui.session.amend(parameters=Parameters(iterations=5))
    gui.click("Match")
    gui.wait(lambda s: s.solver.finished)
    assert gui.session.result.mask is not None
    gui.type("mask", "")
    assert gui.session.outdated


def test_a_tooltip_explains_a_parameter(gui, monkeypatch):
    shown = []
    monkeypatch.setattr("polyscope.imgui.BeginTooltip", lambda: shown.append(True))
    monkeypatch.setattr("polyscope.imgui.EndTooltip", lambda: None)
    gui.hover("alpha")
    assert shown
    gui.click("Match")
    gui.frames(2)
    shown.clear()
    gui.frames(40)
    assert not shown  # the mouse rests where it was clicked
    gui.hover("Pause")
    assert shown
    gui.session.solver.cancel()  # it may have ended by now


def test_every_parameter_has_a_widget(gui):
    gui.click("Match", within=STEPS)
    gui.click("Advanced")
    gui.frames(3)
    assert {entry.name for entry in fields(Parameters)} <= {w.name for w in gui.window.ui.widgets}
