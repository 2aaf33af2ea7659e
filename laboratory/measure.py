"""All measurements in one process, one after the other, as one report."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from statistics import median
from time import perf_counter
from typing import Any

import numpy as np

from abfm.calculus.vector_fields import to_frame
from abfm.matching.objective.matching_energy import MatchingEnergy
from abfm.matching.problem import Problem
from abfm.types import FloatArray
from laboratory.cosines import cosines
from laboratory.machine import machine
from laboratory.problem import COOLED, PARAMETERS, sphere_problem
from laboratory.race import race, time_below
from laboratory.watched import LEVEL, watched_match

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Settings:
    """The extent of the measurements.

    Attributes
    ----------
    seconds : float
        What the paper's algorithm and plain L-BFGS get.
    subdivision, subdivisions : int, sequence of int
        Icospheres of the race and the cosines, and of what is measured against the mesh size,
        coarse to fine.
    iterations : int
        At constant sigma on each mesh, and to the field at which the gradient is timed; at least
        20.
    cosine_iterations : int
        To the field at which gradients are compared.
    repeats, timings : int
        Runs of the solver in the race, and timed evaluations of the gradient: their medians count.
    """

    seconds: float = 60.0
    subdivision: int = 5
    subdivisions: Sequence[int] = (4, 5, 6)
    iterations: int = 100
    cosine_iterations: int = 300
    repeats: int = 3
    timings: int = 15


def run(tell: Progress, settings: Settings) -> dict[str, Any]:
    """Measure the solver against the baselines: about four minutes, alone on the machine.

    Parameters
    ----------
    tell : callable
        Told in one line what is measured next.
    settings : Settings

    Returns
    -------
    dict
        Only numbers, text, lists and dictionaries, so that it can go into a JSON file: ``ratios``
        first, then what they are ratios of, then ``settings`` and ``machine``. A number is None
        where a level was not reached. Apart from times, and from what depends on how far a baseline
        got in its time, the numbers are the same at every run.
    """
    report: dict[str, Any] = {"ratios": {}}
    _add_race(report, settings, tell)
    _add_mesh_sizes(report, settings, tell)
    tell("cosines of the bracket gradient")
    parameters = replace(PARAMETERS, iterations=settings.cosine_iterations)
    problem = sphere_problem(settings.subdivision, parameters)
    found = watched_match(problem).found
    report["bracket_gradient"] = cosines(problem, found.velocity[0])
    report["settings"] = {
        "vertices": len(problem.mesh.vertices),
        "seconds": settings.seconds,
        "iterations": settings.iterations,
        "cosine_iterations": settings.cosine_iterations,
        "mismatch_level": LEVEL,
        "parameters": PARAMETERS.to_dict(),
    }
    return {**report, "machine": machine()}


def _add_race(report: dict[str, Any], settings: Settings, tell: Progress) -> None:
    seconds = settings.seconds
    paper, plain, solver = race(settings.subdivision, seconds, settings.repeats, tell)
    plain_seconds, plain_energy, _ = plain[-1].tolist()
    paper_seconds = float(paper.history[-1, 0])
    below_paper, below_plain = (
        _median([time_below(history, level) for history in solver])
        for level in (paper.energy, plain_energy)
    )
    report["ratios"] |= {
        "paper_seconds_to_solver_seconds": _ratio(seconds, below_paper),
        "paper_seconds_until_its_lowest_to_solver_seconds": _ratio(paper_seconds, below_paper),
        "plain_seconds_until_its_lowest_to_solver_seconds": _ratio(plain_seconds, below_plain),
    }
    report["lowest_energy"] = {"paper": paper.energy, "plain": plain_energy}
    report["paper_run"] = {"evaluations": paper.evaluations, "stop_reason": paper.stop_reason}
    report["seconds"] = {
        "paper_until_its_lowest": paper_seconds,
        "plain_until_its_lowest": plain_seconds,
        "solver_below_paper": below_paper,
        "solver_below_plain": below_plain,
    }


def _add_mesh_sizes(report: dict[str, Any], settings: Settings, tell: Progress) -> None:
    cost: dict[str, float] = {}
    reached: dict[str, dict[str, int | None]] = {"default_cooling": {}, "constant_sigma": {}}
    report["iterations_to_mismatch"] = reached
    report["energy_after_iterations"] = energies = {}
    report["seconds"]["by_vertices"] = seconds = {}
    for subdivision in settings.subdivisions:
        parameters = replace(PARAMETERS, iterations=settings.iterations)
        problem = sphere_problem(subdivision, parameters)
        size = str(len(problem.mesh.vertices))
        tell(f"iterations and cost of the gradient at {size} vertices")
        constant = watched_match(problem)
        cooled = watched_match(problem.with_parameters(COOLED), mismatch=LEVEL)
        reached["default_cooling"][size] = cooled.iterations_to_level
        reached["constant_sigma"][size] = constant.iterations_to_level
        energies[size] = {str(k): float(constant.history[k, 1]) for k in (10, 20)}
        advection, gradient = _gradient_cost(problem, constant.found.velocity[0], settings.timings)
        cost[size] = gradient / advection
        seconds[size] = {"advection": advection, "energy_and_gradient": gradient}
    report["ratios"]["gradient_to_advection"] = cost
    report["ratios"]["iterations_finest_to_coarsest"] = {
        name: _finest_to_coarsest(list(iterations.values())) for name, iterations in reached.items()
    }


def _finest_to_coarsest(iterations: list[int | None]) -> float | None:
    coarsest, finest = iterations[0], iterations[-1]
    return None if coarsest is None or finest is None else finest / coarsest


def _median(values: list[float | None]) -> float | None:
    reached = [value for value in values if value is not None]
    return median(reached) if len(reached) == len(values) else None


def _ratio(a: float, b: float | None) -> float | None:
    return None if b is None else float(a / b)


def _gradient_cost(problem: Problem, velocity: FloatArray, repeats: int) -> tuple[float, float]:
    """Return median seconds of one forward advection and of one energy with exact gradient at a
    field (F, 3), in turn.
    """
    energy = MatchingEnergy(problem.with_parameters(PARAMETERS))
    fields = to_frame(energy.mesh, velocity[None] / energy.length_scale)
    seconds = []
    for _ in range(repeats + 1):
        start = perf_counter()
        energy.flow(fields).forward(energy.functions.source[0])
        middle = perf_counter()
        _ = energy.objective(PARAMETERS.sigma).evaluate(fields).gradient
        seconds.append((middle - start, perf_counter() - middle))
    advection, gradient = np.median(seconds[1:], axis=0)  # the first one sets up the mesh
    return float(advection), float(gradient)
