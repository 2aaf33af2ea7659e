"""The paper's bracket gradient compared with the exact gradient of the discrete energy.

Run it with ``python -m benchmarks.gradients --write docs/gradients.md``.
"""

import argparse
from collections.abc import Iterator, Mapping

import numpy as np

from abfm import MatchingEnergy, Parameters, Problem
from abfm.calculus import to_frame
from abfm.mesh.shapes import sphere
from abfm.parameters import PAPER
from abfm.types import FloatArray
from benchmarks.common import Cells, Report, Table, main
from benchmarks.paper_algorithm import PaperEnergy
from benchmarks.watched import watched_match

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
"""Parameters of the paper's Fig. 3 with constant sigma; only the iteration limit ends a match."""
SUBSTEPS = (1, 10, 40)
SUBDIVISION = 5
"""Number of subdivisions of the icosphere on which the gradients are compared."""
ITERATIONS = 300
"""Number of iterations of a match after which the gradients at its field are compared."""

_SOURCE_WIDTH = 0.12  # standard deviation as a fraction of sqrt(area)
_TARGET_WIDTH = 0.06
_COLUMNS = {
    "substeps": "n",
    "cosine": "cosine, as printed",
    "length": "length, as printed",
    "complete_cosine": "cosine of the complete gradient, as printed",
    "completed_cosine": "cosine, with the dropped factor",
}


def sphere_problem(subdivision: int, parameters: Parameters = PARAMETERS) -> Problem:
    """Return the problem of Fig. 3 on an icosphere: match a wide Gaussian to two narrow ones."""
    mesh = sphere(subdivision)

    def gaussian(angle: float, width: float) -> FloatArray:
        cosines = mesh.vertices @ [np.cos(angle), np.sin(angle), 0.0]
        distances = np.arccos(np.clip(cosines, -1.0, 1.0)) / mesh.length_scale
        return np.asarray(np.exp(-0.5 * (distances / width) ** 2))

    target = gaussian(1.0, _TARGET_WIDTH) + gaussian(-1.0, _TARGET_WIDTH)
    return Problem(mesh, gaussian(0.0, _SOURCE_WIDTH), target, parameters)


def cosines(problem: Problem, velocity: FloatArray) -> list[Report]:
    """Compare the bracket and the exact gradient at a field (F, 3), for each of `SUBSTEPS`.

    The gradients are those of the mismatch; that of the regularity is the same:

    - ``cosine`` is the cosine of their angle
    - ``length`` is the norm of the bracket gradient, divided by that of the exact one
    - ``complete_cosine`` is ``cosine`` for the gradients of the complete energy
    - ``completed_cosine`` is ``cosine`` if the bracket gradient includes ``exp(-dtau D_v)``, which
      the paper omits
    """
    exact_energy = MatchingEnergy(problem.with_parameters(PARAMETERS))
    fields = to_frame(exact_energy.mesh, velocity[None] / exact_energy.length_scale)
    regularity = PARAMETERS.tau * exact_energy.regularizer().apply(fields[0]).ravel()
    complete = exact_energy.objective(PARAMETERS.last_sigma).evaluate(fields).gradient.ravel()
    exact = complete - regularity

    def cosine(a: FloatArray, b: FloatArray) -> float:
        return float(a @ b / (np.linalg.norm(a) * np.linalg.norm(b)))

    rows: list[Report] = []
    for n in SUBSTEPS:
        stated = problem.mesh, problem.source, problem.target, PARAMETERS.with_values(substeps=n)
        printed, completed = (
            PaperEnergy(*stated, as_printed)(fields.ravel())[1] for as_printed in (True, False)
        )
        rows.append(
            {
                "substeps": n,
                "cosine": cosine(printed - regularity, exact),
                "length": float(np.linalg.norm(printed - regularity) / np.linalg.norm(exact)),
                "complete_cosine": cosine(printed, complete),
                "completed_cosine": cosine(completed - regularity, exact),
            }
        )
    return rows


def _rows() -> Iterator[Cells]:
    problem = sphere_problem(SUBDIVISION, PARAMETERS.with_values(iterations=ITERATIONS))
    for row in cosines(problem, watched_match(problem).match.velocity[0]):
        yield [f"{row[key]:.3g}" for key in _COLUMNS]


def tables(arguments: argparse.Namespace) -> Mapping[str, Table]:
    return {"gradients": Table([*_COLUMNS.values()], _rows())}


if __name__ == "__main__":
    main(__doc__, tables)
