"""Cost of the window: launch time, frame times, and speed of the solver with and without it.

Run it with ``python -m benchmarks.window`` and the options of ``abfm bench --viewer``.
"""

import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np

import abfm
from abfm import Parameters, TriangleMesh
from abfm.assets import asset_path
from abfm.mesh.shapes import sphere
from abfm.parameters import PAPER
from abfm_viewer import signals
from abfm_viewer.scene import opengl
from abfm_viewer.scene.opengl import Backend
from abfm_viewer.session.session import Session
from abfm_viewer.window.window import Window
from benchmarks.common import Log, Report, bench, markdown

THROUGHPUT_MIN = 0.8
"""Smallest acceptable ratio of iterations per second with the window to those without it."""
FRAME_SECONDS_MAX = 0.040
LAUNCH_RATIO_MAX = 1.5
"""Largest acceptable ratio of the launch time of the app to that of plain polyscope."""

_SIZE = (1280, 800)
_POLYSCOPE_SCRIPT = """
import sys
import numpy as np
import trimesh
import polyscope as ps
mesh = trimesh.load(sys.argv[1], process=False)
ps.set_verbosity(0)
ps.set_use_prefs_file(False)
ps.set_window_size(1280, 800)
ps.init(sys.argv[2])
surface = ps.register_surface_mesh("mesh", np.asarray(mesh.vertices), np.asarray(mesh.faces))
surface.add_scalar_quantity("height", np.asarray(mesh.vertices)[:, 1], enabled=True)
ps.frame_tick()
print("drawn", flush=True)
"""
_APP_SCRIPT = """
import sys
from abfm_viewer.window.window import open_window
window = open_window(sys.argv[1], sys.argv[2], (1280, 800))
window.tick()
print("drawn", flush=True)
window.close()
"""


def run(
    log: Log,
    subdivisions: Sequence[int] = (5, 6),
    parameters: Parameters | None = None,
    long: int = 300,
    repeats: int = 5,
) -> Report:
    """Measure the launch time, the throughput of the solver, and the frame times.

    A ratio compares the medians of two kinds of runs, which alternate.

    Parameters
    ----------
    subdivisions : sequence of int
        Subdivisions of the icospheres on which the solver runs.
    parameters : Parameters, optional
        Parameters of the solver; the defaults if None.
    long : int
        Iterations of the match on the first mesh, during which frames are measured.
    repeats : int
        Number of runs of each kind.
    """
    backend: Backend = (
        opengl.WINDOW
        if {"DISPLAY", "WAYLAND_DISPLAY"} & os.environ.keys()
        else opengl.OFFSCREEN_BACKEND
    )
    log("launch to the first frame, of the app and of plain polyscope")
    launch, throughput = _launch(backend, repeats), []
    frames: Report = {}
    for subdivision in subdivisions:
        mesh = sphere(subdivision)
        size = f"{len(mesh.vertices):,} vertices"
        log(f"abfm.match alone, and with the window, {size}")
        with _opened(mesh, backend, parameters or Parameters()) as window:
            throughput.append(_throughput(window, repeats))
            if not frames:
                log("frames during a long solve")
                frames = _frames(window, long)
    return {
        "launch": launch,
        "throughput": throughput,
        "frames": frames,
        "settings": {"long": long, "repeats": repeats, "backend": backend, "cores": os.cpu_count()},
    }


@contextmanager
def _opened(mesh: TriangleMesh, backend: Backend, parameters: Parameters) -> Iterator[Window]:
    """Yield a window of the app that shows a problem, ready for a click on Match."""
    session = Session(mesh, "sphere")
    window = Window(session, backend, _SIZE)
    session.editor.set_parameter(**parameters.to_dict())
    try:
        while session.obstacle:
            window.frame()
        for _ in range(30):
            window.frame()
        yield window
    finally:
        window.close()


def _in_turns(
    repeats: int, runs: Mapping[str, Callable[[], float]]
) -> tuple[dict[str, list[float]], float]:
    """Alternate two kinds of runs; return their results and the ratio of their medians."""
    for run in runs.values():  # fill disk caches, compile and factor
        run()
    taken: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(repeats):
        for name, run in runs.items():
            taken[name].append(run())
    first, second = map(statistics.median, taken.values())
    return taken, first / second


def _launch(backend: Backend, repeats: int) -> Report:
    """Return the seconds from the start of Python to the end of the first frame."""
    arguments = str(asset_path("human_A.off")), backend
    runs = {
        name: partial(_until_drawn, [sys.executable, "-c", code, *arguments])
        for name, code in (("app", _APP_SCRIPT), ("polyscope", _POLYSCOPE_SCRIPT))
    }
    seconds, ratio = _in_turns(repeats, runs)
    return {"seconds": seconds, "ratio": ratio, "at_most": LAUNCH_RATIO_MAX}


def _until_drawn(command: list[str]) -> float:
    start = time.perf_counter()
    with (
        subprocess.Popen(command, stdout=subprocess.PIPE, encoding="utf-8") as process,
        signals.cleanup_on_signal(process.kill),
    ):
        assert process.stdout is not None
        line = process.stdout.readline()
        elapsed = time.perf_counter() - start
        process.stdout.read()
    if line != "drawn\n":
        raise RuntimeError(f"{Path(command[0]).name} drew nothing: {line!r}")
    return elapsed


def _throughput(window: Window, repeats: int) -> Report:
    """Return the iterations per second of a match with the window and of the same match alone."""
    session = window.session
    mesh, parameters = session.surface().mesh, session.parameters
    source, target = (
        session.functions.of_document(session.document).evaluate(one.spec)
        for one in session.document.functions
    )
    seconds: list[float] = []

    def alone() -> float:
        start = time.perf_counter()
        found = abfm.match(mesh, source, target, parameters)
        return len(found.energy_history) / (time.perf_counter() - start)

    def with_window() -> float:
        start, solver = time.perf_counter(), session.solver
        session.match()
        seconds.extend(_drawn(window, lambda: not solver.wait(0)))
        elapsed = time.perf_counter() - start
        while solver.running:
            window.frame()
        assert session.result is not None
        return len(session.result.energy_history) / elapsed

    rates, ratio = _in_turns(repeats, {"with window": with_window, "abfm.match": alone})
    return {
        "vertices": len(mesh.vertices),
        "iterations_per_second": rates,
        "ratio": ratio,
        "at_least": THROUGHPUT_MIN,
        "frames": _summary(seconds),
    }


def _drawn(window: Window, condition: Callable[[], bool]) -> list[float]:
    """Draw frames while a condition is true; return the seconds between frames."""
    ends = [time.perf_counter()]
    while condition():
        window.frame()
        ends.append(time.perf_counter())
    return np.diff(ends).tolist()


def _frames(window: Window, iterations: int) -> Report:
    session = window.session
    slow = PAPER | {"max_displacement": 1e-3, "tolerance": 0.0, "cooling_stages": 1}
    session.editor.set_parameter(**slow, iterations=iterations)
    session.match()
    seconds = _drawn(window, lambda: not session.solver.wait(0))
    return _summary(seconds) | {"p95_at_most": FRAME_SECONDS_MAX}


def _summary(seconds: list[float]) -> Report:
    median, high = map(float, np.percentile(seconds, (50, 95)))
    return {"count": len(seconds), "median": median, "p95": high}


def report_text(report: Report) -> str:
    launch, frames, settings = (report[name] for name in ("launch", "frames", "settings"))
    rows = [
        (
            "from the launch to the first frame, over plain polyscope",
            f"{launch['ratio']:.2f}",
            str(launch["at_most"]),
        ),
        *(
            (
                "solver throughput with the window, over `abfm.match`, "
                f"{each['vertices']:,} vertices",
                f"{each['ratio']:.2f}; frames {_milliseconds(each['frames'])}",
                str(each["at_least"]),
            )
            for each in report["throughput"]
        ),
        (
            "frames during a long solve",
            _milliseconds(frames),
            f"{1000 * frames['p95_at_most']:.0f} ms",
        ),
    ]
    note = f"{settings['repeats']} runs each, {settings['backend']}, {settings['cores']} cores"
    return f"{markdown(('quantity', 'measured', 'target'), rows)}\n\n{note}"


def _milliseconds(frames: Report) -> str:
    median, high = 1000 * frames["median"], 1000 * frames["p95"]
    return f"median {median:.0f} ms, 95th percentile {high:.0f} ms of {frames['count']}"


if __name__ == "__main__":
    bench("--viewer")
