import numpy as np
import polyscope.imgui as imgui
import pytest
from PIL import Image

from abfm_viewer.automation import Driver, DriverError
from abfm_viewer.panels.right_panel import TABS
from abfm_viewer.scene import pacing
from abfm_viewer.scene.surfaces import viewport
from tests.messages import raises
from tests.shapes import icosphere
from tests.viewer.sessions import QUICK, SIZE


def test_tour_of_the_driver(gui, walk):
    """Labels, sliders, sections, pictures, mouse buttons and errors of the Driver."""
    walk(gui, report_missing_widgets, drag_sliders, drag_with_the_right_button, write_pictures)
    walk(gui, report_ambiguous_labels, follow_a_moving_widget)
    walk(gui, prefer_the_button_to_the_tab)


def drag_sliders(gui):
    values = {"time": (0.0, 2.0, 1.234), "alpha": (1e-4, 1e4, 1.0), "beta": (0.0, 1e-3, 1.0)}
    values |= {"sigma": (3e-3,), "tau": (7.0,), "segments": (7,), "iterations": (2000,)}
    values |= {"memory": (40,)}
    for label, value in [(label, value) for label, some in values.items() for value in some]:
        method = "linearised" if label == "segments" else "nonlinear"
        gui.session.editor.set_parameter(method=method)
        gui.drag(label, value)
        slider = gui.search.find(label, kinds=("slider",))
        pixel = 1 / (slider.rect[2] - slider.rect[0] - 20)
        here, there = (slider.ends.share_of(v) for v in (float(slider.text), value))
        assert here == pytest.approx(there, abs=1.6 * pixel), label
        if value in (0.0, slider.ends.low, slider.ends.high):
            assert float(slider.text) == value, label


def report_missing_widgets(gui):
    """Open closed tabs and sections in the search."""

    def opened():
        return [(w.label, w.kind) for w in gui.window.ui.widgets if w.text == "open"]

    before = opened()
    with pytest.raises(DriverError):
        gui.click("nowhere")
    assert opened() == before == [("Functions", "tab")]
    gui.check("previous runs", False)
    assert not gui.session.view.previous_runs
    assert opened() == [("Match", "tab")]
    gui.type("memory", "7")
    assert gui.session.parameters.solver.memory == 7
    assert opened() == [("Match", "tab"), ("Advanced", "section")]
    for named, act, *words in (
        (("Mtach", "Match"), gui.click, "Mtach"),
        (("zzz", "File"), gui.click, "zzz", "File"),
        (("Redo",), gui.click, "Redo"),
        (("time", 0, 2, 3), gui.drag, "time", 3),
        (("ctrl+nonsense",), gui.key, "ctrl+nonsense"),
        (("ghost", "source"), gui.pick, 3, "ghost"),
        (("0.1",), gui.wait, lambda s: s.solver.finished, 0.1),
    ):
        with raises(DriverError, *named):
            act(*words)


def report_ambiguous_labels(gui, monkeypatch):
    pressed, disabled = [], set()

    def draw(context):
        ui = context.ui
        for side in ("source", "target"):
            with ui.group(side), ui.disabled(side in disabled):
                if ui.button("bump"):
                    pressed.append(side)

    monkeypatch.setitem(TABS["Match"], "energy", draw)
    with raises(DriverError, "bump", "Match/source", "Match/target", 2, "within="):
        gui.click("bump")
    gui.click("bump", within="target")
    assert pressed == ["target"]
    disabled.add("target")
    gui.click("bump")
    assert pressed == ["target", "source"]


def follow_a_moving_widget(gui, monkeypatch):
    pressed, tops, above = [], [0.0], []

    def draw(context):
        if imgui.GetMousePos()[1] >= tops[0] > 0 and not above:
            above.append("what came")
        imgui.Dummy((1, 400 * len(above)))
        tops[0] = imgui.GetCursorScreenPos()[1]
        if context.ui.button("bump"):
            pressed.append("bump")

    monkeypatch.setitem(TABS["Match"], "energy", draw)
    gui.click("bump")
    assert (above, pressed) == (["what came"], ["bump"])


def prefer_the_button_to_the_tab(gui):
    gui.session.editor.amend(parameters=QUICK)
    gui.click("Match", within="steps")
    assert not gui.session.solver.running
    assert gui.text_of("Match", within="steps") == "open"
    gui.click("Match")
    gui.wait(lambda s: s.result is not None)


def write_pictures(gui, tmp_path, monkeypatch):
    """Check that pictures keep sections and scrolling, change nothing, and have smooth edges."""

    def placed():
        return [(w.label, w.rect) for w in gui.window.ui.widgets]

    history = gui.session.editor
    gui.check("previous runs", False)
    gui.frames(2)
    before, moves, drawn = placed(), history.action_count, gui.window.frames
    gui.screenshot(tmp_path / "once.png")
    assert gui.window.frames == drawn + 3
    assert (placed(), history.action_count) == (before, moves)
    gui.screenshot(tmp_path / "twice.png")
    names = ("once.png", "twice.png")
    once, twice = (np.asarray(Image.open(tmp_path / name), int) for name in names)
    assert once.shape == (*SIZE[::-1], 3)
    assert np.abs(once - twice).mean() < 0.1
    left, top, _, bottom = map(int, dict(before)["previous runs"])
    tick = once[top:bottom, left : left + bottom - top]
    assert tick.std() > 1  # at the same place on the screen, not below it
    assert gui.session.view.previous_runs is False
    monkeypatch.setattr(pacing, "SCREENSHOT_SAMPLES_MAX", 2)
    gui.screenshot(tmp_path / "smooth.png")
    assert gui.window.supersampling.samples == 1
    smooth = np.asarray(Image.open(tmp_path / "smooth.png"), int)
    assert smooth.shape == once.shape
    assert (np.abs(smooth - once).max(axis=2) > 20).sum() > 50


def drag_with_the_right_button(gui):
    before, drawn = gui.window.scene.view, gui.window.frames
    gui.input.drag((150, 200), (165, 212), steps=7, button=1)
    after = gui.window.scene.view
    assert gui.window.frames - drawn == 1 + 1 + 7 + 2
    mesh = gui.session.surface().mesh
    vertex = viewport(mesh).drawn(mesh.vertices[0])
    places = [view.projected("source", vertex)[0] for view in (before, after)]
    np.testing.assert_allclose(places[1] - places[0], [15, 12, 0], atol=1e-6)  # translated


def test_next_driver_has_no_pressed_buttons():
    def fail(gui):
        gui.click("View")
        gui.input.set_modifier("shift", True)
        gui.input.press()
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError), Driver(icosphere(2), size=SIZE) as gui:
        fail(gui)
    with Driver(icosphere(2), size=(700, 500)) as gui:
        io = imgui.GetIO()
        assert not io.KeyShift
        assert not imgui.IsAnyMouseDown()
        assert tuple(io.DisplaySize) == (700, 500)
        assert not {w.label for w in gui.window.ui.widgets if w.kind == "menu" and w.text == "open"}
        gui.click("alpha")
        gui.input.write("77")
    with Driver(icosphere(2), size=SIZE) as gui:
        assert not imgui.GetIO().WantTextInput
        assert gui.text_of("alpha", kind="box") == f"{gui.session.parameters.alpha:g}"


def test_process_has_one_backend():
    with (
        raises(DriverError, "openGL3_egl", "openGL_mock"),
        Driver(icosphere(1), backend="openGL_mock"),
    ):
        pass
