"""What menus and keys do: one table for the keyboard, the hints in the menus and the list in Help."""

import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from abfm_viewer.document.document import Document
from abfm_viewer.document.verdict_words import headline
from abfm_viewer.panels.context import Context
from abfm_viewer.panels.time_bar import STEP
from abfm_viewer.session.opening import PROJECT, RESULT
from abfm_viewer.session.session import Session
from abfm_viewer.session.session_files import OTHER_NAME
from abfm_viewer.window.action import COMMAND, Action
from abfm_viewer.window.view_actions import ViewActions

_QUIT = "Save before closing?"
_CHANGED = "Replace a changed file?"
_MOUSE = (
    ("drag", "turn the surfaces, each in its place"),
    ("right or middle drag", "move them"),
    ("wheel", "nearer to or farther from what is under the mouse"),
    ("double click", "one surface large, or all again"),
    ("Shift+click, Shift+drag", "on the source or target: move the active Gaussian"),
    ("Shift+wheel", "wider or narrower Gaussian"),
    ("drop files", "open a mesh, a project or a result"),
)


def what_would_be_lost(session: Session) -> str:
    """What is in no file, for the question before closing: each document with what is unsaved of it."""
    running, documents = session.solver.running, session.unsaved_documents
    said = [f"{session.document.name} is being matched; the best field so far is in no file."] if running else []
    for document in documents:
        if running and document.mesh is session.mesh:
            continue
        if document.result is not None and session.has_new_result(document):
            said.append(f"The match of {document.name} ({headline(document.result)}) is in no file.")
        else:
            said.append(f"{document.name} has changes that are in no file.")
    return " ".join(said)


class Actions:
    """The window's commands; each `Action` is an attribute, and `all` has them in the list's order.

    `over` names the surface under the mouse, and `close` closes the window without a question.
    """

    def __init__(self, context: Context, over: Callable[[], str], close: Callable[[], None]) -> None:
        session = context.session
        self.context, self._close = context, close
        of_files = partial(Action, "Files", while_typing=True)
        self.open_mesh = of_files("open a mesh", context.open_mesh, ("Ctrl+O",))
        self.open_project = of_files("open a project or a result", self._open_project, ("Ctrl+Shift+O",))
        self.save = of_files("save the project", self._save, ("Ctrl+S",))
        self.save_as = of_files("save the project under another name", self._ask_where, ("Ctrl+Shift+S",))
        self.quit = of_files("quit", self._quit, ("Ctrl+Q",))
        self.undo = Action("Changes", "undo", session.undo, ("Ctrl+Z",), repeats=True)
        self.redo = Action("Changes", "redo", session.redo, ("Ctrl+Y", "Ctrl+Shift+Z"), repeats=True)
        self.match = Action("Solver", "match", session.match, ("Ctrl+Enter",), while_typing=True)
        self.pause = Action("Solver", "pause or resume", self._pause, ("P",))
        self.cancel = Action(
            "Solver",
            "take a message away; else show all surfaces; else cancel, and keep the best field",
            self._escape,
            ("Esc",),
        )
        self.play = Action("Time", "play or pause", session.player.toggle, ("Space",))
        self.step_back = Action("Time", "a twentieth of τ back", lambda: self._step(-STEP), ("Left",), repeats=True)
        self.step_on = Action("Time", "a twentieth of τ on", lambda: self._step(STEP), ("Right",), repeats=True)
        self.go_to_start = Action("Time", "to time 0", lambda: session.set_time(0.0), ("Home",))
        self.go_to_end = Action("Time", "to τ", lambda: session.set_time(session.parameters.tau), ("End",))
        self.view = ViewActions(session, over)
        self.switch_theme = Action("View", "light or dark", self._switch_theme, ("L",))
        self.show_shortcuts = Action("View", "this list", self._show_shortcuts, ("F1",))
        own = tuple(one for one in vars(self).values() if isinstance(one, Action))
        self.all = own + self.view.all

    def listed(self) -> list[tuple[str, str]]:
        """The list in Help: rows of keys and what they do; a heading has an empty second part."""
        rows: list[tuple[str, str]] = []
        for group in dict.fromkeys(action.group for action in self.all):
            rows.append((group, ""))
            rows += [
                (" or ".join(action.chords).replace("Ctrl", COMMAND), action.does)
                for action in self.all
                if action.group == group
            ]
        return [*rows, ("Mouse", ""), *_MOUSE]

    def show_about(self) -> None:
        from importlib.metadata import version  # it takes a while to load

        self.context.dialogs.show(
            "About abfm",
            [
                f"abfm {version('abfm')}",
                "Finds the tangent vector field whose flow carries one function on a surface to another.",
                "After: O. Azencot, O. Vantzos, M. Ben-Chen, Advection-based function matching on surfaces, "
                "Computer Graphics Forum 35 (5), 2016.",
                f"Python {sys.version.split()[0]}, NumPy {np.__version__}, polyscope {version('polyscope')}.",
                "MIT licence.",
            ],
        )

    def _open_project(self) -> None:
        self.context.dialogs.open("Open a project or a result", (PROJECT, RESULT), self.context.files.open)

    def _quit(self) -> None:
        """Close the window; with unsaved work only after a question, also where it is to be closed already."""
        session, files, dialogs = self.context.session, self.context.files, self.context.dialogs
        files.stop_waiting()
        if files.saving:
            files.when_saved(self._quit)
        elif not (session.unsaved_documents or session.solver.running):
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
            self._save_all(list(session.unsaved_documents), self._close)

    def _save_all(self, documents: list[Document], then: Callable[[], None]) -> None:
        """Save one document after the other, and do something when all are written."""
        if documents:
            self._save(partial(self._save_all, documents[1:], then), documents[0])
        else:
            then()

    def _save(self, then: Callable[[], None] | None = None, document: Document | None = None) -> None:
        """Save a document, by default the present one, where it is; ask where if it is nowhere yet."""
        session = self.context.session
        document = document or session.document
        taken_back = document.mesh is session.mesh and document is not session.document
        files, origin = self.context.files, session.origin_of(document.mesh)
        if origin is None or taken_back:
            self._ask_where(then, document)
        elif origin.changed and not files.saving:  # else it may be this window that has just written it
            name = origin.path.name
            text = f"{name} has changed since it was opened or saved here. Saving takes the place of what is in it now."
            other, write = partial(self._ask_where, then, document), partial(files.save, origin.path, then, document)
            self.context.dialogs.ask(_CHANGED, text, {OTHER_NAME: other, "Replace": write, "Go back": None})
        else:
            files.save(origin.path, then, document)

    def _ask_where(self, then: Callable[[], None] | None = None, document: Document | None = None) -> None:
        session, files = self.context.session, self.context.files
        document = document or session.document
        name = (session.path_of(document.mesh) or Path(document.name)).with_suffix(PROJECT).name
        title = "Save the project" if document.mesh is session.mesh else f"Save the project of {document.name}"
        self.context.dialogs.save(title, (PROJECT,), name, lambda path: files.save(path, then, document))

    def _pause(self) -> None:
        solver = self.context.session.solver
        solver.resume() if solver.paused else solver.pause()

    def _escape(self) -> None:
        session = self.context.session
        if session.cards:
            session.dismiss(session.cards[0])
        elif not self.view.back():
            session.solver.cancel()

    def _step(self, share: float) -> None:
        session = self.context.session
        session.set_time(session.time + share * session.parameters.tau)

    def _switch_theme(self) -> None:
        session = self.context.session
        session.set_view("change the theme", theme="dark" if session.view.theme == "light" else "light")

    def show_messages(self) -> None:
        """Show everything that was told since the launch, the latest first."""
        log = [(time.strftime("%H:%M:%S", time.localtime(entry.time)), entry) for entry in self.context.session.log]
        rows = [(f"{clock}   {entry.kind}", entry.text) for clock, entry in reversed(log)]
        text = "\n".join(f"{clock} {entry.kind}: {entry.text}" for clock, entry in log)
        self.context.dialogs.show("Messages", rows or ["There are none yet."], text)

    def _show_shortcuts(self) -> None:
        self.context.dialogs.show("Shortcuts", self.listed())
