"""Tours of messages: errors with their remedies, loading, questions, and the log."""

import threading

import numpy as np
import polyscope.imgui as imgui
import pytest
from PIL import Image

from abfm_viewer.session import session_files
from tests.mesh_writers import off_file, off_text, write
from tests.messages import check_message
from tests.shapes import icosphere
from tests.viewer.sessions import ENDLESS, SHORT, begin, match

WINDOW = (560, 560)  # high enough for two cards below the names of surfaces in a row


@pytest.fixture
def two_spheres(tmp_path):
    """Return a mesh file with two components."""
    small, large = icosphere(1), icosphere(2)
    vertices = np.concatenate([small.vertices, 2 * large.vertices + 9])
    faces = np.concatenate([small.faces, large.faces + len(small.vertices)])
    return write(tmp_path, "two.off", off_text(vertices, faces))


def cards(gui):
    """Return the buttons of each card, the latest card first."""
    gui.frames(2)
    found = {}
    for widget in gui.window.ui.widgets:
        if widget.section.startswith("message "):
            found.setdefault(widget.section, []).append(widget.label)
    return list(found.values())


def test_tour_of_remedies(gui, walk):
    """Files that cannot be read or written have cards with remedies until they are repaired."""
    gui.session.editor.set_view("row", layout="row")
    walk(gui, copy_the_log_and_read_the_title, open_the_largest_component, merge_and_clean)
    walk(gui, open_another_table, repair_a_bad_file, retry_a_failed_save)
    walk(gui, return_the_keyboard, leave_mouse_and_keys)


def test_tour_of_questions(gui, walk):
    """Meshes are opened, and the window closed, during a run and after it, with questions."""
    gui.session.editor.set_view("row", layout="row")
    walk(gui, cancel_opening)
    walk(gui, answer_during_a_run, show_two_cards, parameters=ENDLESS)
    walk(gui, save_replaced_document, parameters=SHORT)


def open_the_largest_component(gui, two_spheres):
    gui.window._dropped([str(two_spheres)])
    gui.wait(lambda s: s.notices.cards)
    assert cards(gui) == [["Largest component", "Open another mesh...", "Dismiss"]]
    check_message(gui.session.notices.cards[0].text)
    gui.click("Open another mesh...", "message 1")
    assert gui.window.dialogs.is_open
    gui.click("Cancel", "Open a mesh")
    assert cards(gui) == []  # the user's next action dismisses the card
    gui.window._dropped([str(two_spheres)])
    gui.wait(lambda s: s.notices.cards)
    gui.click("Largest component")
    gui.wait(lambda s: len(s.surface().mesh.vertices) == 162)
    assert cards(gui) == []


def merge_and_clean(gui, tmp_path):
    """Open split meshes and both hemispheres by their remedies."""
    sphere = icosphere(1)
    corners = sphere.vertices[sphere.faces.ravel()]
    split = write(tmp_path, "s.off", off_text(corners, np.arange(240).reshape(-1, 3)))
    faces = np.concatenate([sphere.faces, sphere.faces + 42, [[0, 1, 1]]])
    both = np.concatenate([sphere.vertices + np.array([3, 0, 0]), sphere.vertices])
    both = write(tmp_path, "both.off", off_text(both, faces))
    for path, labels, chosen, middle in (
        (both, ["Clean, left", "Clean, right"], "Clean, left", 0),
        (split, ["Merge vertices"], "Merge vertices", 0),
        (both, ["Clean, left", "Clean, right"], "Clean, right", 3),
    ):
        gui.window._dropped([str(path)])
        gui.wait(lambda s: s.notices.cards)
        assert cards(gui) == [[*labels, "Open another mesh...", "Dismiss"]]
        check_message(gui.session.notices.cards[0].text)
        gui.click(chosen)
        gui.wait(lambda s, name=path.name: s.document.name == name)
        mesh = gui.session.surface().mesh
        assert mesh.vertices[:, 0].mean() == pytest.approx(middle, abs=1e-6)
        assert cards(gui) == []
    gui.click("Undo")
    gui.wait(lambda s: s.document.name == "s.off")
    assert len(gui.session.surface().mesh.copies) == 240 - 42


def open_another_table(gui, tmp_path):
    gui.window.files.open(tmp_path)
    gui.wait(lambda s: s.notices.cards)
    gui.click("Open another table...")
    assert gui.window.dialogs.is_open
    gui.click("Cancel", "Open a batch or population")


def repair_a_bad_file(gui, tmp_path):
    """Check that a card stays until its file is repaired; the newest has the remedy."""
    bad = tmp_path / "bad.off"
    bad.write_text("OFF\nnonsense\n")
    gui.window._dropped([str(bad)])
    gui.wait(lambda s: s.notices.cards)
    gui.session.editor.set_parameter(alpha=2)
    gui.frames(30)
    assert cards(gui) == [["Try again", "Open another mesh...", "Dismiss"]]
    off_file(bad, icosphere(1))
    gui.click("Try again")
    gui.wait(lambda s: s.document.name == "bad.off")
    assert cards(gui) == []
    for count, path in enumerate([tmp_path / name for name in ("one.off", "two.off")], 1):
        path.write_text("OFF\nnonsense\n")
        gui.window._dropped([str(path)])
        gui.wait(lambda s, count=count: len(s.notices.cards) == count)
    first = ["Try again", "Open another mesh...", "Dismiss"]
    assert cards(gui) == [first, ["Try again", "Dismiss"]]
    gui.click("Try again", within="message 2")  # the remedy opens the intended file
    gui.wait(lambda s: len(s.notices.cards) == 2 and not s.loading.now)
    assert ["one.off" in card.text for card in gui.session.notices.cards] == [True, False]
    gui.click("Dismiss", within="message 1")
    assert cards(gui) == [first]


def show_two_cards(gui):
    notices, done = gui.session.notices, []
    begin(gui)
    for word in ("first", "second"):  # the file has one card, with the newest remedies
        notices.show("a problem", True, remedies={"Try again": lambda word=word: done.append(word)})
        notices.show("another", True)
    assert cards(gui) == [["Dismiss"], ["Try again", "Dismiss"]]
    gui.click("Try again")
    assert done == ["second"]
    gui.key("esc")
    for number in (0, 1, 2, 3, 4, 4):  # the last message is not repeated
        notices.show(f"problem {number}", is_error=True)
    assert cards(gui) == [["Dismiss"]] * 2
    gui.click("Dismiss", "message 2")
    assert [card.text[-1] for card in notices.cards] == ["4", "2", "1", "0"]
    gui.key("esc")
    assert notices.cards[0].text == "problem 2"
    while notices.cards:
        gui.key("esc")
    assert gui.session.solver.running
    gui.key("esc")
    gui.wait(lambda s: s.solver.finished)


def leave_mouse_and_keys(gui, tmp_path):
    """Check that cards take no clicks next to them, take no keys, and are in front."""
    gui.click("Match", "steps")
    gui.click("sigma")
    assert imgui.GetIO().WantTextInput
    gui.session.notices.show("a problem", is_error=True)
    gui.frames(5)
    assert imgui.GetIO().WantTextInput
    card = next(w for w in gui.window.ui.widgets if w.section == "message 1")
    left, top, _, bottom = card.area
    gui.input.move((left + gui.window.parts.scene[0]) / 2, (top + bottom) / 2)
    assert not imgui.GetIO().WantCaptureMouse
    gui.input.move(*card.rect[:2])
    assert imgui.GetIO().WantCaptureMouse
    for theme in ("light", "dark"):
        gui.session.editor.set_view("theme", theme=theme)
        gui.session.notices.show("a problem " * 30, is_error=True)
        gui.frames(3)
        card = next(w for w in gui.window.ui.widgets if w.section == "message 1")
        left, top, right, bottom = map(int, card.area)
        assert gui.window.parts.scene[0] <= left < right <= gui.window.parts.scene[2]
        gui.screenshot(tmp_path / "a.png")
        pixels = np.asarray(Image.open(tmp_path / "a.png").convert("RGB"), dtype=int)
        inside = pixels[top + 4 : bottom - 4, left + 4 : right - 4].reshape(-1, 3)
        panel = np.array(gui.window.ui.colors.panel[:3]) * 255
        assert (np.abs(inside - panel).max(axis=1) < 6).mean() > 0.5


def retry_a_failed_save(gui, tmp_path):
    path = tmp_path / "inner" / "a.abfm"
    path.parent.mkdir()
    gui.session.editor.set_parameter(alpha=2)
    gui.window.files.save(path)
    gui.wait(lambda s: s.saves.path)
    path.unlink()
    path.parent.rmdir()
    gui.session.editor.set_parameter(alpha=3)
    gui.key("ctrl+s")
    gui.wait(lambda s: s.notices.cards)
    gui.click("Save as...", "message 1")
    assert gui.window.dialogs.is_open
    gui.click("Cancel", "Save the project")
    gui.key("ctrl+s")
    gui.wait(lambda s: s.notices.cards)
    path.parent.mkdir()
    gui.click("Try again")
    gui.wait(lambda s: not s.saves.unsaved)
    assert cards(gui) == []


def return_the_keyboard(gui, tmp_path):
    """Check that the box gets the keyboard back after a save."""
    gui.window.files.save(tmp_path / "none" / "a.abfm")  # a folder that does not exist
    gui.wait(lambda s: s.notices.cards)
    gui.type("spec", "gaussian:vertex=3,width=0.2", within="source", enter=False)
    gui.key("ctrl+s")
    gui.frames(3)
    gui.click("Cancel", "Save the project")
    gui.wait(lambda _: imgui.GetIO().WantTextInput)
    assert gui.session.active.source == "gaussian:vertex=3,width=0.2"
    gui.input.write("coordinate:x")
    gui.key("enter")
    assert gui.session.active.source == "coordinate:x"


def cancel_opening(gui, tmp_path, monkeypatch):
    path, may_continue = off_file(tmp_path / "slow.off", icosphere(1)), threading.Event()
    read = session_files.load_mesh

    def slow(*words, **options):
        assert may_continue.wait(60)
        return read(*words, **options)

    monkeypatch.setattr(session_files, "load_mesh", slow)
    before = gui.session.surface().mesh
    gui.window._dropped([str(path)])
    gui.wait(lambda s: any(w.section == "opening" for w in gui.window.ui.widgets))
    assert not gui.is_enabled("Match")
    gui.key("ctrl+enter")
    assert not gui.session.solver.running
    gui.click("Cancel", "opening")
    assert gui.is_enabled("Match")
    may_continue.set()
    gui.frames(10)
    assert gui.session.surface().mesh is before
    gui.window._dropped([str(path)])
    gui.wait(lambda s: len(s.surface().mesh.vertices) == 42)
    assert not [w for w in gui.window.ui.widgets if w.section == "opening"]


def copy_the_log_and_read_the_title(gui, tmp_path):
    """Check the name of the document in the title, and whether it is saved."""
    gui.session.notices.show("first a notice")
    gui.window._dropped([str(tmp_path / "song.mp3")])
    gui.menu("Help", "Messages")
    gui.click("Copy")
    lines = imgui.GetClipboardText().splitlines()
    assert lines[0].endswith("notice: first a notice")
    assert "error: song.mp3 cannot be opened" in lines[1]
    gui.click("Close", "Messages")
    saves = gui.session.saves
    assert saves.title == "mesh"
    gui.session.editor.set_parameter(alpha=2)
    assert saves.title == "* mesh"
    gui.window.files.save(tmp_path / "mine.abfm")
    gui.wait(lambda s: not s.saves.unsaved)
    assert saves.title == "mine.abfm"
    assert gui.window.title._now == "mine.abfm - abfm"


def save_replaced_document(gui, tmp_path):
    """Close, with a question about work that another mesh replaced."""
    match(gui)
    found = gui.session.result
    gui.window.files.open(off_file(tmp_path / "b.off", icosphere(1)))
    gui.wait(lambda s: s.document.name == "b.off" and s.channels)
    gui.key("ctrl+q")
    assert gui.window.dialogs.has_question("Save before closing?")
    gui.click("Save", within="Save before closing?")
    gui.type("file name", "kept")
    gui.wait(lambda _: gui.window.closing)
    gui.window.closing = False
    gui.window.files.open(tmp_path / "kept.abfm")
    gui.wait(lambda s: s.result is not None)
    np.testing.assert_array_equal(gui.session.result.velocity, found.velocity)


def answer_during_a_run(gui, tmp_path):
    """Give every answer to the question, which changes when the run ends."""
    path, session = off_file(tmp_path / "b.off", icosphere(1)), gui.session
    begin(gui)

    def drop():
        gui.window._dropped([str(path)])
        gui.wait(lambda _: gui.window.dialogs.has_question("End the run?"))

    drop()
    gui.click("Go back", within="End the run?")
    assert session.solver.running
    drop()
    session.solver.cancel()
    gui.wait(lambda _: gui.window.dialogs.has_question("Replace the result?"))
    assert not gui.window.dialogs.has_question("End the run?")
    gui.click("Go back", within="Replace the result?")
    assert session.result is not None
    for answer, question in (("End the run", "End the run?"), ("Replace", "Replace the result?")):
        begin(gui)
        drop()
        if answer == "Replace":
            session.solver.cancel()
        gui.click(answer, within=question)
        gui.wait(lambda s: s.document.name == "b.off")
        gui.key("ctrl+z")
        assert session.result is not None
