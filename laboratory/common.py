"""What measurements share: a problem on spheres, a match against the clock, the machine, tables."""

import os
import platform
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from importlib.metadata import version
from math import inf
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter
from typing import TypeVar

import numpy as np

from abfm import Control, Iteration, Match, Parameters, Problem, match
from abfm.mesh.shapes import sphere
from abfm.parameters import PAPER
from abfm.types import FloatArray

LEVEL = Parameters.goal
"""Relative mismatch to reach."""
PARAMETERS = Parameters.of(
    **PAPER,
    tau=2.0,
    alpha=1e3,
    beta=1e-5,
    sigma=1e-4,
    segments=1,
    substeps=40,
    quadrature=10,
    cooling_stages=1,
    tolerance=0.0,
)
"""The row of Fig. 3 in Table 1, sigma constant, and no end but the iteration limit."""
COOLED = PARAMETERS.with_values(cooling_stages=3, iterations=500)

_SOURCE_WIDTH, _TARGET_WIDTH = 0.12, 0.06  # standard deviations as fractions of sqrt(area)
_LINUX = Path("/proc/cpuinfo")

Given = TypeVar("Given")
Found = TypeVar("Found")


def sphere_problem(subdivision: int, parameters: Parameters = PARAMETERS) -> Problem:
    """State Fig. 3 on a new icosphere: one wide bump splits into two narrow ones."""
    mesh = sphere(subdivision)

    def bump(angle: float, width: float) -> FloatArray:
        cosines = mesh.vertices @ [np.cos(angle), np.sin(angle), 0.0]
        distances = np.arccos(np.clip(cosines, -1.0, 1.0)) / mesh.length_scale
        return np.asarray(np.exp(-0.5 * (distances / width) ** 2))

    target = bump(1.0, _TARGET_WIDTH) + bump(-1.0, _TARGET_WIDTH)
    return Problem(mesh, bump(0.0, _SOURCE_WIDTH), target, parameters)


@dataclass(frozen=True)
class Watched:
    """Last iterate, seconds, energy, mismatch of each on the mesh (rows, 3), seconds to the end."""

    found: Match
    last: Iteration | None
    history: FloatArray
    to_end: float

    @property
    def to_level(self) -> float:
        """Return seconds until the mismatch on the mesh itself was at most `LEVEL`, or inf."""
        reached = self.iterations_to_level
        return inf if reached is None else float(self.history[reached, 0])

    @property
    def iterations_to_level(self) -> int | None:
        """Return iterations on the mesh itself until then; None if it never was."""
        reached = np.flatnonzero(self.history[:, 2] <= LEVEL)
        return int(reached[0]) if len(reached) else None


def watched_match(
    problem: Problem,
    seconds: float = inf,
    energy: float = -inf,
    mismatch: float = -inf,
    stopped: Callable[[], bool] = lambda: False,
) -> Watched:
    """Match, until time is up, energy or mismatch are low enough on the mesh, or stopped."""
    control = Control()
    functions = problem.functions
    # the paper's definition, relative to the norm of the target
    ratio = functions.deviation(functions.target) / functions.norm(functions.target)
    last: Iteration | None = None
    history: list[tuple[float, float, float]] = []
    start = perf_counter()

    def watch(iterate: Iteration) -> None:
        nonlocal last
        last, now = iterate, perf_counter() - start
        reached = False
        if iterate.level == iterate.levels - 1:
            history.append((now, iterate.energy, ratio * iterate.residual))
            reached = iterate.energy < energy or ratio * iterate.residual <= mismatch
        if stopped() or now > seconds or reached:
            control.cancel()

    found = match(problem, on_iteration=watch, control=control)
    return Watched(found, last, np.array(history).reshape(-1, 3), perf_counter() - start)


def machine() -> dict[str, str | int]:
    """Return the processor, logical cores, system, and versions of what takes the time."""
    model = re.search(r"model name\s*: (.*)", _LINUX.read_text()) if _LINUX.exists() else None
    return {
        "processor": model[1] if model else platform.processor() or platform.machine(),
        "cores": os.cpu_count() or 1,
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        **{package: version(package) for package in ("numpy", "scipy", "numba")},
    }


def in_words(machine: dict[str, str | int]) -> str:
    """Return what `machine` gives, in a line."""
    names = ("python", "numpy", "scipy", "numba")
    packages = ", ".join(f"{name} {machine[name]}" for name in names)
    return f"{machine['processor']}, {machine['cores']} cores, {machine['system']}; {packages}"


def markdown(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return lines of a table in Markdown, of which the first row is the header."""
    header, *others = rows
    return [f"| {' | '.join(row)} |" for row in (header, ["---"] * len(header), *others)]


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return lines of text with the cells of a column below each other."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]


def number(value: float | None) -> str:
    """Return three digits, or that there is none."""
    return "not reached" if value is None else f"{value:.3g}"


def mapped(
    function: Callable[[Given], Found], given: Sequence[Given], jobs: int
) -> Iterator[Found]:
    """Yield what a function of a module returns for each value, by so many processes, in order."""
    if jobs == 1:
        yield from map(function, given)
        return
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # of the processes: one thread each
    with ProcessPoolExecutor(min(jobs, len(given)), get_context("spawn")) as processes:
        yield from processes.map(function, given)


def told_table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table of Markdown; each row is printed as soon as it is known."""
    lines = [f"| {' | '.join(heads)} |", f"|{'---|' * len(heads)}"]
    for row in rows:
        lines.append(f"| {' | '.join(row)} |")
        print(lines[-1], flush=True)
    return "\n".join(lines)


def put_between(path: Path, marks: tuple[str, str], parts: Sequence[str]) -> None:
    """Put paragraphs into a page, between two lines that stay, in place of what is there."""
    page = path.read_text(encoding="utf-8")
    before, after = page.split(marks[0])[0], page.split(marks[1])[1]
    path.write_text(before + "\n\n".join([marks[0], *parts, marks[1]]) + after, encoding="utf-8")
