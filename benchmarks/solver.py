"""Comparison of the solver with the algorithm of the paper and plain L-BFGS; cost by mesh size.

Run it with ``python -m benchmarks.solver`` and the options of ``abfm bench``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median
from time import perf_counter
from typing import Any

import numpy as np

from abfm import MatchingEnergy, Problem
from abfm.calculus import to_frame
from abfm.types import FloatArray
from benchmarks.common import Log, Report, bench, decimals, machine, machine_line, markdown
from benchmarks.gradients import PARAMETERS, cosines, sphere_problem
from benchmarks.paper_algorithm import PaperDescent, minimise
from benchmarks.watched import MISMATCH, watched_match

MULTIGRID = PARAMETERS.with_values(iterations=10**9, levels=3, reach=1.0)
"""Parameters of the paper's energy, solved on multigrid levels with a long-range mismatch norm.

Only iterates on the mesh itself are compared, because only their energy is that of the paper.
"""
PLAIN_LBFGS = PARAMETERS.with_values(iterations=10**9, preconditioner="none")
COOLING = PARAMETERS.with_values(cooling_stages=3, iterations=500)
SIGMAS = {"default_cooling": "default cooling", "constant_sigma": "constant sigma"}


@dataclass(frozen=True)
class Settings:
    """Mesh sizes, time limits and repetitions; the report has medians of repeated runs."""

    seconds: float = 60.0  # time limit of each baseline
    subdivision: int = 5  # of the icosphere on which solver, baselines and gradients are compared
    subdivisions: Sequence[int] = (4, 5, 6)  # for iterations and costs by mesh size, coarse to fine
    iterations: int = 100  # at constant sigma, before the gradient is timed; 20 or more
    cosine_iterations: int = 300  # of the match whose field is used to compare the gradients
    repeats: int = 3  # runs of the solver on this icosphere
    timings: int = 15  # repeated evaluations of the gradient


def run(log: Log, settings: Settings) -> Report:
    """Compare the solver with both baselines, which takes about four minutes.

    A time or count in the report is None if the energy or mismatch to which it refers was not
    reached. All numbers are the same in every run, except times and numbers that depend on the
    progress of a baseline within its time.
    """
    report: Report = {"ratios": {}}
    _add_race(report, settings, log)
    _add_mesh_sizes(report, settings, log)
    log("cosines of the bracket gradient")
    parameters = PARAMETERS.with_values(iterations=settings.cosine_iterations)
    problem = sphere_problem(settings.subdivision, parameters)
    report["bracket_gradient"] = cosines(problem, watched_match(problem).match.velocity[0])
    report["settings"] = {
        "vertices": len(problem.mesh.vertices),
        "seconds": settings.seconds,
        "iterations": settings.iterations,
        "cosine_iterations": settings.cosine_iterations,
        "mismatch_level": MISMATCH,
        "parameters": PARAMETERS.to_dict(),
    }
    return {**report, "machine": machine()}


def _race(settings: Settings, log: Log) -> tuple[PaperDescent, FloatArray, list[FloatArray]]:
    """Run both baselines for the given time, and the solver until its energy is below theirs.

    Return the descent of the paper's algorithm, and the histories of plain L-BFGS and of each run
    of the solver. All start from zero on new meshes, and their times include all setup.
    """
    size, seconds, repeats = settings.subdivision, settings.seconds, settings.repeats
    for parameters in (MULTIGRID, PLAIN_LBFGS):  # compile kernels first
        watched_match(sphere_problem(3, parameters.with_values(iterations=40)))
    log(f"the paper's algorithm, {seconds:g} s")
    problem = sphere_problem(size)
    paper = minimise(problem.mesh, problem.source, problem.target, PARAMETERS, seconds)
    log(f"plain L-BFGS with the exact gradient, {seconds:g} s")
    plain = watched_match(sphere_problem(size, PLAIN_LBFGS), seconds).history
    lowest = min(paper.energy, plain[-1, 1])
    solver = []
    for repeat in range(repeats):
        log(f"the preconditioned solver, run {repeat + 1} of {repeats}")
        solver.append(watched_match(sphere_problem(size, MULTIGRID), seconds, lowest).history)
    return paper, plain, solver


def time_below(history: FloatArray, energy: float) -> float | None:
    """Return the seconds until the energy of a history is below a value, or None."""
    below = np.flatnonzero(history[:, 1] < energy)
    return float(history[below[0], 0]) if len(below) else None


def _add_race(report: Report, settings: Settings, log: Log) -> None:
    paper, plain, solver = _race(settings, log)
    plain_seconds, plain_energy, _ = plain[-1].tolist()
    paper_seconds = float(paper.history[-1, 0])

    def below(energy: float) -> float | None:
        times = [time_below(history, energy) for history in solver]
        reached = [time for time in times if time is not None]
        return median(reached) if len(reached) == len(times) else None

    below_paper, below_plain = below(paper.energy), below(plain_energy)
    report["ratios"] |= {
        "paper_seconds_to_solver_seconds": _ratio(settings.seconds, below_paper),
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


def _add_mesh_sizes(report: Report, settings: Settings, log: Log) -> None:
    cost: dict[str, float] = {}
    reached: dict[str, dict[str, int | None]] = {name: {} for name in SIGMAS}
    report["iterations_to_mismatch"] = reached
    report["energy_after_iterations"] = energies = {}
    report["seconds"]["by_vertices"] = seconds = {}
    limited = PARAMETERS.with_values(iterations=settings.iterations)
    for subdivision in settings.subdivisions:
        problem = sphere_problem(subdivision, limited)
        size = str(len(problem.mesh.vertices))
        log(f"iterations and cost of the gradient at {size} vertices")
        constant = watched_match(problem)
        cooled = watched_match(problem.with_parameters(COOLING), mismatch=MISMATCH)
        reached["default_cooling"][size] = cooled.iterations_to_mismatch
        reached["constant_sigma"][size] = constant.iterations_to_mismatch
        energies[size] = {str(k): float(constant.history[k, 1]) for k in (10, 20)}
        velocity = constant.match.velocity[0]
        advection, gradient = _gradient_cost(problem, velocity, settings.timings)
        cost[size] = gradient / advection
        seconds[size] = {"advection": advection, "energy_and_gradient": gradient}
    report["ratios"]["gradient_to_advection"] = cost
    sizes = [*cost]
    report["ratios"]["iterations_finest_to_coarsest"] = {
        name: _ratio(counts[sizes[-1]], counts[sizes[0]]) for name, counts in reached.items()
    }


def _ratio(a: float | None, b: float | None) -> float | None:
    return None if a is None or b is None else float(a / b)


def _gradient_cost(problem: Problem, velocity: FloatArray, repeats: int) -> tuple[float, float]:
    """Return median seconds of an advection, and of the energy with its exact gradient."""
    energy = MatchingEnergy(problem.with_parameters(PARAMETERS))
    fields = to_frame(energy.mesh, velocity[None] / energy.length_scale)
    seconds = []
    for _ in range(repeats + 1):
        start = perf_counter()
        energy.flow(fields).forward(energy.functions.source[0])
        middle = perf_counter()
        _ = energy.objective(PARAMETERS.last_sigma).evaluate(fields).gradient
        seconds.append((middle - start, perf_counter() - middle))
    advection, gradient = np.median(seconds[1:], axis=0)  # the first one sets up the mesh
    return float(advection), float(gradient)


def report_text(report: Report) -> str:
    size = f"Sphere of {report['settings']['vertices']} vertices unless another number is given."
    table = markdown(("measured", "value"), _rows(report))
    return f"{table}\n\n{machine_line(report['machine'])}. {size}"


def _rows(report: Report) -> list[tuple[str, str]]:
    ratios, seconds, lowest = (report[key] for key in ("ratios", "seconds", "lowest_energy"))
    limit = f"{report['settings']['seconds']:g} s"

    def race(key: str, name: str, short: str, *more: tuple[str, str]) -> list[tuple[str, str]]:
        after = _number(seconds[f"{key}_until_its_lowest"])
        ratio = ratios[f"{key}_seconds_until_its_lowest_to_solver_seconds"]
        return [
            (
                f"{name}, {limit}: lowest energy (found after)",
                f"{_number(lowest[key])} ({after} s)",
            ),
            ("solver below that energy after", f"{_number(seconds[f'solver_below_{key}'])} s"),
            *more,
            (f"time at which {short} found it / solver's time", _number(ratio)),
        ]

    of_limit = f"{limit} / solver's time", _number(ratios["paper_seconds_to_solver_seconds"])
    rows = [
        *race("paper", "paper's algorithm", "the paper's algorithm", of_limit),
        *race("plain", "plain L-BFGS, exact gradient", "plain L-BFGS"),
    ]
    level = f"{report['settings']['mismatch_level']:g}"
    for key, name in SIGMAS.items():
        counts = _by_key(report["iterations_to_mismatch"][key])
        ratio = _number(ratios["iterations_finest_to_coarsest"][key])
        rows += [
            (f"iterations to mismatch {level}, {name} (vertices)", counts),
            (f"iterations, finest / coarsest mesh, {name}", ratio),
        ]
    for size, energies in report["energy_after_iterations"].items():
        what = f"energy at {size} vertices after (iterations), constant sigma"
        rows.append((what, _by_key(energies)))
    for size, cost in ratios["gradient_to_advection"].items():
        what = f"energy and exact gradient / forward advection at {size} vertices"
        rows.append((what, _number(cost)))
    for row in report["bracket_gradient"]:
        what = "cosine of bracket and exact gradient"
        cosine = f"{row['cosine']:.3f} ({row['completed_cosine']:.3f})"
        rows.append((f"{what}, n = {row['substeps']} (with the dropped factor)", cosine))
    return rows


def _number(value: float | None) -> str:
    return decimals(value, missing="not reached")


def _by_key(values: dict[str, Any]) -> str:
    return ", ".join(f"{_number(value)} ({key})" for key, value in values.items())


if __name__ == "__main__":
    bench()
