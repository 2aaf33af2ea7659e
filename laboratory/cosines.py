"""How far the paper's gradient is from the exact one."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from abfm.calculus.vector_fields import to_frame
from abfm.matching.objective.matching_energy import MatchingEnergy
from abfm.matching.problem import Problem
from abfm.types import FloatArray
from laboratory.paper_algorithm import PaperEnergy
from laboratory.problem import PARAMETERS, sphere_problem
from laboratory.tables import markdown
from laboratory.watched import watched_match

SUBSTEPS = (1, 10, 40)
COLUMNS = {
    "substeps": "n",
    "cosine": "cosine, as printed",
    "length": "length, as printed",
    "whole_cosine": "cosine of the whole gradient, as printed",
    "completed_cosine": "cosine, with the dropped factor",
}
"""Keys of the rows of `cosines`, and what to call them in a table."""


def cosines(
    problem: Problem, velocity: FloatArray, substeps: Sequence[int] = SUBSTEPS
) -> list[dict[str, float]]:
    """Compare the bracket gradient with the exact one of the discrete energy, for several numbers
    of sub-steps n.

    Parameters
    ----------
    problem : Problem
    velocity : (F, 3) array
        Where to compare, in the mesh's units.
    substeps : sequence of int

    Returns
    -------
    One row for each n: ``cosine`` between both gradients of the mismatch (the regularity's is the
    same), ``length`` of the bracket gradient of the mismatch relative to the exact one's,
    ``whole_cosine`` between the gradients of the whole energy, and ``completed_cosine`` as
    ``cosine`` with the factor ``exp(-dtau D_v)`` that is dropped in print.
    """
    exact_energy = MatchingEnergy(problem.with_parameters(PARAMETERS))
    fields = to_frame(exact_energy.mesh, velocity[None] / exact_energy.length_scale)
    regularity = PARAMETERS.tau * exact_energy.regularizer().apply(fields[0]).ravel()
    whole = exact_energy.objective(PARAMETERS.sigma).evaluate(fields).gradient.ravel()
    exact = whole - regularity
    rows = []
    for n in substeps:
        parameters = replace(PARAMETERS, substeps=n)
        printed, completed = (
            PaperEnergy(problem.mesh, problem.source, problem.target, parameters, as_printed)(
                fields.ravel()
            )[1]
            for as_printed in (True, False)
        )
        rows.append(
            {
                "substeps": n,
                "cosine": _cosine(printed - regularity, exact),
                "length": float(np.linalg.norm(printed - regularity) / np.linalg.norm(exact)),
                "whole_cosine": _cosine(printed, whole),
                "completed_cosine": _cosine(completed - regularity, exact),
            }
        )
    return rows


def cosine_table(
    subdivision: int = 5, iterations: int = 300, substeps: Sequence[int] = SUBSTEPS
) -> str:
    """Return the rows of `cosines` at the field after some iterations of the solver, as a table in
    Markdown.
    """
    problem = sphere_problem(subdivision, replace(PARAMETERS, iterations=iterations))
    found = watched_match(problem).found
    rows = [
        [f"{row[key]:.3g}" for key in COLUMNS]
        for row in cosines(problem, found.velocity[0], substeps)
    ]
    return "\n".join(markdown([list(COLUMNS.values()), *rows]))


def _cosine(a: FloatArray, b: FloatArray) -> float:
    return float(a @ b / (np.linalg.norm(a) * np.linalg.norm(b)))
