"""What menus and keys do: every action by its name, and whether it can be done now."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

from abfm_viewer.dialogs import Dialogs
from abfm_viewer.session.opening import MESHES, PROJECT, RESULT, Documents
from abfm_viewer.session.session import Session
from abfm_viewer.window import shortcuts

_QUIT = "Save before closing?"
_STEP = 1 / 20
"""Of tau: how far the step keys move in time."""


class Actions:
    """The window's commands.

    Parameters
    ----------
    session : Session
    documents : Documents
    dialogs : Dialogs
    reset_camera : callable
        Looks from the front again.
    show_section : callable
        Opens a section of the panel and brings it into view.
    close : callable
        Closes the window without a question.
    """

    def __init__(
        self,
        session: Session,
        documents: Documents,
        dialogs: Dialogs,
        reset_camera: Callable[[], None],
        show_section: Callable[[str], None],
        close: Callable[[], None],
    ) -> None:
        self.session = session
        self.documents = documents
        self.dialogs = dialogs
        self.reset_camera = reset_camera
        self.show_section = show_section
        self._close = close

    # Files

    def open_mesh(self) -> None:
        """Ask for a mesh and open it."""
        self.dialogs.open("Open a mesh", MESHES, self.documents.open)

    def open_project(self) -> None:
        """Ask for a project or a result and open it."""
        self.dialogs.open("Open a project or a result", (PROJECT, RESULT), self.documents.open)

    def save(self) -> None:
        """Save the project where it is; ask where if it is nowhere yet."""
        self._save_then(None)

    def save_as(self) -> None:
        """Ask where to save the project."""
        self._ask_where(None)

    def quit(self) -> None:
        """Close the window; with unsaved work only after a question."""
        session = self.session
        if self.documents.saving:
            self.documents.when_saved(self.quit)
        elif not (session.unsaved or session.solver.running):
            self._close()
        elif not self.dialogs.is_asking(_QUIT):
            name = session.document.name
            unsaved = "is being matched; the best field so far is" if session.solver.running else "has changes that are"
            text = f"{name} {unsaved} in no file."
            buttons = {
                "Save": self._save_and_close,
                "Don't save": self._close,
                "Go back": None,
            }
            self.dialogs.ask(_QUIT, text, buttons)

    def _save_and_close(self) -> None:
        self.session.end_run()
        self._save_then(self._close)

    def _save_then(self, then: Callable[[], None] | None) -> None:
        if self.session.path is None:
            self._ask_where(then)
        else:
            self.documents.save(self.session.path, then)

    def _ask_where(self, then: Callable[[], None] | None) -> None:
        name = (self.session.path or Path(self.session.document.name)).with_suffix(PROJECT).name
        self.dialogs.save("Save the project", (PROJECT,), name, lambda path: self.documents.save(path, then))

    # Changes

    def undo(self) -> None:
        """Take back the last change."""
        self.session.undo()

    def redo(self) -> None:
        """Do again what was taken back."""
        self.session.redo()

    # Solver

    def match(self) -> None:
        """Start the solver."""
        self.session.match()

    def pause(self) -> None:
        """Hold the solver, or let it go on."""
        solver = self.session.solver
        solver.resume() if solver.paused else solver.pause()

    def cancel(self) -> None:
        """End the run and keep its best field."""
        self.session.solver.cancel()

    # Time

    def play(self) -> None:
        """Play or pause."""
        self.session.player.toggle()

    def step_back(self) -> None:
        """Go a step back in time."""
        self._move(self.session.time - _STEP * self.session.parameters.tau)

    def step_on(self) -> None:
        """Go a step on in time."""
        self._move(self.session.time + _STEP * self.session.parameters.tau)

    def go_to_start(self) -> None:
        """Show time 0."""
        self._move(0.0)

    def go_to_end(self) -> None:
        """Show time tau."""
        self._move(self.session.parameters.tau)

    def _move(self, time: float) -> None:
        self.session.player.playing = False
        self.session.set_time(time)

    # View and help

    def switch_theme(self) -> None:
        """Light to dark, or back."""
        theme = self.session.view.theme
        self.session.set_view("change the theme", theme="dark" if theme == "light" else "light")

    def show_shortcuts(self) -> None:
        """List the keys."""
        self.dialogs.show("Shortcuts", shortcuts.listed())

    def show_about(self) -> None:
        """Say what the app is, and what it runs on."""
        from importlib.metadata import version  # it takes a while to load

        import numpy as np

        self.dialogs.show(
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
