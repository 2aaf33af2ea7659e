"""Make the pictures of README and documentation: ``python docs/pictures.py [NAME...]``.

Each picture is the output of a command or a screenshot of the app. Without names, all are made.
"""

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from nilearn.datasets import fetch_surf_fsaverage

import abfm
from abfm.assets import asset_path
from abfm_viewer.appearance.samples import CORTEX, WAVE
from abfm_viewer.automation import Driver
from abfm_viewer.cli import main
from abfm_viewer.window.wave import turning_wave

IMAGES = Path(__file__).parent / "images"
SIZE = (1600, 1000)
_HUMAN = asset_path("human_fine_A.off")
_SOURCE = "gaussian:vertex=1856,width=0.08"
_TARGET = "gaussian:vertex=4108,width=0.08"


def _run(*words: object) -> None:
    if main([str(word) for word in words]) not in (0, 3):
        raise SystemExit(f"failed: abfm {' '.join(map(str, words))}")


def match(folder: Path) -> None:
    """Draw the sheet and the moving picture of a match."""
    match = folder / "match.npz"
    _run("match", _HUMAN, "--source", _SOURCE, "--target", _TARGET, "--out", match)
    _run("render", match, "--out", IMAGES / "match.png")
    _run("render", match, "--out", IMAGES / "flow.gif", "--size", "720x400", "--fps", 15)


def cortex(folder: Path) -> None:
    """Draw the registration of the sulcal depth of a left to a right hemisphere."""
    data = fetch_surf_fsaverage("fsaverage5")
    _run(
        *("register", data["sphere_left"], data["sphere_right"], "--initial", "sphere:mirror"),
        *("--source", f"file:{data['sulc_left']}", "--target", f"file:{data['sulc_right']}"),
        *("--out", folder / "cortex.npz"),
    )
    _run("render", folder / "cortex.npz", "--out", IMAGES / "cortex.png")


def sequence(folder: Path) -> None:
    """Draw frames of a wave on a sphere with the recovered velocity."""
    sphere = fetch_surf_fsaverage("fsaverage5")["sphere_left"]
    mesh = abfm.load_mesh(sphere)
    directions = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1)[:, None]
    np.save(folder / "wave.npy", turning_wave(directions, 0.04 * np.arange(6))[0])
    _run("sequence", sphere, folder / "wave.npy", "--dt", 0.04, "--out", folder / "wave.npz")
    _run("render", folder / "wave.npz", "--out", IMAGES / "sequence.png")


def _show_time(gui: Driver, time: float) -> None:
    """Show the flow at a time, and wait until everything that is drawn has been computed."""
    gui.drag("time", time)
    gui.wait(lambda session: not gui.window.shown.busy, seconds=120)
    gui.frames(10)


def window(folder: Path) -> None:
    """Take screenshots of a match in the app: before it, after it, and its trade-off."""
    with Driver(_HUMAN, size=SIZE) as gui:
        gui.type("spec", _SOURCE, within="source")
        gui.type("spec", _TARGET, within="target")
        gui.frames(10)
        gui.screenshot(IMAGES / "window-opened.png")
        gui.click("Match")
        gui.wait(lambda session: session.solver.finished, seconds=600)
        gui.frames(10)
        _show_time(gui, 0.5)
        gui.screenshot(IMAGES / "window.png")
        gui.click("Match", within="steps")
        gui.frames(10)
        gui.screenshot(IMAGES / "window-trade-off.png")


def window_surfaces(folder: Path) -> None:
    """Take a screenshot of two registered cortices in the app."""
    with Driver(size=SIZE) as gui:
        gui.menu("Samples", CORTEX)
        gui.wait(lambda session: gui.is_enabled("Match"), seconds=300)
        gui.click("Match")
        gui.wait(lambda session: session.solver.finished, seconds=600)
        gui.click("Look", within="steps")  # the tab Functions shows names of local files
        _show_time(gui, 1.0)
        gui.screenshot(IMAGES / "window-surfaces.png")


def window_sequence(folder: Path) -> None:
    """Take a screenshot of a matched sequence in the app."""
    with Driver(size=SIZE) as gui:
        gui.menu("Samples", WAVE)
        gui.frames(10)
        gui.click("Match all frames")
        gui.wait(lambda session: session.solver.finished, seconds=600)
        gui.frames(10)
        _show_time(gui, 0.3)
        gui.screenshot(IMAGES / "window-sequence.png")


PICTURES: dict[str, Callable[[Path], None]] = {
    "match": match,
    "cortex": cortex,
    "sequence": sequence,
    "window": window,
    "window-surfaces": window_surfaces,
    "window-sequence": window_sequence,
}

if __name__ == "__main__":
    for name in sys.argv[1:] or PICTURES:
        with tempfile.TemporaryDirectory() as scratch:
            PICTURES[name](Path(scratch))
