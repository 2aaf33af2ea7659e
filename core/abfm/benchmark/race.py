"""Who is how fast to the same energy: the paper's algorithm, plain L-BFGS with the exact gradient, and the solver."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from abfm.baselines.paper import PaperDescent, minimise
from abfm.benchmark.problem import PARAMETERS, Problem, sphere_problem
from abfm.matching.match import Control, Iteration, match
from abfm.parameters import Parameters
from abfm.types import FloatArray

SOLVER = replace(PARAMETERS, iterations=10**9, levels=3, reach=1.0)
"""The paper's energy, on coarser meshes first, where the target is looked for from afar; only iterates on the mesh
itself count, whose energy is the paper's."""
PLAIN = replace(PARAMETERS, iterations=10**9, preconditioner="none")


@dataclass(frozen=True)
class Race:
    """Histories of the contestants, all from ``v = 0`` on new meshes, set-up and factorisation included.

    Attributes
    ----------
    paper : PaperDescent
        Plain L-BFGS with the paper's gradient.
    plain : (rows, 2) array
        Seconds and energy of each iterate of plain L-BFGS with the exact gradient.
    solver : list of (rows, 2) arrays
        The same of the preconditioned solver, once per repeat; each ends below the lowest energy of both others, or
        when time is up.
    """

    paper: PaperDescent
    plain: FloatArray
    solver: list[FloatArray]


def descend(problem: Problem, parameters: Parameters, seconds: float, until: float = -np.inf) -> FloatArray:
    """Match until the time is over or the energy below ``until``: seconds and energy of each iterate, (rows, 2)."""
    control = Control()
    history: list[tuple[float, float]] = []
    start = perf_counter()

    def record(iterate: Iteration) -> None:
        if iterate.level < iterate.levels - 1:
            return
        history.append((perf_counter() - start, iterate.energy))
        if history[-1][0] > seconds or iterate.energy < until:
            control.cancel()

    match(problem.mesh, problem.source, problem.target, parameters, on_iteration=record, control=control)
    return np.array(history)


def time_below(history: FloatArray, level: float) -> float | None:
    """Seconds until the energy of a history (rows, 2) was below a level; None if it never was."""
    below = np.flatnonzero(history[:, 1] < level)
    return float(history[below[0], 0]) if len(below) else None


def race(subdivision: int, seconds: float, repeats: int, progress: Callable[[str], None]) -> Race:
    """Give the paper's algorithm and plain L-BFGS some seconds each, then run the solver to where they got."""
    for parameters in (SOLVER, PLAIN):  # compiles and loads what is needed
        warm_up = sphere_problem(3)
        match(warm_up.mesh, warm_up.source, warm_up.target, replace(parameters, iterations=40))
    progress(f"the paper's algorithm, {seconds:g} s")
    problem = sphere_problem(subdivision)
    paper = minimise(problem.mesh, problem.source, problem.target, PARAMETERS, seconds)
    progress(f"plain L-BFGS with the exact gradient, {seconds:g} s")
    plain = descend(sphere_problem(subdivision), PLAIN, seconds)
    solver = []
    for repeat in range(repeats):
        progress(f"the preconditioned solver, run {repeat + 1} of {repeats}")
        solver.append(descend(sphere_problem(subdivision), SOLVER, seconds, min(paper.energy, plain[-1, 1])))
    return Race(paper, plain, solver)
