"""All measurements in one process, one after the other, as one report."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from statistics import median
from typing import Any

from abfm.benchmark.convergence import COOLED, converge
from abfm.benchmark.cosines import cosines
from abfm.benchmark.gradient_cost import gradient_cost
from abfm.benchmark.machine import machine
from abfm.benchmark.problem import PARAMETERS, sphere_problem
from abfm.benchmark.race import race, time_below
from abfm.benchmark.watched import LEVEL

Progress = Callable[[str], None]


def run(
    progress: Progress | None = None,
    *,
    seconds: float = 60.0,
    subdivision: int = 5,
    subdivisions: Sequence[int] = (4, 5, 6),
    iterations: int = 100,
    cosine_iterations: int = 300,
    repeats: int = 3,
    timings: int = 15,
) -> dict[str, Any]:
    """Measure the solver against the baselines: about four minutes, alone on the machine.

    Parameters
    ----------
    progress : callable, optional
        Told in one line what is measured next.
    seconds : float
        What the paper's algorithm and plain L-BFGS get.
    subdivision : int
        Icosphere of the race and of the cosines: ``10 * 4**subdivision + 2`` vertices.
    subdivisions : sequence of int
        Icospheres of everything that is measured against the mesh size, coarse to fine.
    iterations : int
        Iterations at constant sigma on each mesh, and to the field at which the gradient is timed; at least 20.
    cosine_iterations : int
        Iterations to the field at which gradients are compared.
    repeats : int
        Runs of the solver in the race; their median counts.
    timings : int
        Timed evaluations for the cost of the gradient; their median counts.

    Returns
    -------
    dict
        Only numbers, text, lists and dictionaries, so that it can go into a JSON file: ``ratios`` first, then what they
        are ratios of, then ``settings`` and ``machine``. A number is None where a level was not reached. Apart from
        times, and from what depends on how far a baseline got in its time, the numbers are the same at every run.
    """
    tell = progress or (lambda line: None)
    report: dict[str, Any] = {"ratios": {}}
    _add_race(report, subdivision, seconds, repeats, tell)
    _add_mesh_sizes(report, subdivisions, iterations, timings, tell)
    tell("cosines of the bracket gradient")
    problem = sphere_problem(subdivision)
    velocity = converge(problem, replace(PARAMETERS, iterations=cosine_iterations)).velocity
    report["bracket_gradient"] = cosines(problem, velocity)
    report["settings"] = {
        "vertices": len(problem.mesh.vertices),
        "seconds": seconds,
        "iterations": iterations,
        "cosine_iterations": cosine_iterations,
        "mismatch_level": LEVEL,
        "parameters": PARAMETERS.to_dict(),
    }
    return {**report, "machine": machine()}


def _add_race(report: dict[str, Any], subdivision: int, seconds: float, repeats: int, tell: Progress) -> None:
    result = race(subdivision, seconds, repeats, tell)
    paper, plain = result.paper, result.plain
    below_paper = _median([time_below(history, paper.energy) for history in result.solver])
    below_plain = _median([time_below(history, plain[-1, 1]) for history in result.solver])
    report["ratios"] |= {
        "paper_seconds_to_solver_seconds": _ratio(seconds, below_paper),
        "paper_seconds_until_its_lowest_to_solver_seconds": _ratio(paper.history[-1, 0], below_paper),
        "plain_seconds_until_its_lowest_to_solver_seconds": _ratio(plain[-1, 0], below_plain),
    }
    report["lowest_energy"] = {"paper": paper.energy, "plain": float(plain[-1, 1])}
    report["paper_run"] = {"evaluations": paper.evaluations, "stop_reason": paper.stop_reason}
    report["seconds"] = {
        "paper_until_its_lowest": float(paper.history[-1, 0]),
        "plain_until_its_lowest": float(plain[-1, 0]),
        "solver_below_paper": below_paper,
        "solver_below_plain": below_plain,
    }


def _add_mesh_sizes(
    report: dict[str, Any], subdivisions: Sequence[int], iterations: int, timings: int, tell: Progress
) -> None:
    cost, to_level, to_level_cooled, energies, seconds = {}, {}, {}, {}, {}
    for subdivision in subdivisions:
        problem = sphere_problem(subdivision)
        size = str(len(problem.mesh.vertices))
        tell(f"iterations and cost of the gradient at {size} vertices")
        constant = converge(problem, replace(PARAMETERS, iterations=iterations))
        cooled = converge(problem, COOLED, until=LEVEL)
        to_level[size], to_level_cooled[size] = constant.iterations_to(LEVEL), cooled.iterations_to(LEVEL)
        energies[size] = {"10": constant.energies[10], "20": constant.energies[20]}
        advection, gradient = gradient_cost(problem, constant.velocity, timings)
        cost[size] = gradient / advection
        seconds[size] = {"advection": advection, "energy_and_gradient": gradient}
    report["ratios"]["gradient_to_advection"] = cost
    report["ratios"]["iterations_finest_to_coarsest"] = {
        "default_cooling": _finest_to_coarsest(to_level_cooled),
        "constant_sigma": _finest_to_coarsest(to_level),
    }
    report["iterations_to_mismatch"] = {"default_cooling": to_level_cooled, "constant_sigma": to_level}
    report["energy_after_iterations"] = energies
    report["seconds"]["by_vertices"] = seconds


def _finest_to_coarsest(iterations: dict[str, int | None]) -> float | None:
    coarsest, *_, finest = iterations.values()
    return None if coarsest is None or finest is None else finest / coarsest


def _median(values: list[float | None]) -> float | None:
    reached = [value for value in values if value is not None]
    return median(reached) if len(reached) == len(values) else None


def _ratio(a: float, b: float | None) -> float | None:
    return None if b is None else float(a / b)
