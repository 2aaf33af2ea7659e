"""Time that the solver takes to match two Gaussians, on increasingly fine spheres.

Run it with ``python -m benchmarks.arrival`` and the options of ``abfm bench --arrival``.
"""

from collections.abc import Sequence
from math import log as logarithm

import numpy as np

from abfm import Problem, function
from abfm.mesh.shapes import sphere
from benchmarks.common import Log, Report, bench, decimals, machine, machine_line, markdown
from benchmarks.watched import MISMATCH, watched_match

_WIDTH = 0.1
_DISTANCE = 1.2  # radians on the sphere

HEADINGS = (
    "vertices",
    f"seconds to mismatch {MISMATCH:g}",
    "to the end",
    "residual, along flow lines",
)


def gaussians(subdivision: int) -> Problem:
    """Return the problem of matching a Gaussian to an equal, distant one on an icosphere."""
    mesh = sphere(subdivision)
    source, target = (
        function(mesh, f"gaussian:vertex={np.argmax(mesh.vertices @ place)},width={_WIDTH:g}")
        for place in ([1.0, 0.0, 0.0], [np.cos(_DISTANCE), np.sin(_DISTANCE), 0.0])
    )
    return Problem(mesh, source, target)


def run(log: Log, subdivisions: Sequence[int] = (5, 6, 7)) -> Report:
    """Measure the time and the residuals of the default solver on each sphere."""
    watched_match(gaussians(4))  # compile kernels before the timed runs
    rows = []
    for subdivision in subdivisions:
        size = 10 * 4**subdivision + 2
        log(f"{size} vertices")
        found = watched_match(gaussians(subdivision))
        rows.append(
            {
                "vertices": size,
                "seconds": found.seconds_to_mismatch,
                "seconds_to_end": found.seconds,
                "residual": found.match.residual,
                "verified_residual": found.match.verified_residual,
            }
        )
    (small, early), (large, late) = (
        (row["vertices"], row["seconds_to_end"]) for row in (rows[0], rows[-1])
    )
    growth = None if small == large else logarithm(late / early) / logarithm(large / small)
    return {"arrival": rows, "growth": growth, "machine": machine()}


def report_text(report: Report) -> str:
    rows = [
        (
            str(row["vertices"]),
            decimals(row["seconds"], missing="not reached"),
            decimals(row["seconds_to_end"]),
            f"{row['residual']:.3f}, {row['verified_residual']:.3f}",
        )
        for row in report["arrival"]
    ]
    growth = f"Seconds to the end grow like vertices^{decimals(report['growth'], '.2f')}."
    return f"{markdown(HEADINGS, rows)}\n\n{growth}\n\n{machine_line(report['machine'])}."


if __name__ == "__main__":
    bench("--arrival")
