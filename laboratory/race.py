"""Who is how fast to the same energy: the paper's algorithm, plain L-BFGS with the exact
gradient, and the solver.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from abfm.types import FloatArray
from laboratory.paper_algorithm import PaperDescent, minimise
from laboratory.problem import PARAMETERS, sphere_problem
from laboratory.watched import watched_match

SOLVER = replace(PARAMETERS, iterations=10**9, levels=3, reach=1.0)
"""The paper's energy, on coarser meshes first, where the target is looked for from afar; only
iterates on the mesh itself count, whose energy is the paper's."""
PLAIN = replace(PARAMETERS, iterations=10**9, preconditioner="none")


def time_below(history: FloatArray, level: float) -> float | None:
    """Return seconds until the energy of a history was below a level; None if it never was."""
    below = np.flatnonzero(history[:, 1] < level)
    return float(history[below[0], 0]) if len(below) else None


def race(
    subdivision: int, seconds: float, repeats: int, progress: Callable[[str], None]
) -> tuple[PaperDescent, FloatArray, list[FloatArray]]:
    """Give the paper's algorithm and plain L-BFGS some seconds each, then run the solver to where
    they got.

    Histories, of the latter two as in `Watched`, are from ``v = 0`` on new meshes, set-up and
    factorisation included; each of the solver's ends below the lowest energy of both others, or
    when time is up.
    """
    for parameters in (SOLVER, PLAIN):  # compiles and loads what is needed
        watched_match(sphere_problem(3, replace(parameters, iterations=40)))
    progress(f"the paper's algorithm, {seconds:g} s")
    problem = sphere_problem(subdivision)
    paper = minimise(problem.mesh, problem.source, problem.target, PARAMETERS, seconds)
    progress(f"plain L-BFGS with the exact gradient, {seconds:g} s")
    plain = watched_match(sphere_problem(subdivision, PLAIN), seconds).history
    lowest = min(paper.energy, plain[-1, 1])
    solver = []
    for repeat in range(repeats):
        progress(f"the preconditioned solver, run {repeat + 1} of {repeats}")
        problem = sphere_problem(subdivision, SOLVER)
        solver.append(watched_match(problem, seconds, lowest).history)
    return paper, plain, solver
