import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from abfm import Parameters, load_mesh
from abfm.pages import colormaps
from abfm_viewer.dialogs import native_dialog
from abfm_viewer.document.document import LAYOUTS
from abfm_viewer.panels.export import TITLE
from abfm_viewer.window.menus import UI_SCALES
from tests.mesh_writers import off_file
from tests.messages import check_message
from tests.shapes import icosphere
from tests.viewer.sessions import EGG, SHORT, match, take_back

WINDOW = (860, 600)  # wide enough for a complete path


@pytest.fixture
def sphere_file(tmp_path):
    return off_file(tmp_path / "a sphere.off", icosphere(2))


def test_tour_of_the_file_menu(gui, walk):
    """Meshes, recent files, folders and projects are opened, and the app is quit."""
    walk(gui, open_a_mesh_and_a_recent_one, walk_through_folders)
    walk(gui, use_the_list_of_files, open_by_the_dialog_of_the_system)
    walk(gui, save_and_open_a_project, parameters=SHORT)
    walk(gui, quit_with_unsaved_work)


def test_tour_of_edit_view_and_help(gui, walk):
    """Undo, the view, the flow after a match, and every shortcut are used."""
    walk(gui, undo_and_redo_everything, change_the_view)
    walk(gui, show_the_flow_after_a_match, parameters=SHORT)
    walk(gui, use_entries_and_shortcuts)


def sphere_opened(gui):
    gui.wait(lambda s: len(s.surface().mesh.vertices) == 162 and s.values("target") is not None)
    assert not gui.window.dialogs.is_open


def open_a_mesh_and_a_recent_one(gui, sphere_file):
    dialogs, files = gui.window.dialogs, gui.window.files
    gui.menu("File", "Open mesh...")
    gui.click("Cancel", within="Open a mesh")
    assert not dialogs.is_open
    gui.menu("File", "Open mesh...")
    assert not gui.is_enabled("Open")
    gui.click(sphere_file.name)
    gui.click("Open")
    sphere_opened(gui)
    assert gui.session.document.name == sphere_file.name
    gui.key("ctrl+z")
    assert gui.session.surface().mesh is EGG
    gui.click("File")
    gui.click("Recent")
    recent = next(w.label for w in gui.window.ui.widgets if w.section == "File/Recent")
    gui.key("esc")
    gui.key("esc")
    assert recent.endswith(sphere_file.name)
    gui.menu("File", "Recent", recent)
    sphere_opened(gui)
    assert gui.session.notices.latest.text.startswith(f"opened {sphere_file.name}")
    faces = gui.session.surface().mesh.faces
    np.testing.assert_array_equal(faces, load_mesh(sphere_file).faces)
    gui.menu("File", "Recent", "Clear recent")
    assert files.state.recent() == []


def walk_through_folders(gui, tmp_path, sphere_file):
    """Select folders to open a file and to save one."""
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
    new = tmp_path / "inner" / "new.abfm"
    gui.wait(lambda s: s.saves.path == new and not s.saves.unsaved)
    assert is_project(new)
    assert (tmp_path / "older.abfm").read_bytes() == b""


def use_the_list_of_files(gui, tmp_path, sphere_file):
    """Search, sort and choose files by keys, and come back to a recent folder."""
    gui.window.dialogs.start_in(tmp_path)
    (tmp_path / "empty").mkdir()
    off_file(tmp_path / ".hidden.off", icosphere(1))
    (tmp_path / "a small.abfm").write_bytes(b"PK")
    gui.menu("File", "Save project as...")
    choice = gui.window.dialogs._open[-1][0].choice
    for column, descending in (("size", True), ("date", True), ("name", False)):
        gui.click(column, within="Save the project")
        assert choice.order == (column, descending)
    gui.check("hidden files", within="Save the project")
    gui.check("hidden files", on=False, within="Save the project")
    gui.type("search", "small", within="Save the project", enter=False)
    assert gui.text_of("file name") == "a small.abfm"
    gui.key("esc")  # clears the search
    assert choice.search == ""
    gui.key("esc")
    assert not gui.window.dialogs.is_open
    gui.key("ctrl+o")
    gui.wait(lambda _: sphere_file.name in gui.labels())
    gui.input.write("em")
    gui.frames(2)
    assert gui.text_of("empty/") == "chosen"
    gui.key("enter")
    gui.frames(2)
    assert gui.text_of("folder") == str(tmp_path / "empty")
    gui.key("backspace")
    gui.frames(2)
    assert gui.text_of("folder") == str(tmp_path)
    gui.wait(lambda _: sphere_file.name in gui.labels())
    gui.input.write(sphere_file.name[:3])
    gui.frames(2)
    gui.key("enter")
    sphere_opened(gui)
    gui.menu("File", "Open mesh...")
    gui.type("folder", str(tmp_path / "empty"))
    gui.choose("Recent folders", str(tmp_path))
    assert gui.text_of("folder") == str(tmp_path)
    gui.click("Cancel", within="Open a mesh")


def open_by_the_dialog_of_the_system(gui, tmp_path, sphere_file, monkeypatch):
    """Open a mesh by a library in a subprocess; if that fails, the dialog of the app opens."""
    monkeypatch.setattr(native_dialog, "missing", lambda: "")
    gui.menu("File", "Native file dialogs")
    assert not gui.window.preferences.now.native_dialogs
    gui.menu("File", "Native file dialogs")
    assert gui.window.preferences.now.native_dialogs
    library = tmp_path / "library"
    library.mkdir()
    monkeypatch.setenv("PYTHONPATH", str(library))
    monkeypatch.setattr(gui.window.dialogs, "uses_native", lambda: True)
    answer = "def open_file(title, folder, files):\n    assert '*.off' in [*files.values()][0]\n"
    (library / "crossfiledialog.py").write_text(f"{answer}    return {str(sphere_file)!r}\n")
    gui.menu("File", "Open mesh...")
    sphere_opened(gui)
    gui.session.undo()
    (library / "crossfiledialog.py").write_text("raise RuntimeError('no screen')\n")
    gui.menu("File", "Open mesh...")
    gui.wait(lambda _: "folder" in gui.labels())
    gui.key("esc")
    assert not gui.window.dialogs.is_open
    begun, child = tmp_path / "begun", "[sys.executable, '-c', 'import time; time.sleep(60)']"
    text = f"import pathlib, subprocess, sys\ndef open_file(*_):\n    subprocess.Popen({child})\n"
    text += f"    pathlib.Path({str(begun)!r}).touch()\n    import time; time.sleep(60)\n"
    (library / "crossfiledialog.py").write_text(text)
    gui.menu("File", "Open mesh...")
    gui.wait(lambda _: begun.exists())
    start = time.monotonic()
    gui.key("esc")  # also ends the program that the library started
    assert time.monotonic() - start < 30
    assert not gui.window.dialogs.is_open


def is_project(path):
    return path.read_bytes()[:2] == b"PK"


def save_and_open_a_project(gui, tmp_path):
    session, editor = gui.session, gui.session.editor
    gui.window.dialogs.start_in(tmp_path)
    match(gui)
    path = tmp_path / "first.abfm"
    path.write_text("precious")
    gui.type("sigma", "0.03")
    gui.drag("time", 0.7)
    saved = session.document
    gui.menu("File", "Save project")
    gui.type("file name", "first")
    assert gui.window.dialogs.has_question("Replace the file?")
    gui.key("esc")
    gui.click("Save", within="Save the project")
    gui.click("Go back", within="Replace the file?")
    assert path.read_text() == "precious"
    gui.click("Cancel", within="Save the project")
    assert not gui.window.dialogs.is_open
    gui.menu("File", "Save project as...")
    gui.type("file name", "first", enter=False)
    gui.click("Save", within="Save the project")
    gui.click("Replace")
    gui.wait(lambda s: not s.saves.unsaved and not gui.window.files.saving)
    assert not gui.window.dialogs.is_open
    assert gui.session.saves.path == path
    assert is_project(path)
    editor.set_parameter(alpha=4.0)
    gui.key("ctrl+s")  # without another question
    gui.wait(lambda s: not s.saves.unsaved)
    editor.set_parameter(alpha=saved.parameters.alpha)
    gui.key("ctrl+s")
    gui.wait(lambda s: not s.saves.unsaved)
    gui.click("Reset to defaults", within="Match")
    gui.menu("File", "Open project...")
    gui.double_click("first.abfm")
    gui.wait(lambda s: s.saves.path == path and s.parameters.sigma == 0.03)
    check_message(gui.session.notices.latest.text)
    opened = session.document
    assert (opened.parameters, opened.time) == (saved.parameters, saved.time)
    np.testing.assert_array_equal(opened.result.velocity, saved.result.velocity)
    gui.wait(lambda _: not gui.window.shown.busy)
    assert not session.saves.unsaved


def undo_and_redo_everything(gui):
    session, history = gui.session, gui.session.editor
    start, steps = session.document, 0
    assert not gui.is_enabled("Undo", within="Edit")
    gui.key("esc")
    gui.type("alpha", "0.5")
    gui.click("Swap")
    match(gui)
    gui.drag("time", 0.4)
    gui.menu("View", "Flat shading")
    end, names = session.document, ("channels", "parameters", "result", "runs", "view")
    while history.undo_label:
        gui.menu("Edit", "Undo")
        steps += 1
    assert steps >= 5
    assert not gui.is_enabled("Undo", within="Edit")
    gui.key("esc")
    for name in names:
        assert getattr(session.document, name) == getattr(start, name), name
    while history.redo_label:
        gui.menu("Edit", "Redo")
    for name in (*names, "time"):
        assert getattr(session.document, name) == getattr(end, name), name


def change_the_view(gui, tmp_path):
    before = gui.session.view
    for layout in (*LAYOUTS[1:], LAYOUTS[0]):
        gui.menu("View", "Layout", layout)
        assert gui.session.view.layout == layout
        assert gui.window.scene.names == (
            ("advected",) if layout == "advected only" else ("source", "advected", "target")
        )
    for colormap in (*colormaps.NAMES, "automatic"):
        gui.menu("View", "Colour map", colormap)
        assert gui.session.view.colormap == colormap
    for scale in (*UI_SCALES[1:], UI_SCALES[0]):
        gui.menu("View", "UI scale", f"{scale:g}")
        assert gui.session.view.ui_scale == scale
        width = gui.window.parts.status[2]
        left, _, right, _ = gui.window.parts.panel
        assert right - left == pytest.approx(min(380 * scale, 0.48 * width))
    take_back(gui)
    assert gui.session.view == before

    def picture():
        gui.screenshot(tmp_path / "a.png")
        return np.asarray(Image.open(tmp_path / "a.png").convert("RGB"), int)

    before, brightness = picture()[:440, :470], {}
    for label, name in (("Isolines", "isolines"), ("Colour bar", "color_bar")):
        was = getattr(gui.session.view, name)
        gui.menu("View", label)
        assert getattr(gui.session.view, name) is not was
        assert np.abs(picture()[:440, :470] - before).mean() > 0.1
        gui.menu("View", label)
        assert np.abs(picture()[:440, :470] - before).mean() < 0.01
    for theme in ("Dark theme", "Light theme"):
        gui.menu("View", theme)
        brightness[theme] = picture().mean()
    assert brightness["Dark theme"] < 120 < 180 < brightness["Light theme"]


def show_the_flow_after_a_match(gui):
    session, player = gui.session, gui.session.player
    gui.menu("View", "Flow after a match")
    assert session.view.flow_after_match
    player.speed = 4.0
    match(gui)
    assert player.playing
    assert session.view.arrows or session.view.streaks
    times = []
    gui.wait(lambda s: times.append(s.time) or not player.playing)
    assert times[0] < 0.5 * session.parameters.tau
    assert session.time == session.parameters.tau
    gui.menu("View", "Flow after a match")
    assert (session.view.arrows, session.view.streaks) == (False, False)
    match(gui)
    assert not player.playing


def use_entries_and_shortcuts(gui, monkeypatch):
    """Check that every entry and every shortcut has its own action."""
    gui.session.editor.set_parameter(alpha=3.0)
    gui.click("Reset to defaults", within="Edit")
    assert gui.session.parameters == Parameters()
    for entry in ("Shortcuts", "Messages", "About"):
        gui.menu("Help", entry)
        gui.click("Close", within="About abfm" if entry == "About" else entry)
        assert not gui.window.dialogs.is_open
    search_actions(gui)
    take_the_tour(gui)
    for entry, chosen in (
        ("Export...", "Picture"),
        ("Page for a browser...", "Page for a browser"),
    ):
        gui.menu("File", entry)
        assert gui.text_of(chosen, within=TITLE, kind="choice") == "chosen"
        gui.key("escape")
        assert not gui.window.dialogs.is_open
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


def take_the_tour(gui):
    """Continue by doing a step, and by Next; no card covers its target."""
    window, tour, begun = gui.window, gui.window.tour, gui.session.view
    gui.menu("Help", "Tour")
    assert window.preferences.now.tour_seen
    gui.frames(2)
    assert tour.place[0] >= window.parts.scene[2]  # all surfaces are visible
    gui.input.drag((100, 200), (130, 210))
    gui.frames(2)
    assert gui.session.view.viewpoint != begun.viewpoint
    assert gui.text_of("Functions", kind="tab") == "open"
    assert tour.title == "Two functions"
    titles = []
    while tour.title != "Find everything":
        titles.append(tour.title)
        gui.click("Next", within="tour")
        gui.frames(2)
        inner, target = tour.place, tour.target
        apart = inner[2] <= target[0] or target[2] <= inner[0]
        assert apart or inner[3] <= target[1] or target[3] <= inner[1], tour.title
    assert len(titles) == len({*titles}) == 6
    gui.key("f1")
    gui.click("Close", within="Shortcuts")
    assert tour.title == ""
    gui.menu("Help", "Tour")
    gui.click("Skip tour")
    assert tour.title == ""
    gui.menu("Help", "Tour")
    gui.key("escape")
    assert tour.title == ""
    tour.start()
    for _ in range(7):
        gui.click("Next", within="tour")
    gui.click("Done")
    assert tour.title == ""
    gui.session.editor.set_view("look from the front", viewpoint=None)


def search_actions(gui):
    """Find a parameter, a setting, a menu item, a disabled button and a topic of help."""

    def find(words, enter=True):
        gui.key("ctrl+k")
        gui.type("words", words, enter=enter)
        gui.frames(4)

    editor, dialogs = gui.session.editor, gui.window.dialogs
    find("alpha")
    assert gui.text_of("Match", kind="tab") == "open"
    assert gui.window.ui.active_box.endswith("Match/alpha")
    gui.input.write("0.5")
    gui.key("enter")
    assert gui.session.parameters.alpha == 0.5
    find("goal")
    assert gui.window.ui.open_sections["Advanced"]
    gui.key("esc")
    find("colour by divergence")
    assert gui.session.view.coloring == "divergence"
    gui.menu("Help", "Search actions...")
    gui.type("words", "isol")
    gui.frames(4)
    assert gui.session.view.isolines
    find("clear points")
    assert dialogs.is_open  # there are no points
    gui.key("esc")
    before = gui.session.document.channels
    find("swap", enter=False)
    gui.key("down")
    gui.key("up")
    gui.click("Functions > Swap", within="Search actions")
    gui.frames(4)
    assert gui.session.document.channels[0].source == before[0].target
    find("explain uncertainty")
    gui.click("Close", within="Explanation")
    assert not dialogs.is_open
    while editor.undo_label:
        editor.undo()


def quit_with_unsaved_work(gui, tmp_path):
    gui.type("sigma", "0.04")
    gui.menu("File", "Quit")
    gui.window.actions.quit.do()  # a second press of the button of the window frame
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
