"""Every entry of every menu, the dialogs that they open, and what the view does to the window."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from abfm import Parameters, load_mesh
from abfm_viewer.appearance import colormaps
from abfm_viewer.automation import Driver
from abfm_viewer.document.document import LAYOUTS
from abfm_viewer.window.menus import UI_SCALES
from tests.mesh_writers import off_file
from tests.shapes import icosphere
from tests.viewer.sessions import EGG


@pytest.fixture
def sphere_file(tmp_path):
    """Another mesh, in a file with a blank in its name."""
    return off_file(tmp_path / "a sphere.off", icosphere(2))


def sphere_opened(gui):
    """Wait until the sphere is shown with its functions."""
    gui.wait(lambda s: len(s.surface().mesh.vertices) == 162 and s.values("target") is not None)
    assert not gui.window.dialogs.is_open


@pytest.fixture
def wide(tmp_path):
    """The app in a window that a whole path fits in."""
    with Driver(EGG, size=(860, 600)) as gui:
        gui.window.dialogs.folder = tmp_path
        yield gui
        assert not gui.errors


def test_a_mesh_is_opened_and_is_recent_then(wide, sphere_file):
    gui = wide
    gui.menu("File", "Open mesh...")
    gui.click("Cancel", within="Open a mesh")
    assert not gui.window.dialogs.is_open
    gui.menu("File", "Open mesh...")
    assert not gui.is_enabled("Open")
    gui.click(sphere_file.name)
    gui.click("Open")
    sphere_opened(gui)
    assert gui.session.document.name == sphere_file.name
    gui.key("ctrl+z")
    assert gui.session.surface().mesh is EGG
    recent = recent_label(gui)
    assert recent.endswith(sphere_file.name)
    gui.menu("File", "Recent", recent)
    sphere_opened(gui)
    assert gui.session.notices.latest.text.startswith(f"opened {sphere_file.name}")
    np.testing.assert_array_equal(gui.session.surface().mesh.faces, load_mesh(sphere_file).faces)
    gui.menu("File", "Recent", "Clear recent")
    assert gui.window.files.recent() == []


def recent_label(gui):
    """What the menu calls the latest file."""
    gui.click("File")
    gui.click("Recent")
    label = next(w.label for w in gui.window.ui.widgets if w.section == "File/Recent")
    gui.key("esc")
    gui.key("esc")
    return label


def test_folders_are_gone_through(gui, tmp_path, sphere_file):
    (tmp_path / "inner").mkdir()
    gui.menu("File", "Open mesh...")
    gui.double_click("inner/")
    assert gui.text_of("folder") == str(tmp_path / "inner")
    gui.click("Up")
    assert gui.text_of("folder") == str(tmp_path)
    gui.double_click("inner/")
    gui.key("alt+up")
    gui.click(sphere_file.name)
    assert gui.text_of("folder") == str(tmp_path)
    gui.click("Home")
    assert gui.text_of("folder") == str(Path.home())
    gui.type("folder", str(tmp_path))
    gui.double_click(sphere_file.name)
    sphere_opened(gui)
    assert gui.window.dialogs.folder == tmp_path


def test_folders_are_gone_through_to_save(gui, tmp_path):
    (tmp_path / "inner").mkdir()
    (tmp_path / "older.abfm").touch()
    gui.menu("File", "Save project as...")
    gui.click("older.abfm")
    assert gui.text_of("file name") == "older.abfm"
    gui.double_click("inner/")
    gui.click("Up")
    gui.click("Home")
    assert gui.text_of("folder") == str(Path.home())
    gui.type("folder", str(tmp_path / "inner"))
    gui.type("file name", "new", enter=False)
    gui.click("Save", within="Save the project")
    gui.wait(lambda s: s.saves.path == tmp_path / "inner" / "new.abfm" and not s.saves.unsaved)
    assert is_project(tmp_path / "inner" / "new.abfm")
    assert (tmp_path / "older.abfm").read_bytes() == b""


def is_project(path):
    """Whether a file begins as projects do."""
    return path.read_bytes()[:2] == b"PK"


def test_a_project_is_saved_and_opened_again_identical(matched, tmp_path):
    path = tmp_path / "first.abfm"
    path.write_text("precious")
    matched.type("sigma", "0.03")
    matched.drag("time", 0.7)
    saved = matched.session.document
    matched.menu("File", "Save project")
    matched.type("file name", "first")
    assert matched.window.dialogs.is_asking("Replace the file?")
    matched.key("esc")
    matched.click("Save", within="Save the project")
    matched.click("Go back", within="Replace the file?")
    assert path.read_text() == "precious"
    matched.click("Cancel", within="Save the project")
    assert not matched.window.dialogs.is_open
    matched.menu("File", "Save project as...")
    matched.type("file name", "first", enter=False)
    matched.click("Save", within="Save the project")
    matched.click("Replace")
    matched.wait(lambda s: not s.saves.unsaved and not matched.window.files.saving)
    assert not matched.window.dialogs.is_open
    assert matched.session.saves.path == path
    assert is_project(path)
    matched.session.editor.set_parameter(alpha=4.0)
    matched.key("ctrl+s")  # asks nothing more
    matched.wait(lambda s: not s.saves.unsaved)
    matched.session.editor.set_parameter(alpha=saved.parameters.alpha)
    matched.key("ctrl+s")
    matched.wait(lambda s: not s.saves.unsaved)
    matched.click("Reset to defaults", within="Match")
    matched.menu("File", "Open project...")
    matched.double_click("first.abfm")
    matched.wait(lambda s: s.saves.path == path and s.parameters.sigma == 0.03)
    assert "Undo returns to" in matched.session.notices.latest.text
    opened = matched.session.document
    for name in (
        "channels",
        "parameters",
        "mask",
        "time",
        "view",
        "lines",
        "points",
        "channel",
        "side",
        "bump",
    ):
        assert getattr(opened, name) == getattr(saved, name), name
    np.testing.assert_array_equal(opened.surface().mesh.vertices, saved.surface().mesh.vertices)
    np.testing.assert_array_equal(opened.surface().mesh.faces, saved.surface().mesh.faces)
    np.testing.assert_array_equal(opened.result.velocity, saved.result.velocity)
    np.testing.assert_array_equal(opened.runs[0].energies, saved.runs[0].energies)
    matched.wait(lambda _: not matched.window.shown.busy)
    assert not matched.session.saves.unsaved


def test_undo_goes_back_to_the_start_and_redo_to_the_end(gui):
    start = gui.session.document
    assert not gui.is_enabled("Undo", within="Edit")
    gui.key("esc")
    gui.type("alpha", "0.5")
    gui.click("Swap")
    gui.click("Match")
    gui.wait(lambda s: s.solver.finished)
    gui.drag("time", 0.4)
    gui.menu("View", "Dark theme")
    end = gui.session.document
    steps = 0
    while gui.session.editor.undo_label:
        gui.menu("Edit", "Undo")
        steps += 1
    assert steps >= 5
    assert not gui.is_enabled("Undo", within="Edit")
    gui.key("esc")
    for name in ("channels", "parameters", "result", "runs", "view"):
        assert getattr(gui.session.document, name) == getattr(start, name), name
    while gui.session.editor.redo_label:
        gui.menu("Edit", "Redo")
    for name in ("channels", "parameters", "result", "runs", "view", "time"):
        assert getattr(gui.session.document, name) == getattr(end, name), name


def test_light_and_dark(gui, tmp_path):
    brightness = {}
    for theme in ("Dark theme", "Light theme"):
        gui.menu("View", theme)
        gui.screenshot(tmp_path / "a.png")
        brightness[theme] = np.asarray(Image.open(tmp_path / "a.png").convert("L")).mean()
    assert brightness["Dark theme"] < 120 < 180 < brightness["Light theme"]


def test_every_layout_color_map_and_scale(gui):
    before = gui.session.view
    for layout in (*LAYOUTS[1:], LAYOUTS[0]):
        gui.menu("View", "Layout", layout)
        assert gui.session.view.layout == layout
        assert gui.window.scene.names == (
            ("advected",) if layout == "advected only" else ("source", "advected", "target")
        )
    for colormap in (*colormaps.NAMES, "automatic"):
        gui.menu("View", "Color map", colormap)
        assert gui.session.view.colormap == colormap
    for scale in (*UI_SCALES[1:], UI_SCALES[0]):
        gui.menu("View", "UI scale", f"{scale:g}")
        assert gui.session.view.ui_scale == scale
        width = gui.window.parts.status[2]
        left, _, right, _ = gui.window.parts.panel
        assert right - left == pytest.approx(min(380 * scale, 0.44 * width))
    while gui.session.editor.undo_label:
        gui.key("ctrl+z")
    assert gui.session.view == before


def test_isolines_and_the_color_bar_come_and_go(gui, tmp_path):
    def picture():
        gui.screenshot(tmp_path / "a.png")
        return np.asarray(Image.open(tmp_path / "a.png"), int)[:440, :470]

    before = picture()
    for label, name in (("Isolines", "isolines"), ("Color bar", "color_bar")):
        was = getattr(gui.session.view, name)
        gui.menu("View", label)
        assert getattr(gui.session.view, name) is not was
        assert np.abs(picture() - before).mean() > 0.1
        gui.menu("View", label)
        assert np.abs(picture() - before).mean() < 0.01


def test_the_flow_is_seen_after_a_match_unless_that_is_switched_off(gui):
    gui.session.editor.amend(
        parameters=replace(gui.session.parameters, iterations=20, cooling_stages=1)
    )
    gui.menu("View", "Flow after a match")
    assert gui.session.view.flow_after_match
    gui.session.player.speed = 4.0
    gui.click("Match")
    gui.wait(lambda s: s.solver.finished)
    assert gui.session.player.playing
    assert gui.session.view.arrows or gui.session.view.streaks
    times = []
    gui.wait(lambda s: times.append(s.time) or not s.player.playing)
    assert times[0] < 0.5 * gui.session.parameters.tau
    assert gui.session.time == gui.session.parameters.tau
    gui.menu("View", "Flow after a match")
    assert not (gui.session.view.arrows)
    assert not (gui.session.view.streaks)
    gui.click("Match")
    gui.wait(lambda s: s.solver.finished)
    assert not gui.session.player.playing


def test_the_camera_turns_and_is_reset(gui):
    before = gui.window.scene.look
    x, y = gui.window.scene.view.slots["source"].middle
    gui.input.drag((x, y), (x + 60, y + 30))
    assert not np.allclose(gui.window.scene.look.front.direction, before.front.direction, atol=0.1)
    gui.menu("View", "Reset camera")
    assert gui.window.scene.look == before


def test_defaults_return(gui):
    gui.session.editor.set_parameter(alpha=3.0)
    gui.click("Reset to defaults", within="Edit")
    assert gui.session.parameters == Parameters()


def test_help_is_closed_again(gui):
    for entry in ("Shortcuts", "Messages", "About"):
        gui.menu("Help", entry)
        gui.click("Close", within="About abfm" if entry == "About" else entry)
        assert not gui.window.dialogs.is_open


def test_every_shortcut_is_listed_and_does_something_of_its_own(gui, monkeypatch):
    actions, called = gui.window.actions, []
    listed = "\n".join(keys for keys, _ in actions.listed())
    for action in actions.all:
        monkeypatch.setattr(action, "do", lambda action=action: called.append(action))
    for action in actions.all:
        assert action.hint in listed
        for chord in action.chords:
            called.clear()
            gui.key(chord)
            assert called == [action], chord


def test_quitting_asks_about_unsaved_work(gui, tmp_path):
    gui.type("sigma", "0.04")
    gui.menu("File", "Quit")
    gui.window.actions.quit.do()  # a second press of the window's own button
    gui.click("Go back")
    assert not gui.window.closing
    assert not gui.window.dialogs.is_open
    gui.key("ctrl+q")
    gui.click("Save", within="Save before closing?")
    gui.type("file name", "last")
    gui.wait(lambda _: gui.window.closing)
    assert (tmp_path / "last.abfm").exists()
    gui.window.closing = False
    gui.type("sigma", "0.03")
    gui.menu("File", "Quit")
    gui.click("Don't save")
    assert gui.window.closing


def test_export_entries_lead_to_their_tab(gui):
    for entry in ("Export picture...", "Export movie...", "Export data..."):
        gui.click("Look")
        gui.menu("File", entry)
        assert gui.text_of("Export", kind="tab") == "open"
