"""Actions: one table for the keyboard, the hints in the menus and the list in Help."""

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import polyscope.imgui as imgui

from abfm.pages.front import Front, triple
from abfm_viewer.document.document import Document, Viewpoint
from abfm_viewer.files.contents import PROJECT, RESULT
from abfm_viewer.panels.context import Context
from abfm_viewer.panels.time_bar import STEP
from abfm_viewer.session.session import Session
from abfm_viewer.session.session_files import OTHER_NAME

COMMAND = "Cmd" if sys.platform == "darwin" else "Ctrl"
AXES = {"x": "X", "y": "Y", "z": "Z", "-x": "Shift+X", "-y": "Shift+Y", "-z": "Shift+Z"}
"""And the keys to look from them."""
_ESCAPE = (
    "close a menu; else take a message away; else show all surfaces; else cancel, and keep the "
    "best field, from which Continue goes on"
)
_QUIT = "Save before closing?"
_MOUSE = (
    ("drag on a surface", "turn them all, each in its place"),
    ("drag beside a surface", "turn them about their upright axis, or tilt it"),
    ("right or middle drag", "move them"),
    ("wheel", "nearer to or farther from what is under the mouse"),
    ("double click", "one surface large, or all again"),
    ("Shift+click, Shift+drag", "on the source or target: move the active Gaussian"),
    ("Shift+wheel", "wider or narrower Gaussian"),
    ("drag a landmark", "move it along its surface"),
    ("drop files", "open a mesh, a project or a result; two meshes as surfaces A and B; frames"),
    ("drop a folder", "open the results of a batch or population as a table"),
)
_ARROWS = {name: f"{name}Arrow" for name in ("Left", "Right", "Up", "Down")}
_KEYS = _ARROWS | {"Esc": "Escape"}


@dataclass(eq=False)
class Action:
    """Something that keys do; `group` is its heading in the list in Help."""

    group: str
    does: str
    keys: str  # such as "Ctrl+Y or Ctrl+Shift+Z"; on a Mac Cmd
    do: Callable[[], None]
    repeats: bool = False  # while the key is held
    while_typing: bool = False  # also in a text box, which then takes what was typed

    @property
    def chords(self) -> list[str]:
        return self.keys.split(" or ")

    @property
    def hint(self) -> str:
        """The first chord, as the user's keyboard calls it."""
        return self.chords[0].replace("Ctrl", COMMAND)

    @property
    def is_pressed(self) -> bool:
        io = imgui.GetIO()
        for key, ctrl, shift in map(_parts, self.chords):
            held = (ctrl, shift) == (io.KeyCtrl, io.KeyShift)
            if held and imgui.IsKeyPressed(key, self.repeats):
                return True
        return False


@cache
def _parts(chord: str) -> tuple[imgui.ImGuiKey, bool, bool]:
    *modifiers, name = chord.split("+")
    key = getattr(imgui, f"ImGuiKey_{_KEYS.get(name, name)}")
    return key, "Ctrl" in modifiers, "Shift" in modifiers


def axis_front(axis: str) -> Front:
    """Return the side that an axis points out of; seen along y, z is upright."""
    direction = (-1.0 if axis.startswith("-") else 1.0) * np.eye(3)["xyz".index(axis[-1])]
    up = np.eye(3)[1] if axis[-1] != "y" else -direction[1] * np.eye(3)[2]
    return Front(triple(direction), triple(up))


def what_would_be_lost(session: Session) -> str:
    """Say of each document what is in no file, for the question before closing."""
    said, running = [], session.solver.running
    if running:
        name = session.document.name
        said.append(f"{name} is being matched; the best field so far is in no file.")
    for document in session.saves.unsaved_documents:
        if not (running and document.identity is session.document.identity):
            said.append(session.saves.unsaved_text(document))
    return " ".join(said)


class Actions:
    """The window's commands; each `Action` is an attribute, and `all` has them in the list's order.

    `over` names the surface under the mouse, and `close` closes the window without a question.
    """

    def __init__(
        self, context: Context, over: Callable[[], str], close: Callable[[], None]
    ) -> None:
        self.context, self._over, self._close = context, over, close
        self._waiting: Action | None = None
        self._left = ""  # the box that was typed into when a save began: it gets the keyboard back
        self._session, self._files, self._dialogs = context.session, context.files, context.dialogs
        session = context.session
        set_time, set_view = session.set_time, session.editor.set_view
        files = partial(Action, "Files", while_typing=True)
        self.open_mesh = files("open a mesh", "Ctrl+O", context.open_mesh)
        title, formats = "Open a project or a result", (PROJECT, RESULT)
        do = partial(context.dialogs.open, title, formats, context.files.open)
        self.open_project = files("open a project or a result", "Ctrl+Shift+O", do)
        self.save = files("save the project", "Ctrl+S", self._save)
        what = "save the project under another name"
        self.save_as = files(what, "Ctrl+Shift+S", self._ask_where)
        self.quit = files("quit", "Ctrl+Q", self._quit)
        changes = partial(Action, "Changes", repeats=True)
        self.undo = changes("undo", "Ctrl+Z", session.undo)
        self.redo = changes("redo", "Ctrl+Y or Ctrl+Shift+Z", session.redo)
        marks = partial(Action, "Landmarks")
        what = "place landmarks by clicks, or stop that"
        self.place_landmarks = marks(what, "M", self._switch_placing)
        what, remove = "remove the chosen landmark", session.editor.remove_landmark
        self.remove_landmark = marks(what, "Delete or Backspace", remove)
        solver = partial(Action, "Solver")
        self.match = solver("match", "Ctrl+Enter", session.match, while_typing=True)
        self.pause = solver("pause or resume", "P", self._pause)
        self.cancel = solver(_ESCAPE, "Esc", self._escape)
        what = "show a smoother step of the path, or the row above"
        self.smoother = solver(what, "Up", lambda: self._along(-1))
        what = "show a closer step of the path, or the row below"
        self.closer = solver(what, "Down", lambda: self._along(1))
        times, step = partial(Action, "Time"), self._step
        self.play = times("play or pause", "Space", session.player.toggle)
        self.back = times("a twentieth of τ back", "Left", lambda: step(-STEP), repeats=True)
        self.on = times("a twentieth of τ on", "Right", lambda: step(STEP), repeats=True)
        self.go_to_start = times("to time 0", "Home", lambda: set_time(session.document.start))
        self.go_to_end = times("to τ", "End", lambda: set_time(session.document.last_target_time))
        views, switch = partial(Action, "View"), self._switch
        self.switch_theme = views("light or dark", "L", self._switch_theme)
        show = self._dialogs.show
        self.show_shortcuts = views("this list", "F1", lambda: show("Shortcuts", self.listed()))
        do = partial(set_view, "look from the front", viewpoint=None)
        self.reset = views("look from the front again", "R", do)
        self.axes = {
            axis: views(f"look from {axis}", keys, partial(self._look_from, axis))
            for axis, keys in AXES.items()
        }
        self.wireframe = views("wireframe", "W", lambda: switch("wireframe", "the wireframe"))
        self.flat = views("flat or smooth", "F", lambda: switch("flat", "flat shading"))
        self.hide = views("hide the surface under the mouse", "H", self._hide)
        do = partial(set_view, "show all surfaces", hidden=(), enlarged="")
        self.show_all = views("show all surfaces", "Shift+H", do)
        own = (one.values() if isinstance(one, dict) else [one] for one in vars(self).values())
        self.all = tuple(one for some in own for one in some if isinstance(one, Action))

    # Keys

    def do_pressed(self) -> None:
        """Do what the keys pressed in this frame stand for, unless they are meant for a text box, a
        menu or a drag: call it at the end of every frame.
        """
        context, io = self.context, imgui.GetIO()
        action, self._waiting = self._waiting, None
        is_meant = not (io.KeyAlt or io.KeySuper)
        is_meant = is_meant and (io.WantTextInput or not imgui.IsAnyItemActive())
        if action is None and is_meant:
            meant = (one for one in self.all if one.while_typing or not io.WantTextInput)
            action = next((one for one in meant if one.is_pressed), None)
            if action is not None and io.WantTextInput:
                saves = action in (self.save, self.save_as)
                self._left = context.ui.active_box if saves else ""
                # to a window without text boxes: in the next frame the box gives what was typed
                imgui.SetWindowFocus("status line")
                action, self._waiting = None, action
        if action is not None:
            action.do()
        elif self._left and not (context.files.saving or self._waiting or context.dialogs.is_open):
            context.ui.focus_next, self._left = self._left, ""

    # Help

    def listed(self) -> list[tuple[str, str]]:
        """Return the list in Help: keys and what they do; a heading has an empty second part."""
        rows: list[tuple[str, str]] = []
        for group in dict.fromkeys(action.group for action in self.all):
            rows.append((group, ""))
            actions = [action for action in self.all if action.group == group]
            rows += [(action.keys.replace("Ctrl", COMMAND), action.does) for action in actions]
        return [*rows, ("Mouse", ""), *_MOUSE]

    def show_messages(self) -> None:
        rows = [
            (f"{time.strftime('%H:%M:%S', time.localtime(entry.time))}   {entry.kind}", entry.text)
            for entry in self._session.notices.log
        ]
        copied = "\n".join(f"{when.replace('   ', ' ')}: {text}" for when, text in rows)
        self._dialogs.show("Messages", rows[::-1] or ["There are none yet."], copied)

    def show_about(self) -> None:
        from importlib.metadata import version  # it takes a while to load

        lines = [
            f"abfm {version('abfm')}",
            "Finds the tangent vector field whose flow carries one function on a surface to "
            "another.",
            "After: O. Azencot, O. Vantzos, M. Ben-Chen, Advection-based function matching on "
            "surfaces, Computer Graphics Forum 35 (5), 2016.",
            f"Python {sys.version.split()[0]}, NumPy {np.__version__}, polyscope "
            f"{version('polyscope')}.",
            "MIT licence.",
        ]
        self._dialogs.show("About abfm", lines)

    # Files

    def _quit(self) -> None:
        """Close the window, after a question if work is unsaved."""
        self._files.stop_waiting()
        if self._files.saving:
            self._files.when_saved(self._quit)
        elif not (self._session.saves.unsaved_documents or self._session.solver.running):
            self._close()
        elif not self._dialogs.has_question(_QUIT):
            answers = {"Save": self._save_and_close, "Don't save": self._close, "Go back": None}
            text = partial(what_would_be_lost, self._session)  # which runs that end change
            self._dialogs.question(_QUIT, text, answers)

    def _save_and_close(self) -> None:
        if self._session.solver.running and self._session.solver.has_found:
            self._files.end_run("saving and closing", self._save_and_close)
        else:  # a run without a field so far has nothing to save
            self._session.solver.cancel()
            self._save_all(list(self._session.saves.unsaved_documents), self._close)

    def _save_all(self, documents: list[Document], then: Callable[[], None]) -> None:
        if documents:
            self._save(partial(self._save_all, documents[1:], then), documents[0])
        else:
            then()

    def _save(
        self, then: Callable[[], None] | None = None, document: Document | None = None
    ) -> None:
        """Save a document, by default the present one, where it is; if nowhere, ask where."""
        document = document or self._session.document
        origin = self._session.saves.origin(document)
        is_present = document.identity is self._session.document.identity
        taken_back = is_present and document is not self._session.document
        if origin is None or taken_back:
            self._ask_where(then, document)
            return
        write = partial(self._files.save, origin.path, then, document)
        # what is being saved was changed by this window
        if self._files.saving or not origin.changed:
            write()
            return
        text = (
            f"{origin.path.name} has changed since it was opened or saved here. Saving takes the "
            "place of what is in it now."
        )
        other = partial(self._ask_where, then, document)
        answers = {OTHER_NAME: other, "Replace": write, "Go back": None}
        self._dialogs.question("Replace a changed file?", text, answers)

    def _ask_where(
        self, then: Callable[[], None] | None = None, document: Document | None = None
    ) -> None:
        document = document or self._session.document
        origin = self._session.saves.origin(document)
        name = (origin.path if origin else Path(document.name)).with_suffix(PROJECT).name
        is_present = document.identity is self._session.document.identity
        title = "Save the project" if is_present else f"Save the project of {document.name}"
        save = self._files.save
        self._dialogs.save(title, (PROJECT,), name, lambda path: save(path, then, document))

    # Solver, time and view

    def _pause(self) -> None:
        solver = self._session.solver
        solver.resume() if solver.paused else solver.pause()

    def _escape(self) -> None:
        view, notices = self._session.view, self._session.notices
        if notices.cards:
            notices.dismiss(notices.cards[0])
        elif view.enlarged in view.shown_surfaces and len(view.shown_surfaces) > 1:
            self._session.editor.amend(view=replace(view, enlarged=""))
        else:
            self._session.solver.cancel()

    def _along(self, count: int) -> None:
        if self._files.tables.has_keys:
            self._files.tables.move(count)
        elif not self._session.solver.running:
            self._session.show_step(self._session.steps.shown + count)

    def _step(self, share: float) -> None:
        self._session.set_time(self._session.document.time_after(share))

    def _switch_placing(self) -> None:
        if self._session.document.has_sides:
            self._session.editor.switch_placing()
        else:
            self._session.notices.show("landmarks are for a match of two functions, not for a film")

    def _switch(self, name: str, what: str) -> None:
        shown = getattr(self._session.view, name)
        step = f"{'hide' if shown else 'show'} {what}"
        self._session.editor.set_view(step, "", **{name: not shown})

    def _switch_theme(self) -> None:
        other = "dark" if self._session.view.theme == "light" else "light"
        self._session.editor.set_view("change the theme", theme=other)

    def _look_from(self, axis: str) -> None:
        front, viewpoint = axis_front(axis), self._session.view.viewpoint
        seen = replace(viewpoint, front=front) if viewpoint else Viewpoint(front)
        self._session.editor.set_view(f"look from {axis}", viewpoint=seen)

    def hide_or_show(self, name: str) -> None:
        """Hide a surface, unless it is the last one, or show it again."""
        view = self._session.view
        if name in view.hidden:
            others = tuple(one for one in view.hidden if one != name)
            self._session.editor.set_view(f"show {name}", hidden=others)
        elif view.shown_surfaces == (name,):
            self._session.notices.show(f"{name} is the only surface that is shown")
        else:
            enlarged = "" if view.enlarged == name else view.enlarged
            self._session.editor.set_view(
                f"hide {name}", hidden=(*view.hidden, name), enlarged=enlarged
            )

    def _hide(self) -> None:
        if name := self._over():
            self.hide_or_show(name)
        else:
            self._session.notices.show("H hides the surface under the mouse: point at one")
