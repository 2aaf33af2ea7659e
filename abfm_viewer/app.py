"""`abfm-viewer`: the command that opens the window."""

from __future__ import annotations

import sys
from pathlib import Path

from abfm import load_mesh
from abfm.assets import asset_path
from abfm_viewer.cli.parser import Parser
from abfm_viewer.exit_status import exit_status

_DESCRIPTION = """\
Open a window with a mesh, two functions on it, and their match.

Example:
  abfm-viewer spot.obj
"""


def main(argv: list[str] | None = None) -> int:
    """Open the app and return the exit status when its window is closed."""
    return exit_status("abfm-viewer", lambda: _run(sys.argv[1:] if argv is None else argv))


def _run(words: list[str]) -> int:
    parser = Parser(prog="abfm-viewer", description=_DESCRIPTION)
    parser.add_argument("mesh", nargs="?", metavar="MESH", help="triangle mesh (default: a bundled one)")
    parser.add_argument("--largest-component", action="store_true", help="of several components use the largest")
    parser.set_defaults(parser=parser)
    arguments = parser.parse_whole(words)
    path = arguments.mesh or asset_path("human_A.off")
    mesh = load_mesh(path, largest_component=arguments.largest_component)
    from abfm_viewer.window import Window  # not before: it needs OpenGL

    Window(mesh, Path(path).name).run()
    return 0
