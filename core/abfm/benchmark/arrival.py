"""How soon a match arrives as meshes get finer, by the solver as it is and as it was before it had a reach."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf, log
from typing import Any

import numpy as np

from abfm.benchmark.machine import in_words, machine
from abfm.benchmark.problem import Problem, sphere_problem
from abfm.benchmark.success.record import BEFORE
from abfm.benchmark.watched import LEVEL, Watched, watched_match
from abfm.functions import function
from abfm.parameters import Parameters

ENOUGH = 12.0
"""Times the new solver's time after which the old one is not waited for any longer."""
_WIDTH = 0.1
_APART = 1.2  # radians on the sphere: between a quarter and half of the way round to the other side


def arrival(problem: Problem, parameters: Parameters, limit: float = inf) -> Watched:
    """Match once; what is cancelled after ``limit`` seconds did not arrive if it had not by then."""
    return watched_match(problem.mesh, problem.source, problem.target, parameters, limit)


def gaussians(subdivision: int) -> Problem:
    """A Gaussian to another on a new icosphere of ``10 * 4**subdivision + 2`` vertices."""
    mesh = sphere_problem(subdivision).mesh
    vertices = [int(np.argmax(mesh.vertices @ [np.cos(angle), np.sin(angle), 0.0])) for angle in (0.0, _APART)]
    source, target = (function(mesh, f"gaussian:vertex={vertex},width={_WIDTH:g}") for vertex in vertices)
    return Problem(mesh, source, target)


def run_arrival(progress: Callable[[str], None], subdivisions: Sequence[int] = (5, 6, 7)) -> dict[str, Any]:
    """Both solvers on each mesh, one after the other in this process; numbers only, ready for JSON."""
    for parameters in (Parameters(), BEFORE):  # compiles and loads what is needed
        arrival(gaussians(4), parameters)
    rows = []
    for subdivision in subdivisions:
        size = 10 * 4**subdivision + 2
        progress(f"{size} vertices, now")
        now = arrival(gaussians(subdivision), Parameters())
        progress(f"{size} vertices, before")
        before = arrival(gaussians(subdivision), BEFORE, ENOUGH * now.to_level)
        came = before.to_level < inf
        rows.append(
            {
                "vertices": size,
                "seconds": now.to_level if now.to_level < inf else None,
                "seconds_to_end": now.to_end,
                "mismatch": now.found.mismatch,
                "verified_mismatch": now.found.verified_mismatch,
                "before_seconds": before.to_level if came else None,
                "ratio": before.to_level / now.to_level if came else None,
                "ratio_at_least": (before.to_level if came else before.to_end) / now.to_level,
            }
        )
    first, last = rows[0], rows[-1]
    return {"arrival": rows, "growth": _growth(first, last), "machine": machine()}


def _growth(first: dict[str, Any], last: dict[str, Any]) -> float | None:
    """Exponent of the number of vertices in the seconds to the end."""
    if first["vertices"] == last["vertices"]:
        return None
    return log(last["seconds_to_end"] / first["seconds_to_end"]) / log(last["vertices"] / first["vertices"])


def format_arrival(report: dict[str, Any]) -> str:
    """The report as a table in Markdown, with the machine below it."""
    head = [
        f"| vertices | seconds to mismatch {LEVEL:g} | to the end | mismatch, by flow lines | before / now |",
        "| --- | --- | --- | --- | --- |",
    ]
    lines = [
        f"| {row['vertices']} | {_number(row['seconds'])} | {row['seconds_to_end']:.3g} | {row['mismatch']:.3f}, "
        f"{row['verified_mismatch']:.3f} | {_ratio(row)} |"
        for row in report["arrival"]
    ]
    growth = [] if report["growth"] is None else ["", f"Seconds to the end grow like vertices^{report['growth']:.2f}."]
    return "\n".join([*head, *lines, *growth, "", f"{in_words(report['machine'])}."])


def _number(value: float | None) -> str:
    return "not reached" if value is None else f"{value:.3g}"


def _ratio(row: dict[str, Any]) -> str:
    return f"{row['ratio']:.3g}" if row["ratio"] is not None else f"over {row['ratio_at_least']:.3g}"
