"""`abfm-viewer`: the command that opens the window."""

import os
from importlib import import_module

from abfm_viewer.cli import program

_DESCRIPTION = """\
Open a window that shows a mesh, two functions on it, and their match.

Examples:
  abfm-viewer spot.obj
  abfm-viewer subject.gii template.gii
  abfm-viewer cortex.gii frames.npy
  abfm-viewer match.npz
  abfm-viewer results
  abfm-viewer project.abfm
"""


def main(argv: list[str] | None = None) -> int:
    """Open the app, with the arguments of the process by default; return the exit status."""
    return program("abfm-viewer", _run, argv)


def _run(words: list[str]) -> int:
    from abfm_viewer import window
    from abfm_viewer.cli.exit_status import UsageError
    from abfm_viewer.cli.options import Parser, add_mesh_options, adder, mesh_options
    from abfm_viewer.files.state_folder import StateFolder

    parser = Parser(prog="abfm-viewer", description=_DESCRIPTION)
    add = adder(parser)
    about = "mesh, project (.abfm), result (.npz) or folder of results (default: a bundled mesh)"
    add("file", about, "FILE", nargs="?")
    about = "second mesh, to which the first is registered, or frames of a sequence on the mesh"
    add("second", about, "B", nargs="?")
    add("--array", "name of the array with the frames, in a .npz or VTK file", "NAME")
    add_mesh_options(parser)
    parser.set_defaults(parser=parser)
    arguments = parser.parse_all(words)
    if any(name.startswith("NUMBA_") for name in os.environ):
        import_module("abfm.numerics.kernels")  # refuses invalid values before a window opens
    what = (arguments.file, arguments.second) if arguments.second else arguments.file
    if arguments.array is not None:
        if not arguments.second:
            raise UsageError("--array selects an array of frames; give a mesh and frames")
        what = (*what, arguments.array)
    options = mesh_options(arguments)
    open_window = window.open_window  # reports a missing library
    is_known = StateFolder().path.exists()
    opened = open_window(what, "openGL3_glfw", (1280, 800), options=options)
    if not (opened.preferences.now.tour_seen or (is_known and arguments.file)):
        opened.tour.start()
    opened.run()
    return 0
