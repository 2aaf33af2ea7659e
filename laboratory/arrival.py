"""How soon a match arrives as meshes get finer, now and before the solver had a reach."""

from collections.abc import Callable, Sequence
from math import inf, log
from typing import Any

import numpy as np

from abfm import Parameters, Problem, function
from abfm.mesh.shapes import sphere
from laboratory.common import LEVEL, in_words, machine, markdown, number, watched_match
from laboratory.success import BEFORE

ENOUGH = 12.0
"""Times the new solver's time after which the old one is not waited for any longer."""
_WIDTH = 0.1
_APART = 1.2  # radians on the sphere: between a quarter and half of the way round to the other side


def gaussians(subdivision: int, parameters: Parameters) -> Problem:
    """State one Gaussian to another on a new icosphere."""
    mesh = sphere(subdivision)
    source, target = (
        function(mesh, f"gaussian:vertex={np.argmax(mesh.vertices @ place)},width={_WIDTH:g}")
        for place in ([1.0, 0.0, 0.0], [np.cos(_APART), np.sin(_APART), 0.0])
    )
    return Problem(mesh, source, target, parameters)


def run_arrival(
    progress: Callable[[str], None], subdivisions: Sequence[int] = (5, 6, 7)
) -> dict[str, Any]:
    """Measure both solvers on each mesh, one after the other; numbers for JSON."""
    for parameters in (Parameters(), BEFORE):  # compiles and loads what is needed
        watched_match(gaussians(4, parameters))
    rows = []
    for subdivision in subdivisions:
        size = 10 * 4**subdivision + 2
        progress(f"{size} vertices, now")
        now = watched_match(gaussians(subdivision, Parameters()))
        progress(f"{size} vertices, before")
        before = watched_match(gaussians(subdivision, BEFORE), ENOUGH * now.to_level)
        came = before.to_level < inf
        rows.append(
            {
                "vertices": size,
                "seconds": now.to_level if now.to_level < inf else None,
                "seconds_to_end": now.to_end,
                "residual": now.found.residual,
                "verified_residual": now.found.verified_residual,
                "before_seconds": before.to_level if came else None,
                "ratio": before.to_level / now.to_level if came else None,
                "ratio_at_least": (before.to_level if came else before.to_end) / now.to_level,
            }
        )
    (small, early), (large, late) = (
        (row["vertices"], row["seconds_to_end"]) for row in (rows[0], rows[-1])
    )
    growth = None if small == large else log(late / early) / log(large / small)
    return {"arrival": rows, "growth": growth, "machine": machine()}


def format_arrival(report: dict[str, Any]) -> str:
    """Return the report as a table in Markdown, with the machine below it."""
    seconds = f"seconds to mismatch {LEVEL:g}"
    rows = [("vertices", seconds, "to the end", "residual, by flow lines", "before / now")]
    for row in report["arrival"]:
        came, ended = number(row["seconds"]), number(row["seconds_to_end"])
        residuals = f"{row['residual']:.3f}, {row['verified_residual']:.3f}"
        ratio = number(row["ratio"] or row["ratio_at_least"])
        over = "over " if row["ratio"] is None else ""
        rows.append((str(row["vertices"]), came, ended, residuals, f"{over}{ratio}"))
    lines = markdown(rows)
    if report["growth"] is not None:
        lines += ["", f"Seconds to the end grow like vertices^{report['growth']:.2f}."]
    return "\n".join([*lines, "", f"{in_words(report['machine'])}."])
