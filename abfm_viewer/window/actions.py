"""Actions of the keyboard, with the hints in the menus and the list in Help."""

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import polyscope.imgui as imgui

from abfm import TriangleMesh
from abfm.display import BEST_VIEW, VIEWS, ViewName, ViewSpec
from abfm.pages.front import Front, front_of
from abfm_viewer.document.document import SIDES, Document, Viewpoint
from abfm_viewer.document.keyboard import AXES, COMMAND, KEYS, hint
from abfm_viewer.files.contents import PROJECT, RESULT
from abfm_viewer.files.names import suggested_name
from abfm_viewer.panels import export, result_table
from abfm_viewer.panels.context import Context
from abfm_viewer.panels.time_bar import STEP
from abfm_viewer.session.session import Session
from abfm_viewer.session.session_files import OTHER_NAME
from abfm_viewer.window.tour import Tour

_ESCAPE = (
    "in this order: close a menu, end the tour, dismiss a message, show all surfaces, cancel the "
    "match (Continue resumes from the best field)"
)
_QUIT = "Save before closing?"
_MOUSE = (
    ("drag on a surface", "turn all surfaces, each in its place"),
    ("drag next to a surface", "turn all surfaces about their upright axis, or tilt it"),
    ("right or middle drag", "move all surfaces"),
    ("wheel", "zoom in or out at the mouse"),
    ("double click", "enlarge one surface, or show all again"),
    ("Shift+click, Shift+drag", "on the source or target: move the active Gaussian"),
    ("Shift+wheel", "make the Gaussian wider or narrower"),
    ("drag a landmark", "move it along its surface"),
    ("drop files", "open a mesh, a project, a result or frames; two meshes as surfaces A and B"),
    ("drop a folder", "open the results of a batch or population as a table"),
)
_ARROWS = {name: f"{name}Arrow" for name in ("Left", "Right", "Up", "Down")}
_KEYS = _ARROWS | {"Esc": "Escape"}


@dataclass(eq=False)
class Action:
    """Something that the user can do with keys."""

    group: str  # heading in the list in Help
    text: str  # description in the list in Help
    name: str  # in `KEYS`
    do: Callable[[], None]
    repeats: bool = False  # while the key is pressed
    while_typing: bool = False  # also in a text box, after its text is taken over

    @property
    def hint(self) -> str:
        """The first shortcut, with the names of keys on the user's keyboard."""
        return hint(self.name)

    @property
    def chords(self) -> list[str]:
        return KEYS[self.name].split(" or ")

    @property
    def is_pressed(self) -> bool:
        io = imgui.GetIO()
        for key, ctrl, shift in map(_parts, self.chords):
            has_modifiers = (ctrl, shift) == (io.KeyCtrl, io.KeyShift)
            if has_modifiers and imgui.IsKeyPressed(key, self.repeats):
                return True
        return False


@cache
def _parts(chord: str) -> tuple[imgui.ImGuiKey, bool, bool]:
    *modifiers, name = chord.split("+")
    key = getattr(imgui, f"ImGuiKey_{_KEYS.get(name, name)}")
    return key, "Ctrl" in modifiers, "Shift" in modifiers


def views_by_axis(mesh: TriangleMesh) -> dict[str, tuple[ViewName, Front]]:
    """Return the name and the front of the view of a mesh from each axis, "x" to "-z"."""
    found = {}
    for name in VIEWS[1:]:
        front = front_of(mesh, view=ViewSpec(name))
        number = int(np.argmax(np.abs(front.direction)))
        found[f"{'-' * (front.direction[number] < 0)}{'xyz'[number]}"] = name, front
    return found


def unsaved_work(session: Session) -> str:
    """Return a text about the unsaved work in each document, for the question before closing."""
    texts, running = [], session.solver.running
    if running:
        name = session.document.name
        texts.append(f"{name} is being matched; the best field so far is not saved.")
    for document in session.saves.unsaved_documents:
        if not (running and document.identity is session.document.identity):
            texts.append(session.saves.unsaved_text(document))
    return " ".join(texts)


class Actions:
    """Actions of the window, as attributes; `all` has them in the order of the list in Help.

    ``over`` returns the surface under the mouse, ``close`` closes the window without a question,
    ``search`` opens the search of actions. ``tour`` is the tour of the window.
    """

    def __init__(
        self,
        context: Context,
        over: Callable[[], str],
        close: Callable[[], None],
        search: Callable[[], None],
        tour: Tour,
    ) -> None:
        self.context, self._over, self._close = context, over, close
        self.tour = tour
        self._waiting: Action | None = None
        self._last_box = ""  # text box that gets the keyboard back after a save
        self._session, self._files, self._dialogs = context.session, context.files, context.dialogs
        session = context.session
        set_time, set_view = session.set_time, session.editor.set_view
        files = partial(Action, "Files", while_typing=True)
        self.open_mesh = files("open a mesh", "open mesh", context.open_mesh)
        title, formats = "Open a project or a result", (PROJECT, RESULT)
        do = partial(context.dialogs.open, title, formats, context.files.open, "results")
        self.open_project = files("open a project or a result", "open project", do)
        self.save = files("save the project", "save", self._save)
        text = "save the project under another name"
        self.save_as = files(text, "save as", self._choose_file)
        self.export = files("export", "export", lambda: export.open_dialog(context))
        self.quit = files("quit", "quit", self._quit)
        changes = partial(Action, "Changes", repeats=True)
        self.undo = changes("undo", "undo", session.undo)
        self.redo = changes("redo", "redo", session.redo)
        landmarks = partial(Action, "Landmarks")
        text = "start or stop placing landmarks by clicks"
        self.place_landmarks = landmarks(text, "place landmarks", self._switch_placing)
        text, remove = "remove the selected landmark", session.editor.remove_landmark
        self.remove_landmark = landmarks(text, "remove landmark", remove)
        solver = partial(Action, "Solver")
        text = "match, match again or continue: the action of the first button"
        self.match = solver(text, "match", self._match, while_typing=True)
        text = "match from zero if the button continues, else continue from the current field"
        do = partial(self._match, otherwise=True)
        self.match_otherwise = solver(text, "match otherwise", do, while_typing=True)
        self.pause = solver("pause or resume", "pause", session.solver.toggle)
        self.cancel = solver(_ESCAPE, "cancel", self._escape)
        text = "show a smoother step of the continuation, or the row above in the table"
        self.smoother = solver(text, "smoother", lambda: self._select_next(-1))
        text = "show a closer step of the continuation, or the row below in the table"
        self.closer = solver(text, "closer", lambda: self._select_next(1))
        text, do = "copy the selected rows of the table", partial(result_table.copy_rows, context)
        self.copy_rows = Action("Table", text, "copy rows", do)
        times, step = partial(Action, "Time"), self._step
        self.play = times("play or pause", "play", session.player.toggle)
        self.back = times("back by τ / 20", "back", lambda: step(-STEP), repeats=True)
        self.forward = times("forward by τ / 20", "forward", lambda: step(STEP), repeats=True)
        self.go_to_start = times("to time 0", "start", lambda: set_time(session.document.start))
        self.go_to_end = times("to τ", "end", lambda: set_time(session.document.last_target_time))
        views, switch = partial(Action, "View"), self._switch
        self.switch_theme = views("light or dark theme", "theme", self._switch_theme)
        show = self._dialogs.show
        self.show_shortcuts = views(
            "this list of shortcuts", "shortcuts", lambda: show("Shortcuts", self.listed())
        )
        self.search = views("search all actions", "search", search, while_typing=True)
        do = partial(set_view, "reset the camera", viewpoint=None)
        self.reset = views("reset the camera", "reset camera", do)
        self.best_view = views("best view of the functions", "best view", self._show_best_view)
        self.axes = {
            axis: views(f"look from {axis}", f"look from {axis}", partial(self._look_from, axis))
            for axis in AXES
        }
        do = partial(switch, "wireframe", "the wireframe")
        self.wireframe = views("wireframe", "wireframe", do)
        self.flat = views("flat or smooth shading", "flat", lambda: switch("flat", "flat shading"))
        self.hide = views("hide the surface under the mouse", "hide", self._hide)
        do = partial(set_view, "show all surfaces", hidden=(), enlarged="")
        self.show_all = views("show all surfaces", "show all", do)
        members = (one.values() if isinstance(one, dict) else [one] for one in vars(self).values())
        self.all = tuple(one for some in members for one in some if isinstance(one, Action))

    def do_pressed(self) -> None:
        """Do the action of the pressed keys, unless they are for a text box, a menu or a drag."""
        context, io = self.context, imgui.GetIO()
        action, self._waiting = self._waiting, None
        is_free = not (io.KeyAlt or io.KeySuper)
        is_free = is_free and (io.WantTextInput or not imgui.IsAnyItemActive())
        if action is None and is_free:
            possible = (one for one in self.all if one.while_typing or not io.WantTextInput)
            action = next((one for one in possible if one.is_pressed), None)
            if action is not None and io.WantTextInput:
                saves = action in (self.save, self.save_as)
                self._last_box = context.ui.active_box if saves else ""
                # when the box loses the focus, it returns its text in the next frame
                imgui.SetWindowFocus("status line")
                action, self._waiting = None, action
        is_busy = context.files.saving or self._waiting or context.dialogs.is_open
        if action is not None:
            action.do()
        elif self._last_box and not is_busy:
            context.ui.focus_next, self._last_box = self._last_box, ""

    def listed(self) -> list[tuple[str, str]]:
        """Return keys and descriptions for Help; the description of a heading is empty."""
        rows: list[tuple[str, str]] = []
        for group in dict.fromkeys(action.group for action in self.all):
            rows.append((group, ""))
            actions = [action for action in self.all if action.group == group]
            rows += [
                (KEYS[action.name].replace("Ctrl", COMMAND), action.text) for action in actions
            ]
        return [*rows, ("Mouse", ""), *_MOUSE]

    def show_messages(self) -> None:
        rows = [
            (f"{time.strftime('%H:%M:%S', time.localtime(entry.time))}   {entry.kind}", entry.text)
            for entry in self._session.notices.log
        ]
        copied = "\n".join(f"{when.replace('   ', ' ')}: {text}" for when, text in rows)
        self._dialogs.show("Messages", rows[::-1] or ["There are no messages yet."], copied)

    def show_about(self) -> None:
        from importlib.metadata import version  # imported late: it loads slowly

        lines = [
            f"abfm {version('abfm')}",
            "Finds a tangent vector field whose flow moves one function on a surface to another.",
            "Method: O. Azencot, O. Vantzos, M. Ben-Chen, Advection-based function matching on "
            "surfaces, Computer Graphics Forum 35 (5), 2016.",
            f"Python {sys.version.split()[0]}, NumPy {np.__version__}, polyscope "
            f"{version('polyscope')}.",
            "MIT licence.",
        ]
        self._dialogs.show("About abfm", lines)

    def _quit(self) -> None:
        """Close the window, after a question if work is unsaved."""
        self._files.stop_waiting()
        if self._files.saving:
            self._files.when_saved(self._quit)
        elif not (self._session.saves.unsaved_documents or self._session.solver.running):
            self._close()
        elif not self._dialogs.has_question(_QUIT):
            answers = {"Save": self._save_and_close, "Don't save": self._close, "Go back": None}
            text = partial(unsaved_work, self._session)  # evaluated later: runs may end meanwhile
            self._dialogs.question(_QUIT, text, answers)

    def _save_and_close(self) -> None:
        if self._session.solver.running and self._session.solver.has_partial_results:
            self._files.end_run("saving and closing", self._save_and_close)
        else:  # nothing of the run can be saved before its first field
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
        """Save a document, by default the current one; the user chooses a file if there is none."""
        document = document or self._session.document
        origin = self._session.saves.origin(document)
        is_present = document.identity is self._session.document.identity
        is_undone = is_present and document is not self._session.document
        if origin is None or is_undone:
            self._choose_file(then, document)
            return
        write = partial(self._files.save, origin.path, then, document)
        # while this window saves the file, a change of the file is its own
        if self._files.saving or not origin.changed:
            write()
            return
        text = (
            f"{origin.path.name} has changed since it was opened or saved here. Saving replaces "
            "its current content."
        )
        other = partial(self._choose_file, then, document)
        answers = {OTHER_NAME: other, "Replace": write, "Go back": None}
        self._dialogs.question("Replace a changed file?", text, answers)

    def _choose_file(
        self, then: Callable[[], None] | None = None, document: Document | None = None
    ) -> None:
        document = document or self._session.document
        origin = self._session.saves.origin(document)
        name = origin.path.name if origin else suggested_name(document, "", PROJECT)
        is_present = document.identity is self._session.document.identity
        title = "Save the project" if is_present else f"Save the project of {document.name}"

        def save(path: Path) -> None:
            self._files.save(path, then, document)

        self._dialogs.save(title, (PROJECT,), name, save, "results")

    def _match(self, otherwise: bool = False) -> None:
        self._session.match(self._session.work.continues != otherwise)

    def _escape(self) -> None:
        view, notices = self._session.view, self._session.notices
        if self.tour.title:
            self.tour.skip()
        elif notices.cards:
            notices.dismiss(notices.cards[0])
        elif view.enlarged in view.shown_surfaces and len(view.shown_surfaces) > 1:
            self._session.editor.amend(view=replace(view, enlarged=""))
        else:
            self._session.solver.cancel()

    def _select_next(self, count: int) -> None:
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
            self._session.notices.show(
                "landmarks need a match of two functions; a sequence of frames has none"
            )

    def _switch(self, name: str, what: str) -> None:
        shown = getattr(self._session.view, name)
        step = f"{'hide' if shown else 'show'} {what}"
        self._session.editor.set_view(step, "", **{name: not shown})

    def _switch_theme(self) -> None:
        other = "dark" if self._session.view.theme == "light" else "light"
        self._session.set_appearance(theme=other)

    def _look_from(self, axis: str) -> None:
        self._show(f"look from {axis}", views_by_axis(self._session.surface().mesh)[axis][1])

    def sides(self) -> dict[str, Action]:
        """Return the actions that show named sides of the surface, such as its front."""
        named = {
            name: axis for axis, (name, _) in views_by_axis(self._session.surface().mesh).items()
        }
        return {name: self.axes[named[name]] for name in VIEWS[1:]}

    def _show_best_view(self) -> None:
        session, last = self._session, self._session.surface()
        functions = [session.values(side) for side in SIDES if session.surface(side) is last]
        known = [values for values in functions if values is not None]
        self._show("show the best view", session.document.front(BEST_VIEW, *known))

    def _show(self, what: str, front: Front) -> None:
        viewpoint = self._session.view.viewpoint
        turned = replace(viewpoint, front=front) if viewpoint else Viewpoint(front)
        self._session.editor.set_view(what, viewpoint=turned)

    def hide_or_show(self, name: str) -> None:
        """Hide a surface, unless it is the last one, or show it again."""
        view = self._session.view
        if name in view.hidden:
            others = tuple(one for one in view.hidden if one != name)
            self._session.editor.set_view(f"show {name}", hidden=others)
        elif view.shown_surfaces == (name,):
            self._session.notices.show(f"{name} cannot be hidden: no other surface is shown")
        else:
            enlarged = "" if view.enlarged == name else view.enlarged
            self._session.editor.set_view(
                f"hide {name}", hidden=(*view.hidden, name), enlarged=enlarged
            )

    def _hide(self) -> None:
        if name := self._over():
            self.hide_or_show(name)
        else:
            self._session.notices.show("point at a surface: H hides the one under the mouse")
