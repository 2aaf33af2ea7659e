"""The solver against its baselines: who is how fast to the same energy, what depends on the mesh's
size, and how far the paper's gradient is from the exact one.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median
from time import perf_counter
from typing import Any

import numpy as np

from abfm import MatchingEnergy, Problem
from abfm.calculus import to_frame
from abfm.types import FloatArray
from laboratory import common
from laboratory.common import LEVEL, PARAMETERS, number, sphere_problem, watched_match
from laboratory.paper_algorithm import PaperDescent, PaperEnergy, minimise

Progress = Callable[[str], None]
Report = dict[str, Any]

SOLVER = PARAMETERS.with_values(iterations=10**9, levels=3, reach=1.0)
"""The paper's energy, on coarser meshes first, where the target is looked for from afar; only
iterates on the mesh itself count, whose energy is the paper's."""
PLAIN = PARAMETERS.with_values(iterations=10**9, preconditioner="none")
SUBSTEPS = (1, 10, 40)
_COLUMNS = {
    "substeps": "n",
    "cosine": "cosine, as printed",
    "length": "length, as printed",
    "whole_cosine": "cosine of the whole gradient, as printed",
    "completed_cosine": "cosine, with the dropped factor",
}


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


def run(tell: Progress, settings: Settings) -> Report:
    """Measure the solver against the baselines: about four minutes, alone on the machine.

    `tell` is told in one line what is measured next. Only numbers, text, lists and dictionaries
    come, for a JSON file: ``ratios`` first, then what they are ratios of, then ``settings`` and
    ``machine``. A number is None where a level was not reached. Apart from times, and from what
    depends on how far a baseline got in its time, the numbers are the same at every run.
    """
    report: Report = {"ratios": {}}
    _add_race(report, settings, tell)
    _add_mesh_sizes(report, settings, tell)
    tell("cosines of the bracket gradient")
    parameters = PARAMETERS.with_values(iterations=settings.cosine_iterations)
    problem = sphere_problem(settings.subdivision, parameters)
    report["bracket_gradient"] = cosines(problem, watched_match(problem).found.velocity[0])
    report["settings"] = {
        "vertices": len(problem.mesh.vertices),
        "seconds": settings.seconds,
        "iterations": settings.iterations,
        "cosine_iterations": settings.cosine_iterations,
        "mismatch_level": LEVEL,
        "parameters": PARAMETERS.to_dict(),
    }
    return {**report, "machine": common.machine()}


def race(settings: Settings, tell: Progress) -> tuple[PaperDescent, FloatArray, list[FloatArray]]:
    """Give the paper's algorithm and plain L-BFGS some seconds each, then run the solver to where
    they got.

    Histories, of the latter two as in `Watched`, are from ``v = 0`` on new meshes, set-up and
    factorisation included; each of the solver's ends below the lowest energy of both others, or
    when time is up.
    """
    size, seconds, repeats = settings.subdivision, settings.seconds, settings.repeats
    for parameters in (SOLVER, PLAIN):  # compiles and loads what is needed
        watched_match(sphere_problem(3, parameters.with_values(iterations=40)))
    tell(f"the paper's algorithm, {seconds:g} s")
    problem = sphere_problem(size)
    paper = minimise(problem.mesh, problem.source, problem.target, PARAMETERS, seconds)
    tell(f"plain L-BFGS with the exact gradient, {seconds:g} s")
    plain = watched_match(sphere_problem(size, PLAIN), seconds).history
    lowest = min(paper.energy, plain[-1, 1])
    solver = []
    for repeat in range(repeats):
        tell(f"the preconditioned solver, run {repeat + 1} of {repeats}")
        solver.append(watched_match(sphere_problem(size, SOLVER), seconds, lowest).history)
    return paper, plain, solver


def time_below(history: FloatArray, level: float) -> float | None:
    """Return seconds until the energy of a history was below a level; None if it never was."""
    below = np.flatnonzero(history[:, 1] < level)
    return float(history[below[0], 0]) if len(below) else None


def _add_race(report: Report, settings: Settings, tell: Progress) -> None:
    paper, plain, solver = race(settings, tell)
    plain_seconds, plain_energy, _ = plain[-1].tolist()
    paper_seconds = float(paper.history[-1, 0])

    def below(level: float) -> float | None:
        times = [time_below(history, level) for history in solver]
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


def _add_mesh_sizes(report: Report, settings: Settings, tell: Progress) -> None:
    cost: dict[str, float] = {}
    reached: dict[str, dict[str, int | None]] = {"default_cooling": {}, "constant_sigma": {}}
    report["iterations_to_mismatch"] = reached
    report["energy_after_iterations"] = energies = {}
    report["seconds"]["by_vertices"] = seconds = {}
    for subdivision in settings.subdivisions:
        problem = sphere_problem(
            subdivision, PARAMETERS.with_values(iterations=settings.iterations)
        )
        size = str(len(problem.mesh.vertices))
        tell(f"iterations and cost of the gradient at {size} vertices")
        constant = watched_match(problem)
        cooled = watched_match(problem.with_parameters(common.COOLED), mismatch=LEVEL)
        reached["default_cooling"][size] = cooled.iterations_to_level
        reached["constant_sigma"][size] = constant.iterations_to_level
        energies[size] = {str(k): float(constant.history[k, 1]) for k in (10, 20)}
        advection, gradient = _gradient_cost(problem, constant.found.velocity[0], settings.timings)
        cost[size] = gradient / advection
        seconds[size] = {"advection": advection, "energy_and_gradient": gradient}
    report["ratios"]["gradient_to_advection"] = cost
    sizes = list(cost)  # coarse to fine
    report["ratios"]["iterations_finest_to_coarsest"] = {
        name: _ratio(counts[sizes[-1]], counts[sizes[0]]) for name, counts in reached.items()
    }


def _ratio(a: float | None, b: float | None) -> float | None:
    return None if a is None or b is None else float(a / b)


def _gradient_cost(problem: Problem, velocity: FloatArray, repeats: int) -> tuple[float, float]:
    """Return median seconds of an advection, and of energy with exact gradient, in turn."""
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


def cosines(
    problem: Problem, velocity: FloatArray, substeps: Sequence[int] = SUBSTEPS
) -> list[dict[str, float]]:
    """Compare the bracket gradient with the exact one of the discrete energy at a field (F, 3) in
    the mesh's units, a row for each number n of sub-steps.

    There are ``cosine`` between both gradients of the mismatch (the regularity's is the same),
    ``length`` of the bracket gradient of the mismatch relative to the exact one's, ``whole_cosine``
    between the gradients of the whole energy, and ``completed_cosine`` as ``cosine`` with the
    factor ``exp(-dtau D_v)`` that is dropped in print.
    """
    exact_energy = MatchingEnergy(problem.with_parameters(PARAMETERS))
    fields = to_frame(exact_energy.mesh, velocity[None] / exact_energy.length_scale)
    regularity = PARAMETERS.tau * exact_energy.regularizer().apply(fields[0]).ravel()
    whole = exact_energy.objective(PARAMETERS.last_sigma).evaluate(fields).gradient.ravel()
    exact = whole - regularity

    def cosine(a: FloatArray, b: FloatArray) -> float:
        return float(a @ b / (np.linalg.norm(a) * np.linalg.norm(b)))

    rows = []
    for n in substeps:
        stated = problem.mesh, problem.source, problem.target, PARAMETERS.with_values(substeps=n)
        printed, completed = (
            PaperEnergy(*stated, as_printed)(fields.ravel())[1] for as_printed in (True, False)
        )
        rows.append(
            {
                "substeps": n,
                "cosine": cosine(printed - regularity, exact),
                "length": float(np.linalg.norm(printed - regularity) / np.linalg.norm(exact)),
                "whole_cosine": cosine(printed, whole),
                "completed_cosine": cosine(completed - regularity, exact),
            }
        )
    return rows


def cosine_table(
    subdivision: int = 5, iterations: int = 300, substeps: Sequence[int] = SUBSTEPS
) -> str:
    """Return the rows of `cosines` at a field of the solver's, as a table in Markdown."""
    problem = sphere_problem(subdivision, PARAMETERS.with_values(iterations=iterations))
    found = cosines(problem, watched_match(problem).found.velocity[0], substeps)
    rows = [[f"{row[key]:.3g}" for key in _COLUMNS] for row in found]
    return "\n".join(common.markdown([list(_COLUMNS.values()), *rows]))


def format_report(report: Report) -> str:
    """Return the report of `run` as aligned lines of text."""
    return "\n".join([*common.aligned(_rows(report)), "", _context(report)])


def markdown_table(report: Report) -> str:
    """Return the report of `run` as a table in Markdown, with the machine below it."""
    table = common.markdown([("measured", "value"), *_rows(report)])
    return "\n".join([*table, "", _context(report)])


def _rows(report: Report) -> list[tuple[str, str]]:
    ratios, settings, seconds = report["ratios"], report["settings"], report["seconds"]
    limit, level = f"{settings['seconds']:g} s", f"{settings['mismatch_level']:g}"
    rows = []
    for key, name, found in (
        ("paper", "paper's algorithm", "the paper's algorithm"),
        ("plain", "plain L-BFGS, exact gradient", "plain L-BFGS"),
    ):
        after = number(seconds[f"{key}_until_its_lowest"])
        lowest = f"{number(report['lowest_energy'][key])} ({after} s)"
        rows += [
            (f"{name}, {limit}: lowest energy (found after)", lowest),
            ("solver below that after", f"{number(seconds[f'solver_below_{key}'])} s"),
        ]
        if key == "paper":
            whole = number(ratios["paper_seconds_to_solver_seconds"])
            rows.append((f"{limit} / solver's time", whole))
        ratio = number(ratios[f"{key}_seconds_until_its_lowest_to_solver_seconds"])
        rows.append((f"time at which {found} found it / solver's time", ratio))
    for key, finest_to_coarsest in ratios["iterations_finest_to_coarsest"].items():
        name, iterations = key.replace("_", " "), report["iterations_to_mismatch"][key]
        rows += [
            (f"iterations to mismatch {level}, {name} (vertices)", _each(iterations)),
            (f"the same, finest / coarsest mesh, {name}", number(finest_to_coarsest)),
        ]
    for size, energies in report["energy_after_iterations"].items():
        what = f"energy at {size} vertices after (iterations), constant sigma"
        rows.append((what, _each(energies)))
    for size, cost in ratios["gradient_to_advection"].items():
        what = f"energy and exact gradient / forward advection at {size} vertices"
        rows.append((what, number(cost)))
    for row in report["bracket_gradient"]:
        what = "cosine of bracket and exact gradient"
        cosine = f"{row['cosine']:.3f} ({row['completed_cosine']:.3f})"
        rows.append((f"{what}, n = {row['substeps']} (with the dropped factor)", cosine))
    return rows


def _each(values: dict[str, float | None]) -> str:
    return ", ".join(f"{number(value)} ({key})" for key, value in values.items())


def _context(report: Report) -> str:
    size = f"Sphere of {report['settings']['vertices']} vertices unless said."
    return f"{common.in_words(report['machine'])}. {size}"
