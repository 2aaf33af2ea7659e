from types import SimpleNamespace

import polyscope.imgui as imgui
import pytest

from abfm_viewer import app
from abfm_viewer.automation.driver import Driver
from abfm_viewer.dialogs import file_dialog
from abfm_viewer.dialogs.file_dialog import FolderEntry, Listing
from abfm_viewer.document.document import View
from abfm_viewer.files.preferences import PreferenceFile, Preferences
from abfm_viewer.files.project import load_project
from abfm_viewer.files.state_folder import StateFolder
from abfm_viewer.window import window
from abfm_viewer.window.samples import figure_document
from tests.mesh_writers import off_file
from tests.messages import check_message
from tests.processes import python
from tests.shapes import icosphere
from tests.viewer.sessions import SIZE

SMALL = icosphere(1)


@pytest.fixture
def state(tmp_path):
    return StateFolder(tmp_path / "state")


@pytest.fixture
def launched(state):
    """Return a function that opens the app; all launches of a test share a state folder."""
    return lambda what=SMALL: Driver(what, size=SIZE, state=state.path)


@pytest.fixture
def gui(state, launched):
    with launched(icosphere(2)) as gui:
        gui.window.dialogs.start_in(state.path.parent)
        yield gui


@pytest.fixture
def mesh_file(tmp_path):
    """Another sphere, in a file with a blank in its name."""
    return off_file(tmp_path / "a sphere.off", SMALL)


def opened(gui, vertices):
    """Wait until a mesh with this number of vertices is shown with its functions."""
    gui.wait(
        lambda s: len(s.surface().mesh.vertices) == vertices and s.values("target") is not None
    )


def idle(gui):
    gui.wait(lambda _: not gui.window.shown.busy and not gui.window.files.saving)
    gui.frames(3)


# Shortcuts


def test_tour_of_keys_and_dialogs(gui, walk):
    """Typing, opening by keys and drop, long folders, errors, and pauses between frames."""
    walk(gui, open_by_keys_and_drop, fail_after_a_dialog, use_unfinished_text)
    walk(gui, draw_half_of_the_time, list_ten_thousand_files, type_into_boxes)


def use_unfinished_text(gui, tmp_path):
    """Save and match while a text is being typed, which is then used."""
    gui.window.files.save(tmp_path / "first.abfm")
    idle(gui)
    gui.type("tau", "3", enter=False)
    gui.key("ctrl+s")
    idle(gui)
    assert gui.session.parameters.tau == 3
    assert load_project(tmp_path / "first.abfm")[0].parameters.tau == 3
    gui.type("iterations", "7", enter=False)
    gui.key("ctrl+z")  # undoes the typed text
    assert gui.session.parameters.tau == 3
    gui.type("iterations", "8", enter=False)
    gui.key("ctrl+enter")
    gui.wait(lambda s: s.solver.finished)
    assert gui.session.result.parameters.solver.iterations == 8
    assert gui.errors == {}


def type_into_boxes(gui):
    """Check that typed letters of shortcuts have no other effect in a box."""
    theme = gui.session.view.theme
    gui.key("ctrl+shift+s")
    gui.frames(3)
    gui.input.write("l")
    gui.key("r")
    gui.key("esc")
    assert gui.session.view.theme == theme
    assert not gui.window.dialogs.is_open
    gui.key("ctrl+o")
    gui.frames(3)
    gui.click("folder")
    gui.key("esc")  # the first press leaves the box
    assert gui.window.dialogs.is_open
    gui.key("esc")
    assert not gui.window.dialogs.is_open
    gui.key("ctrl+q")
    assert gui.window.closing  # without a question, as everything is saved


# Dialogs


def open_by_keys_and_drop(gui, mesh_file, tmp_path):
    gui.key("ctrl+o")
    gui.type("folder", str(tmp_path / "nowhere.off"))
    assert gui.window.dialogs.is_open
    gui.wait(lambda s: mesh_file.name in gui.labels())
    while gui.text_of(mesh_file.name) != "chosen":
        gui.key("down")
    gui.key("enter")
    opened(gui, 42)
    gui.session.undo()
    gui.window._dropped([str(mesh_file), str(tmp_path / "second.npz")])
    check_message(gui.session.notices.latest.text, 2)
    opened(gui, 42)
    gui.window._dropped([])
    assert gui.errors == {}
    assert gui.window.files.state.recent() == [(mesh_file,)]


def list_ten_thousand_files(gui, monkeypatch):
    """Check that frames only read the entries in view."""
    entries = (FolderEntry(f"{number:05}.off", False) for number in range(10_000))
    listing = Listing(LazyEntries(entries))
    monkeypatch.setattr(file_dialog, "read_folder", lambda *_: listing)
    gui.key("ctrl+o")
    gui.wait(lambda s: "00000.off" in gui.labels())
    gui.input.move(280, 200)
    assert len(gui.window.ui.widgets) < 700
    gui.key("esc")


class LazyEntries(tuple):
    """Entries of which only some may be read."""

    def __iter__(self):
        pytest.fail("all entries are looked at")


def fail_after_a_dialog(gui, mesh_file, capsys):
    gui.window.dialogs.open("Open", (".off",), lambda path: 1 / 0)
    gui.wait(lambda s: mesh_file.name in gui.labels())
    gui.click(mesh_file.name)
    gui.click("Open")
    gui.frames(3)
    check_message(gui.session.notices.latest.text)
    assert not gui.window.dialogs.is_open
    assert gui.is_enabled("Match")
    assert "ZeroDivisionError" in capsys.readouterr().err


# Closing, dropped files, preferences, recovery


def test_preferences_are_stored(state, launched):
    with launched() as gui:
        gui.key("l")
        gui.menu("View", "UI scale", "1.25")
        gui.menu("View", "Flow after a match")
        gui.session.matching.follow = False
        gui.frames(2)
    expected = {"theme": "dark", "ui_scale": 1.25, "follow": False, "flow_after_match": False}
    assert PreferenceFile(state).now == Preferences(**expected)
    with launched() as gui:
        assert (gui.session.view.theme, gui.session.view.ui_scale) == ("dark", 1.25)
        assert not gui.session.matching.follow
        assert not gui.session.view.flow_after_match
        assert not gui.session.saves.unsaved
        assert gui.session.editor.undo_label == ""


def test_damaged_copy_is_reported_once(state, launched):
    crashed = state.path / "autosave-999999999.abfm"  # larger than any process id
    state.path.mkdir()
    crashed.write_bytes(b"PK")
    with launched() as gui:
        gui.wait(lambda s: s.notices.latest.is_error)
        check_message(gui.session.notices.latest.text)
    assert not crashed.exists()
    assert (state.path / f"unreadable-{crashed.name}").read_bytes() == b"PK"


# Launch


def draw_half_of_the_time(gui, monkeypatch):
    """Check that the window sleeps as long as it draws while functions are pending."""
    for waiting_since, rest in ((None, 0.002), (0.0, 0.2)):
        now, slept = [100.0], []

        def draw(waiting_since=waiting_since, now=now):
            gui.session.functions.waiting_since = waiting_since
            now[0] += 0.2

        clock = SimpleNamespace(perf_counter=lambda now=now: now[0], sleep=slept.append)
        with monkeypatch.context() as patched:
            patched.setattr(gui.window, "tick", draw)
            patched.setattr(window, "time", clock)
            gui.window._moved_at = now[0]
            gui.window.frame()
        gui.session.functions.waiting_since = None
        assert slept == [pytest.approx(rest)]


def test_window_opens_before_the_solver_is_loaded(tmp_path):
    done = python(
        "import sys; from abfm_viewer.scene import opengl; from pathlib import Path\n"
        "from abfm_viewer.window.window import open_window\n"
        "import abfm_viewer.session.session as s; s.Session._find_defaults = lambda self: None\n"
        f"state = Path({str(tmp_path)!r})\n"
        "window = open_window(None, opengl.OFFSCREEN_BACKEND, (640, 400), state)\n"
        "window.tick(); print(sorted({'numba', 'scipy', 'igl', 'cholespy', 'trimesh'} & "
        "set(sys.modules)))\n"
        "print(window.errors); window.close()"
    )
    assert done.stdout == "[]\n{}\n", done.stderr


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["missing.off"], ""),
        (["missing.abfm"], "missing.abfm"),
        (["missing.npz"], "missing.npz"),
        (["~no-user/m.off"], ""),
        ([__file__], ""),
        (["a.off", "b.off", "c.off"], "c.off"),
        (["a.abfm", "b.off"], "a.abfm"),
        (["--largest"], "--largest-component"),
    ],
)
def test_bad_arguments_exit_with_status_2(words, named, capsys):
    assert app.main(words) == 2
    message = capsys.readouterr().err
    assert message.startswith("abfm-viewer: ")
    assert message.count("\n") == 1
    check_message(message, named)


def test_window_has_its_own_sizes(launched):
    """Widgets have the same places although an earlier window changed ImGui's font scale."""

    def places():
        with launched() as gui:
            gui.frames(2)
            return {(w.label, w.section): w.rect for w in gui.window.ui.widgets}

    before = places()
    imgui.GetStyle().FontScaleMain = 1.5
    assert places() == before


_CLOSED = """
import sys
from pathlib import Path
from abfm_viewer.window.window import open_window
from abfm.assets import asset_path
for moment, iterations in (("solver", 100_000), ("streaks", 10)):
    window = open_window(asset_path("eight.off"), "openGL3_egl", (400, 300), Path(sys.argv[1]))
    assert Path(window.preferences.now.folders["meshes"][0]) == asset_path("eight.off").parent
    session = window.session
    while session.obstacle:
        window.frame()
    session.editor.set_view("look", streaks=True)
    session.editor.set_parameter(iterations=iterations, tolerance=0)
    session.match()
    streaks = window.shown.quantities._streaks
    while not (streaks.busy if moment == "streaks" else session.matching.snapshot):
        window.frame()
    window.close()
"""


def test_closing_during_work_leaves_nothing_behind(tmp_path):
    done = python(_CLOSED, str(tmp_path))
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


_PROGRAM = """
import atexit, sys
from abfm_viewer import app
class Slow:
    def __del__(self):
        print("taken apart")
def run(words):
    atexit.register(lambda: print("tidied up"))
    print("closed", words)
    return 7
app._run = run
kept = sys.modules["kept"] = Slow()
sys.argv[1:] = ["a.off"]
status = app.main({words})
sys.exit(status)
"""


@pytest.mark.parametrize(("words", "name"), [("", "a.off"), ("['b.off']", "b.off")])
def test_program_ends_after_cleanup(words, name):
    done = python(_PROGRAM.replace("{words}", words))
    assert (done.returncode, done.stderr) == (7, "")
    lives_on = ["taken apart"] if words else []
    assert done.stdout.splitlines() == [f"closed ['{name}']", "tidied up", *lives_on]


_COUNT_COMPILED = """
from abfm_viewer.window import warm_up
warm_up.start().join()
from abfm.flow import exponential
from abfm.mesh import coarsening
from abfm.numerics import optimizer
from abfm.streaks import line_integral
import sys  # the package has a function of this name
texture_atlas = sys.modules["abfm.streaks.texture_atlas"]
for module in (exponential, coarsening, optimizer, line_integral, texture_atlas):
    own = [v for v in vars(module).values() if getattr(v, "__module__", "") == module.__name__]
    print(module.__name__, sum(bool(getattr(value, "signatures", ())) for value in own))
"""


def test_kernels_are_compiled_before_the_first_match():
    done = python(_COUNT_COMPILED, check=True)
    compiled = {name: int(count) for name, count in map(str.split, done.stdout.splitlines())}
    assert len(compiled) == 5
    assert min(compiled.values()) > 0, compiled


def test_figure_keeps_only_the_theme_of_the_view():
    forgotten = {"blend": True, "transport": True, "animate": True, "coloring": "checker"}
    document, _ = figure_document(7, View(theme="dark", **forgotten))
    assert document.view.theme == "dark"
    for name in forgotten:
        assert getattr(document.view, name) == getattr(View(), name)
