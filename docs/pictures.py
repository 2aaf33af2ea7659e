"""Make the pictures of README and documentation: ``python docs/pictures.py [NAME...]``.

NAME is the name of a file in ``docs/images``; without names, all are made. Each picture is the
output of a command, a screenshot of the app, or drawn by a module of ``docs/drawing``.
"""

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from PIL import Image

import abfm
from abfm.assets import asset_path
from abfm.parameters import FIGURES
from abfm_viewer.appearance.samples import CORTEX, WAVE
from abfm_viewer.automation import Driver
from abfm_viewer.cli import main
from abfm_viewer.window.wave import fsaverage5, turning_wave

DOCS = Path(__file__).parent
IMAGES = DOCS / "images"
SIZE = (1600, 1000)
"""Size of the window, in pixels."""
SIZE_MAX = (1000, 1300)
"""Largest size of other pictures, in pixels."""
_BYTES_MAX = 400_000
_COLOR_STEPS = 63  # levels of red, green and blue in pictures that are otherwise too large
_DATA = DOCS.parents[1]  # folder of clones of other repositories, next to this one
_DENSITY = "0.2"  # density of arrows on brains, where denser ones would be small
_HUMAN = asset_path("human_fine_A.off")
_SOURCE = "gaussian:vertex=1856,width=0.08"
_TARGET = "gaussian:vertex=4108,width=0.08"
_DISTANT = (
    *("match", asset_path("fandisk.off"), "--source", "gaussian:vertex=6412,width=0.1"),
    *("--target", "gaussian:vertex=3814,width=0.1"),
)
_PAPER = (  # the energy and the continuation of the paper
    *("--alpha", 0.02, "--sigma", 0.001, "--refine", 0),
    *("--set", "sigma_unit=absolute", "--set", "reach=0", "--set", "order=1", "--set", "levels=1"),
    *("--set", "cooling_stages=3", "--set", "cooling_factor=10", "--set", "iterations=150"),
)


def store(picture: Image.Image, name: str) -> None:
    """Save a picture in ``docs/images``, in a file of limited size.

    If the file would be too large, the picture is stored with fewer colours. If it is still too
    large, a window gets even fewer colours, and any other picture fewer pixels.
    """
    picture, is_window = picture.convert("RGB"), name.startswith("window")
    if not is_window:
        picture.thumbnail(SIZE_MAX, Image.Resampling.LANCZOS)
    path, share, steps = IMAGES / name, 1.0, _COLOR_STEPS
    picture.save(path, optimize=True)
    while path.stat().st_size > _BYTES_MAX:
        width, height = (round(share * length) for length in picture.size)
        reduced = picture.resize((width, height), Image.Resampling.LANCZOS)
        colors = np.round(np.asarray(reduced) * (steps / 255)) * (255 / steps)
        Image.fromarray(np.round(colors).astype(np.uint8)).save(path, optimize=True)
        if is_window:
            steps -= 8
        else:
            share *= 0.95


def _run(*words: object) -> None:
    if main([str(word) for word in words]) not in (0, 3):
        raise SystemExit(f"failed: abfm {' '.join(map(str, words))}")


def _render(result: Path, name: str, *options: object) -> None:
    picture = result.with_suffix(".png")
    _run("render", result, "--out", picture, *options)
    store(Image.open(picture), name)


def _data(repository: str, *path: str) -> Path:
    """Return a folder in a clone of another repository, which lies next to this one."""
    folder = _DATA.joinpath(repository.split("/")[1], *path)
    if not folder.is_dir():
        raise SystemExit(f"{folder} is missing: clone https://github.com/{repository} to {_DATA}")
    return folder


# Pictures of results


def match(folder: Path) -> None:
    """Draw a match of two Gaussians, as a sheet and as an animation."""
    result = folder / "match.npz"
    _run("match", _HUMAN, "--source", _SOURCE, "--target", _TARGET, "--out", result)
    _render(result, "match.png")
    _run("render", result, "--out", IMAGES / "flow.gif", "--size", "960x500", "--fps", 15)


def cortex(folder: Path) -> None:
    """Draw the registration of the sulcal depth of a left to a right hemisphere."""
    sphere, depth = (
        [fsaverage5() / f"{name}_{side}.gii.gz" for side in ("left", "right")]
        for name in ("sphere", "sulc")
    )
    functions = "--source", f"file:{depth[0]}", "--target", f"file:{depth[1]}"
    result = folder / "cortex.npz"
    _run("register", *sphere, "--initial", "sphere:mirror", *functions, "--out", result)
    _render(result, "cortex.png", "--size", "1500x700")


def sequence(folder: Path) -> None:
    """Draw frames of a wave on a sphere with the recovered velocity."""
    sphere, result = fsaverage5() / "sphere_left.gii.gz", folder / "wave.npz"
    mesh = abfm.load_mesh(sphere)
    directions = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1)[:, None]
    np.save(folder / "wave.npy", turning_wave(directions, 0.04 * np.arange(6))[0])
    _run("sequence", sphere, folder / "wave.npy", "--dt", 0.04, "--out", result)
    _render(result, "sequence.png")


def distant_match(folder: Path, name: str, options: Sequence[object] = ()) -> None:
    """Draw the match of two distant Gaussians."""
    result = folder / "match.npz"
    _run(*_DISTANT, *options, "--out", result)
    _render(result, name)


def figure(folder: Path, number: int) -> None:
    """Draw a figure of the paper."""
    _run("figure", number, "--out", folder)
    store(Image.open(folder / f"figure-{number}.png"), f"figure-{number:02}.png")


def waves(folder: Path) -> None:
    """Plot the errors of recovered velocities of waves, from a table in ``docs/sequences.md``."""
    from drawing.waves import draw

    draw(DOCS / "sequences.md", folder / "waves.png")
    store(Image.open(folder / "waves.png"), "waves.png")


def tracks(folder: Path) -> None:
    """Draw the tracks of critical points of a simulated wave."""
    from drawing.tracks import draw, rotating_wave

    wave = rotating_wave(_data("brain-modelling-group/neural-flows", "demo-data"))
    draw(wave, folder / "tracks.png")
    store(Image.open(folder / "tracks.png"), "tracks.png")


def retinotopy(folder: Path) -> None:
    """Draw stimuli on the visual cortex with the recovered velocity."""
    from drawing.retinotopy import picture

    maps = _data("noahbenson/neuropythy", "neuropythy", "lib", "data", "fsaverage", "surf")
    store(picture(maps), "retinotopy.png")


def population(folder: Path) -> None:
    """Draw the mean of a population before and after registration."""
    from drawing.population import picture

    store(picture(folder), "population.png")


# Screenshots


def _screenshot(gui: Driver, name: str, time: float | None = None) -> None:
    """Save a screenshot, optionally at a time of the flow, when all that it shows is computed."""
    if time is not None:
        gui.type("time", f"{time:g}", within="time bar")
    shown = gui.window.shown
    gui.wait(lambda session: not (shown.busy or shown.quantities.busy), seconds=120)
    gui.frames(10)
    with tempfile.TemporaryDirectory() as folder:
        gui.screenshot(Path(folder, "window.png"))
        store(Image.open(Path(folder, "window.png")), name)


def _match(gui: Driver, button: str) -> None:
    """Click a button that starts a run, and wait for its end."""
    gui.wait(lambda session: not session.busy, seconds=300)  # the sample is open
    gui.wait(lambda session: gui.is_enabled(button), seconds=300)
    gui.click(button)
    gui.wait(lambda session: session.solver.finished, seconds=600)
    gui.frames(10)


def window(folder: Path) -> None:
    """Show a match in the app: before it, after it, and its trade-off."""
    with Driver(_HUMAN, size=SIZE) as gui:
        gui.type("spec", _SOURCE, within="source")
        gui.type("spec", _TARGET, within="target")
        _screenshot(gui, "window-opened.png")
        _match(gui, "Match")
        _screenshot(gui, "window.png", 0.5)
        gui.click("Match", within="steps")
        _screenshot(gui, "window-trade-off.png")


def window_surfaces(folder: Path) -> None:
    """Show two registered cortices in the app."""
    with Driver(size=SIZE) as gui:
        gui.menu("Samples", CORTEX)
        _match(gui, "Match")
        gui.wait(lambda session: session.work.facts.is_complete, seconds=120)
        gui.click("Look", within="steps")  # the tab Functions shows names of local files
        gui.type("density", _DENSITY)
        _screenshot(gui, "window-surfaces.png", 1.0)


def window_sequence(folder: Path) -> None:
    """Show a matched sequence in the app."""
    with Driver(size=SIZE) as gui:
        gui.menu("Samples", WAVE)
        _match(gui, "Match all frames")
        gui.click("Pause", within="time bar")
        gui.click("Look", within="steps")
        gui.type("density", _DENSITY)
        _screenshot(gui, "window-sequence.png", 0.3)


PICTURES: dict[str, Callable[[Path], None]] = {
    "match.png": match,
    "flow.gif": match,
    "cortex.png": cortex,
    "sequence.png": sequence,
    "convergence-far.png": partial(distant_match, name="convergence-far.png"),
    "convergence-stalled.png": partial(
        distant_match, name="convergence-stalled.png", options=_PAPER
    ),
    "waves.png": waves,
    "tracks.png": tracks,
    "retinotopy.png": retinotopy,
    "population.png": population,
    **{f"figure-{number:02}.png": partial(figure, number=number) for number in FIGURES},
    "window-opened.png": window,
    "window.png": window,
    "window-trade-off.png": window,
    "window-surfaces.png": window_surfaces,
    "window-sequence.png": window_sequence,
}


def _make(names: Sequence[str]) -> None:
    """Make each picture in its own process: none can draw both windows and other pictures."""
    makers = dict.fromkeys(PICTURES[name] for name in names)
    if len(makers) == 1:
        with tempfile.TemporaryDirectory() as scratch:
            next(iter(makers))(Path(scratch))
        return
    for maker in makers:
        files = [name for name in names if PICTURES[name] is maker]
        begin = time.monotonic()
        subprocess.run([sys.executable, __file__, *files], check=True)
        print(f"{', '.join(files)}: {time.monotonic() - begin:.0f} s", flush=True)


if __name__ == "__main__":
    requested = sys.argv[1:] or [*PICTURES]
    if unknown := {*requested} - PICTURES.keys():
        raise SystemExit(f"unknown picture {min(unknown)}; expected {', '.join(PICTURES)}")
    _make(requested)
