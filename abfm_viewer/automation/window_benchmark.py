"""What the window costs: the solver with and without it, its frames during a solve, and how long it takes to open."""

import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from abfm import Parameters, TriangleMesh
from abfm.assets import asset_path
from abfm.benchmark.problem import sphere_problem
from abfm_viewer.computing.evaluation import Functions
from abfm_viewer.computing.solver import Problem, Solver
from abfm_viewer.document.defaults import default_functions
from abfm_viewer.document.document import Channel
from abfm_viewer.scene import opengl
from abfm_viewer.scene.opengl import Backend
from abfm_viewer.session.session import Session
from abfm_viewer.window.window import Window

LEAST_THROUGHPUT, LONGEST_FRAME, LARGEST_LAUNCH_RATIO = 0.9, 0.040, 1.5
_SIZE = (1280, 800)
_BARE = """
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
_APP = """
import sys
from abfm_viewer.window.open_window import open_window
window = open_window(sys.argv[1], sys.argv[2], (1280, 800))
window.tick()
print("drawn", flush=True)
window.close()
"""


def run(tell: Callable[[str], None], subdivision: int = 5, iterations: int = 60, repeats: int = 5) -> dict[str, Any]:
    """Measure all three; ratios are of medians of as many runs as `repeats` says, which take turns.

    The solver's meshes are icospheres of ``10 * 4**subdivision + 2`` vertices.
    """
    backend: Backend = opengl.WINDOW if {"DISPLAY", "WAYLAND_DISPLAY"} & os.environ.keys() else opengl.OFFSCREEN
    tell("launch to the first frame, the app and bare polyscope in turns")
    launch = _launch(backend, repeats)
    mesh, parameters = sphere_problem(subdivision).mesh, Parameters(iterations=iterations)
    window = Window(Session(mesh, "sphere"), backend, _SIZE)
    tell("solver with the window open and without, in turns")
    throughput = _throughput(mesh, parameters, window, repeats)
    tell("frames during a solve")
    frames = _frames(window, 5 * iterations)
    window.close()
    return {
        "launch": launch,
        "throughput": throughput,
        "frames": frames,
        "settings": {"vertices": len(mesh.vertices), "iterations": iterations, "repeats": repeats, "backend": backend},
    }


def _in_turns(repeats: int, runs: Mapping[str, Callable[[], float]]) -> tuple[dict[str, list[float]], float]:
    """What runs of each kind give, and the ratio of the first kind's median to the second's."""
    for run in runs.values():  # fills the caches of the disk, compiles and factors
        run()
    taken: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(repeats):
        for name, run in runs.items():
            taken[name].append(run())
    first, second = map(statistics.median, taken.values())
    return taken, first / second


def _launch(backend: Backend, repeats: int) -> dict[str, Any]:
    """Seconds from starting Python to the end of the first frame."""
    arguments = str(asset_path("human_A.off")), backend
    runs = {
        name: partial(_until_drawn, [sys.executable, "-c", code, *arguments])
        for name, code in (("app", _APP), ("bare polyscope", _BARE))
    }
    seconds, ratio = _in_turns(repeats, runs)
    return {"seconds": seconds, "ratio": ratio, "at_most": LARGEST_LAUNCH_RATIO}


def _until_drawn(command: list[str]) -> float:
    start = time.perf_counter()
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        line = process.stdout.readline()
        elapsed = time.perf_counter() - start
        process.stdout.read()
    if line != "drawn\n":
        raise RuntimeError(f"{Path(command[0]).name} drew nothing: {line!r}")
    return elapsed


def _throughput(mesh: TriangleMesh, parameters: Parameters, window: Window, repeats: int) -> dict[str, Any]:
    """Iterations per second of the same solve, with frames drawn of a scene in which nothing moves, and with none."""
    functions = Functions(mesh)
    problem = Problem(mesh, (Channel(*default_functions(mesh)),), parameters, "")

    def rate(meanwhile: Callable[[Solver], None]) -> float:
        start = time.perf_counter()
        solver = Solver()
        solver.start(problem, functions)
        while (ended := solver.collect()) is None:
            meanwhile(solver)
        _, run, _ = ended
        return (len(run.stages) if run else 0) / (time.perf_counter() - start)

    for _ in range(30):
        window.frame()
    with_window, without = partial(rate, lambda solver: window.frame()), partial(rate, Solver.wait)
    rates, ratio = _in_turns(repeats, {"with window": with_window, "without": without})
    return {"iterations_per_second": rates, "ratio": ratio, "at_least": LEAST_THROUGHPUT}


def _frames(window: Window, iterations: int) -> dict[str, Any]:
    """Seconds from frame to frame while the window follows a solve."""
    session = window.session
    while session.values("source") is None:
        window.frame()
    session.set_parameter(iterations=iterations)
    session.match()
    ends = [time.perf_counter()]
    while session.solver.running:
        window.frame()
        ends.append(time.perf_counter())
    seconds = np.diff(ends)
    median, high = map(float, np.percentile(seconds, (50, 95)))
    return {"count": len(seconds), "median": median, "p95": high, "p95_at_most": LONGEST_FRAME}


def format_report(report: dict[str, Any]) -> str:
    launch, throughput, frames, settings = (report[name] for name in ("launch", "throughput", "frames", "settings"))
    return "\n".join(
        [
            f"launch to first frame, over bare polyscope: {launch['ratio']:.2f} (at most {launch['at_most']})",
            f"solver throughput, window open over none: {throughput['ratio']:.2f} (at least {throughput['at_least']})",
            f"frames during a solve: median {1000 * frames['median']:.1f} ms, 95th percentile "
            f"{1000 * frames['p95']:.1f} ms (at most {1000 * frames['p95_at_most']:.0f}) of {frames['count']}",
            f"measured with {settings['vertices']:,} vertices, {settings['iterations']} iterations, "
            f"{settings['repeats']} runs each, {settings['backend']}",
        ]
    )
