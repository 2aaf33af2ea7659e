"""`abfm-viewer`: the command that opens the window."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from abfm_viewer.cli.exit_status import exit_status

if TYPE_CHECKING:
    from abfm import TriangleMesh
    from abfm_viewer.scene.opengl import Backend
    from abfm_viewer.window.window import Window

_DESCRIPTION = """\
Open a window with a mesh, two functions on it, and their match.

Examples:
  abfm-viewer spot.obj
  abfm-viewer match.npz
  abfm-viewer project.abfm
"""


def main(argv: list[str] | None = None) -> int:
    """Open the app and return the exit status when its window is closed."""
    return exit_status("abfm-viewer", lambda: _run(sys.argv[1:] if argv is None else argv))


def _run(words: list[str]) -> int:
    from abfm_viewer.cli.parser import Parser  # not before: Ctrl-C may come while modules load

    parser = Parser(prog="abfm-viewer", description=_DESCRIPTION)
    parser.add_argument(
        "file", nargs="?", metavar="FILE", help="mesh, project (.abfm) or result (.npz); by default a bundled mesh"
    )
    parser.add_argument("--largest-component", action="store_true", help="of several components use the largest")
    parser.set_defaults(parser=parser)
    arguments = parser.parse_whole(words)
    open_window(arguments.file, "openGL3_glfw", (1280, 800), largest_component=arguments.largest_component).run()
    return 0


def open_window(
    what: str | Path | TriangleMesh | None,
    backend: Backend,
    size: tuple[int, int],
    state_folder: Path | None = None,
    largest_component: bool = False,
) -> Window:
    """The app's window with a mesh, project or result in it; by default with a bundled mesh.

    Parameters
    ----------
    state_folder
        Where preferences, recent files and autosaves are kept; the user's own by default.

    Raises
    ------
    AbfmError
        If the file cannot be read, or the machine cannot draw.
    """
    from abfm import TriangleMesh
    from abfm.assets import asset_path
    from abfm_viewer.files.state_folder import StateFolder
    from abfm_viewer.session.opening import open_session
    from abfm_viewer.session.session import Session

    state = StateFolder(state_folder)
    if isinstance(what, TriangleMesh):
        session = Session(what, "mesh")
    else:
        session = open_session(Path(what or asset_path("human_A.off")), largest_component)
        if what:
            state.add_recent(Path(what))
    from abfm_viewer.window.window import (
        Window,  # not before: it needs OpenGL, and a file that cannot be read needs none
    )

    return Window(session, backend, size, state)
