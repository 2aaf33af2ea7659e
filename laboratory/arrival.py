"""How soon a match arrives as meshes get finer, by the solver as it is and as it was before it
had a reach.
"""

from collections.abc import Callable, Sequence
from math import inf, log
from typing import Any

import numpy as np

from abfm.functions import function
from abfm.matching.problem import Problem
from abfm.parameters import Parameters
from laboratory.machine import in_words, machine
from laboratory.problem import new_sphere
from laboratory.success.record import BEFORE
from laboratory.tables import markdown, number
from laboratory.watched import LEVEL, watched_match

ENOUGH = 12.0
"""Times the new solver's time after which the old one is not waited for any longer."""
_WIDTH = 0.1
_APART = 1.2  # radians on the sphere: between a quarter and half of the way round to the other side


def gaussians(subdivision: int, parameters: Parameters) -> Problem:
    """State one Gaussian to another on a new icosphere."""
    mesh = new_sphere(subdivision)
    vertices = [
        int(np.argmax(mesh.vertices @ [np.cos(angle), np.sin(angle), 0.0]))
        for angle in (0.0, _APART)
    ]
    source, target = (
        function(mesh, f"gaussian:vertex={vertex},width={_WIDTH:g}") for vertex in vertices
    )
    return Problem(mesh, source, target, parameters)


def run_arrival(
    progress: Callable[[str], None], subdivisions: Sequence[int] = (5, 6, 7)
) -> dict[str, Any]:
    """Measure both solvers on each mesh, one after the other in this process; numbers only,
    ready for JSON.
    """
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
                "mismatch": now.found.mismatch,
                "verified_mismatch": now.found.verified_mismatch,
                "before_seconds": before.to_level if came else None,
                "ratio": before.to_level / now.to_level if came else None,
                "ratio_at_least": (before.to_level if came else before.to_end) / now.to_level,
            }
        )
    return {"arrival": rows, "growth": _growth(rows[0], rows[-1]), "machine": machine()}


def _growth(first: dict[str, Any], last: dict[str, Any]) -> float | None:
    """Return the exponent of the number of vertices in the seconds to the end."""
    if first["vertices"] == last["vertices"]:
        return None
    return log(last["seconds_to_end"] / first["seconds_to_end"]) / log(
        last["vertices"] / first["vertices"]
    )


def format_arrival(report: dict[str, Any]) -> str:
    """Return the report as a table in Markdown, with the machine below it."""
    rows = [
        (
            "vertices",
            f"seconds to mismatch {LEVEL:g}",
            "to the end",
            "mismatch, by flow lines",
            "before / now",
        )
    ]
    for row in report["arrival"]:
        ratio = (
            f"over {row['ratio_at_least']:.3g}" if row["ratio"] is None else number(row["ratio"])
        )
        mismatches = f"{row['mismatch']:.3f}, {row['verified_mismatch']:.3f}"
        rows.append(
            (
                str(row["vertices"]),
                number(row["seconds"]),
                number(row["seconds_to_end"]),
                mismatches,
                ratio,
            )
        )
    growth = (
        []
        if report["growth"] is None
        else ["", f"Seconds to the end grow like vertices^{report['growth']:.2f}."]
    )
    return "\n".join([*markdown(rows), *growth, "", f"{in_words(report['machine'])}."])
