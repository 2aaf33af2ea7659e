"""The window for a mesh, a result or a project."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import abfm
from abfm.assets import asset_path
from abfm_viewer import window
from abfm_viewer.files.state_folder import StateFolder
from abfm_viewer.session.session import Session
from abfm_viewer.session.session_files import open_session

if TYPE_CHECKING:
    from abfm_viewer.scene.opengl import Backend


def open_window(
    what: str | Path | abfm.TriangleMesh | None,
    backend: Backend,
    size: tuple[int, int],
    state_folder: Path | None = None,
    largest_component: bool = False,
) -> window.Window:
    """Open the app's window with a mesh, project or result in it; by default with a bundled mesh.

    Preferences, recent files and autosaves are kept in the state folder, by default the user's own.
    Raises AbfmError if the file cannot be read, or the machine cannot draw.
    """
    state = StateFolder(state_folder)
    if isinstance(what, abfm.TriangleMesh):
        session = Session(what, "mesh")
    else:
        session = open_session(Path(what or asset_path("human_fine_A.off")), largest_component)
        if what:
            state.add_recent(Path(what))
    return window.Window(session, backend, size, state)
