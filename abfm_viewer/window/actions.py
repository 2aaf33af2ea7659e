"""Actions: one table for the keyboard, the hints in the menus and the list in Help."""

import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from abfm_viewer.document.document import Document, Theme
from abfm_viewer.document.verdict_words import headline
from abfm_viewer.panels.context import Context
from abfm_viewer.panels.time_bar import STEP
from abfm_viewer.session.session import Session
from abfm_viewer.session.session_files import OTHER_NAME, PROJECT, RESULT
from abfm_viewer.window.action import Action
from abfm_viewer.window.view_actions import ViewActions

_ESCAPE = (
    "close a menu; else take a message away; else show all surfaces; else cancel, and keep the "
    "best field, from which Continue goes on"
)
_QUIT = "Save before closing?"
_CHANGED = "Replace a changed file?"
_MOUSE = (
    ("drag on a surface", "turn them all, each in its place"),
    ("drag beside a surface", "turn them about their upright axis, or tilt it"),
    ("right or middle drag", "move them"),
    ("wheel", "nearer to or farther from what is under the mouse"),
    ("double click", "one surface large, or all again"),
    ("Shift+click, Shift+drag", "on the source or target: move the active Gaussian"),
    ("Shift+wheel", "wider or narrower Gaussian"),
    ("drop files", "open a mesh, a project or a result"),
)


def what_would_be_lost(session: Session) -> str:
    """Say of each document what is in no file, for the question before closing."""
    running = session.solver.running
    said = []
    if running:
        name = session.document.name
        said.append(f"{name} is being matched; the best field so far is in no file.")
    for document in session.saves.unsaved_documents:
        if running and document.identity is session.document.identity:
            continue
        if document.result is not None and session.saves.has_new_result(document):
            found = headline(document.result)
            said.append(f"The match of {document.name} ({found}) is in no file.")
        else:
            said.append(f"{document.name} has changes that are in no file.")
    return " ".join(said)


class Actions:
    """The window's commands; each `Action` is an attribute, and `all` has them in the list's order.

    `over` names the surface under the mouse, and `close` closes the window without a question.
    """

    def __init__(
        self, context: Context, over: Callable[[], str], close: Callable[[], None]
    ) -> None:
        session = context.session
        self.context, self._close = context, close
        of_files = partial(Action, "Files", while_typing=True)
        self.open_mesh = of_files("open a mesh", context.open_mesh, ("Ctrl+O",))
        what = "open a project or a result"
        self.open_project = of_files(what, self._open_project, ("Ctrl+Shift+O",))
        self.save = of_files("save the project", self._save, ("Ctrl+S",))
        what = "save the project under another name"
        self.save_as = of_files(what, self._ask_where, ("Ctrl+Shift+S",))
        self.quit = of_files("quit", self._quit, ("Ctrl+Q",))
        of_changes = partial(Action, "Changes", repeats=True)
        self.undo = of_changes("undo", session.undo, ("Ctrl+Z",))
        self.redo = of_changes("redo", session.redo, ("Ctrl+Y", "Ctrl+Shift+Z"))
        of_solver = partial(Action, "Solver")
        self.match = of_solver("match", session.match, ("Ctrl+Enter",), while_typing=True)
        self.pause = of_solver("pause or resume", self._pause, ("P",))
        self.cancel = of_solver(_ESCAPE, self._escape, ("Esc",))
        of_time = partial(Action, "Time")
        self.play = of_time("play or pause", session.player.toggle, ("Space",))
        back, on = "a twentieth of τ back", "a twentieth of τ on"
        self.step_back = of_time(back, partial(self._step, -STEP), ("Left",), repeats=True)
        self.step_on = of_time(on, partial(self._step, STEP), ("Right",), repeats=True)
        self.go_to_start = of_time("to time 0", lambda: session.set_time(0.0), ("Home",))
        self.go_to_end = of_time("to τ", self._go_to_end, ("End",))
        self.view = ViewActions(session, over)
        self.switch_theme = Action("View", "light or dark", self._switch_theme, ("L",))
        self.show_shortcuts = Action("View", "this list", self._show_shortcuts, ("F1",))
        own = tuple(one for one in vars(self).values() if isinstance(one, Action))
        self.all = own + self.view.all

    def listed(self) -> list[tuple[str, str]]:
        """Return the list in Help: keys and what they do; a heading has an empty second part."""
        rows: list[tuple[str, str]] = []
        for group in dict.fromkeys(action.group for action in self.all):
            rows.append((group, ""))
            actions = [action for action in self.all if action.group == group]
            rows += [(" or ".join(action.hints), action.does) for action in actions]
        return [*rows, ("Mouse", ""), *_MOUSE]

    def show_about(self) -> None:
        from importlib.metadata import version  # it takes a while to load

        self.context.dialogs.show(
            "About abfm",
            [
                f"abfm {version('abfm')}",
                "Finds the tangent vector field whose flow carries one function on a surface to "
                "another.",
                "After: O. Azencot, O. Vantzos, M. Ben-Chen, Advection-based function matching on "
                "surfaces, Computer Graphics Forum 35 (5), 2016.",
                f"Python {sys.version.split()[0]}, NumPy {np.__version__}, polyscope "
                f"{version('polyscope')}.",
                "MIT licence.",
            ],
        )

    def _open_project(self) -> None:
        title, files = "Open a project or a result", self.context.files
        self.context.dialogs.open(title, (PROJECT, RESULT), files.open)

    def _quit(self) -> None:
        """Close the window, after a question if work is unsaved."""
        session, files, dialogs = self.context.session, self.context.files, self.context.dialogs
        files.stop_waiting()
        if files.saving:
            files.when_saved(self._quit)
        elif not (session.saves.unsaved_documents or session.solver.running):
            self._close()
        elif not dialogs.is_asking(_QUIT):
            answers = {"Save": self._save_and_close, "Don't save": self._close, "Go back": None}
            dialogs.ask(_QUIT, what_would_be_lost(session), answers)

    def _save_and_close(self) -> None:
        session, files = self.context.session, self.context.files
        if session.solver.running and session.solver.snapshot is not None:
            files.end_run("saving and closing", self._save_and_close)
        else:  # a run without a field so far has nothing to save
            session.solver.cancel()
            self._save_all(list(session.saves.unsaved_documents), self._close)

    def _save_all(self, documents: list[Document], then: Callable[[], None]) -> None:
        """Save one document after the other, and do something when all are written."""
        if documents:
            self._save(partial(self._save_all, documents[1:], then), documents[0])
        else:
            then()

    def _save(
        self, then: Callable[[], None] | None = None, document: Document | None = None
    ) -> None:
        """Save a document, by default the present one, where it is; if nowhere, ask where."""
        session, files = self.context.session, self.context.files
        document = document or session.document
        origin = session.saves.origin(document)
        is_present = document.identity is session.document.identity
        taken_back = is_present and document is not session.document
        if origin is None or taken_back:
            self._ask_where(then, document)
            return
        write = partial(files.save, origin.path, then, document)
        if files.saving or not origin.changed:  # what is being saved was changed by this window
            write()
            return
        text = (
            f"{origin.path.name} has changed since it was opened or saved here. Saving takes the "
            "place of what is in it now."
        )
        other = partial(self._ask_where, then, document)
        answers = {OTHER_NAME: other, "Replace": write, "Go back": None}
        self.context.dialogs.ask(_CHANGED, text, answers)

    def _ask_where(
        self, then: Callable[[], None] | None = None, document: Document | None = None
    ) -> None:
        session, files = self.context.session, self.context.files
        document = document or session.document
        origin = session.saves.origin(document)
        name = (origin.path if origin else Path(document.name)).with_suffix(PROJECT).name
        title = "Save the project"
        if document.identity is not session.document.identity:
            title += f" of {document.name}"

        def save(path: Path) -> None:
            files.save(path, then, document)

        self.context.dialogs.save(title, (PROJECT,), name, save)

    def _pause(self) -> None:
        solver = self.context.session.solver
        solver.resume() if solver.paused else solver.pause()

    def _escape(self) -> None:
        session = self.context.session
        if session.notices.cards:
            session.notices.dismiss(session.notices.cards[0])
        elif not self.view.back():
            session.solver.cancel()

    def _go_to_end(self) -> None:
        self.context.session.set_time(self.context.session.parameters.tau)

    def _step(self, share: float) -> None:
        session = self.context.session
        session.set_time(session.time + share * session.parameters.tau)

    def _switch_theme(self) -> None:
        session = self.context.session
        other: Theme = "dark" if session.view.theme == "light" else "light"
        session.editor.set_view("change the theme", theme=other)

    def show_messages(self) -> None:
        """Show everything that was told since the launch, the latest first."""
        rows = [
            (f"{time.strftime('%H:%M:%S', time.localtime(entry.time))}   {entry.kind}", entry.text)
            for entry in self.context.session.notices.log
        ]
        copied = "\n".join(f"{when.replace('   ', ' ')}: {text}" for when, text in rows)
        self.context.dialogs.show("Messages", rows[::-1] or ["There are none yet."], copied)

    def _show_shortcuts(self) -> None:
        self.context.dialogs.show("Shortcuts", self.listed())
