"""Errors of maps between noisy functions with a known true map.

Run it with ``python -m benchmarks.map_errors`` and the options of ``abfm bench --measured``.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from statistics import median
from zlib import crc32

import numpy as np
from scipy import sparse

from abfm import AbfmError, Flow, Parameters, PointMap, Problem, TriangleMesh
from abfm.batch import LedgerEntry, Row, problem_row
from abfm.calculus import to_ambient
from abfm.calculus.operators import cotangent_laplacian, vertex_areas
from abfm.matching.objective.regularizer import regularizer
from abfm.numerics.cholesky import factor
from abfm.types import FloatArray
from benchmarks.common import Report, bench, decimals, machine_line, markdown
from benchmarks.trials import MeasuredProblem, Trials, measured

SIGMAS = (6.0, 2.0, 1.0, 0.5, 0.25, 0.1)
"""Values of sigma; the best of them is compared with the default."""
SMOOTHNESSES = (0.03, 0.01)
"""Smoothness of the true flows: values of alpha in the norm that defines their distribution."""
SIZES = (0.05, 0.1)
"""Size of the true flows, which last for a time of 1: root mean square speed over sqrt(area)."""
LENGTHS = (0.03, 0.05)
"""Correlation lengths of the textures, divided by sqrt(area)."""
NOISE = 0.2
"""Standard deviation of the target's noise, divided by that of the texture."""
RATIO_NEAR = 1.1
"""Defaults count as close to the best sigma up to this ratio of their map errors."""


@dataclass(frozen=True, eq=False)
class Trial:
    """A random problem: a texture, and the flow and noise that make the target from it."""

    mesh_name: str
    mesh: TriangleMesh
    smoothness: float
    length: float
    size: float
    seed: tuple[int, ...]

    def texture(self) -> FloatArray:
        """Return a random smooth function (V,) of mean 0 and standard deviation 1."""
        rng, mesh = np.random.default_rng([*self.seed, 0]), self.mesh.normalized()
        areas = vertex_areas(mesh)
        form = sparse.diags_array(areas) + 0.5 * self.length**2 * cotangent_laplacian(mesh)
        smooth = factor(sparse.csr_array(form))
        f = smooth(rng.normal(size=len(areas)) * np.sqrt(areas))
        for _ in range(2):
            f = smooth(areas * f)
        f -= np.average(f, weights=areas)
        return np.asarray(f / np.sqrt(np.average(f**2, weights=areas)))

    def flow(self) -> Flow:
        """Return a random smooth flow from time 0 to 1."""
        rng, mesh = np.random.default_rng([*self.seed, 1]), self.mesh.normalized()
        norm = regularizer(mesh, self.smoothness, 2)
        areas = norm.mass[::2]
        v = norm.inverse(rng.normal(size=(len(areas), 2)) * np.sqrt(areas)[:, None])
        v *= self.size / np.sqrt(np.average((v**2).sum(axis=1), weights=areas))
        return Flow(self.mesh, to_ambient(mesh, v) * self.mesh.length_scale, 1.0)

    def noise(self) -> FloatArray:
        rng = np.random.default_rng([*self.seed, 2])
        return NOISE * rng.normal(size=len(self.mesh.vertices))


def map_problems(meshes: Mapping[str, TriangleMesh], seed: int = 0, count: int = 6) -> list[Trial]:
    """Return ``count`` problems of each mesh: first problem 0 of all meshes, then problem 1, ...

    Combinations of the flow's size and smoothness and the texture's length scale alternate. Problem
    k of a mesh depends only on the seed, the mesh and its name.
    """
    kinds = list(product(SIZES, LENGTHS, SMOOTHNESSES))
    found = []
    for index, (name, mesh) in product(range(count), meshes.items()):
        key = crc32(name.encode())
        # a step of 3 visits all combinations, and both values of each property in early problems
        size, length, smoothness = kinds[(3 * index + key) % len(kinds)]
        found.append(Trial(name, mesh, smoothness, length, size, (seed, key, index)))
    return found


def map_distance(first: PointMap, second: PointMap) -> float:
    """Return the area-weighted mean distance between two maps' images, as a share of sqrt(area)."""
    mesh = first.domain
    distances = np.linalg.norm(first.positions - second.positions, axis=1)
    return float(np.average(distances, weights=vertex_areas(mesh)) / mesh.length_scale)


def _measured_problem(trial: Trial, folder: Path) -> MeasuredProblem:
    """Return the matches of a problem: one with default parameters, one for each of `SIGMAS`."""
    flow, f = trial.flow(), trial.texture()
    truth = flow.point_map()
    g = truth.pull_back(f) + trial.noise()
    described = {
        "mesh": trial.mesh_name,
        "vertices": len(trial.mesh.vertices),
        "smoothness": trial.smoothness,
        "length": trial.length,
        "size": trial.size,
        "error": map_distance(truth, PointMap.of_vertices(trial.mesh, trial.mesh)),
        "log2_area": flow.distortion().log2_area.mean,
    }

    def row(sigma: float | None) -> Row:
        problem = Problem(trial.mesh, f, g, Parameters(sigma=sigma))
        return problem_row(problem, folder, f"{trial.mesh_name}, sigma {sigma or 'default'}")

    def measure(entries: Mapping[str, LedgerEntry]) -> Report:
        found = {name: _result(entry, truth) for name, entry in entries.items()}
        return {"problem": described, "fixed": found, "defaults": found.pop("defaults")}

    matches = {"defaults": row(None), **{f"{sigma:g}": row(sigma) for sigma in SIGMAS}}
    return MeasuredProblem(matches, measure)


def _result(entry: LedgerEntry, truth: PointMap) -> Report:
    try:
        match = entry.load()
        step = match.path[match.step]
        return {
            "error": map_distance(truth, match.point_map()),
            "sigma": step.sigma,
            "alpha": step.alpha,
            "refined": match.refined,
            "residual": match.residual,
            "log2_area": match.distortion().log2_area.mean,
            "verdict": match.verdict.kind,
            "seconds": entry.record.seconds,
        }
    except AbfmError as error:  # also for fields whose flow lines do not end
        return {"error": None, "verdict": str(error)}


def best(row: Report) -> tuple[str, float] | None:
    """Return the sigma with the smallest map error, as text, and this error, if any."""
    errors = {sigma: found["error"] for sigma, found in row["fixed"].items()}
    known = {sigma: error for sigma, error in errors.items() if error is not None}
    return min(known.items(), key=lambda each: each[1]) if known else None


def run(trials: Trials) -> Report:
    """Match all problems with the default sigma and with each of `SIGMAS`.

    Each of the report's ``rows`` has the ``problem``, the result with default parameters
    (``defaults``), and the results by sigma (``fixed``).
    """

    def create(folder: Path) -> Iterator[MeasuredProblem]:
        for trial in map_problems(trials.meshes, trials.seed, trials.count):
            try:
                yield _measured_problem(trial, folder)
            except AbfmError as error:  # for meshes without such a flow
                trials.log(f"skipped: {trial.mesh_name}: {error}")

    rows = measured(trials, create, lambda row: ", ".join(_cells(row)))
    return trials.report(rows, noise=NOISE)


def _ratio(row: Report) -> float | None:
    least, error = best(row), row["defaults"]["error"]
    return None if least is None or error is None else error / least[1]


def _best_cell(row: Report) -> str:
    least = best(row)
    return "none" if least is None else f"{least[1]:.4f} ({least[0]})"


COLUMNS: dict[str, Callable[[Report], str]] = {
    "mesh": lambda row: str(row["problem"]["mesh"]),
    "flow": lambda row: f"{row['problem']['size']:g} at {row['problem']['smoothness']:g}",
    "texture": lambda row: f"{row['problem']['length']:g}",
    "error before": lambda row: f"{row['problem']['error']:.4f}",
    "of defaults": lambda row: decimals(row["defaults"]["error"], ".4f"),
    "of the best sigma": _best_cell,
    "ratio": lambda row: decimals(_ratio(row), ".2f"),
    "sigma": lambda row: decimals(row["defaults"].get("sigma")),
    "alpha": lambda row: decimals(row["defaults"].get("alpha"), ".2g"),
    "log2 J true": lambda row: f"{row['problem']['log2_area']:.3f}",
    "found": lambda row: decimals(row["defaults"].get("log2_area"), ".3f"),
    "verdict": lambda row: str(row["defaults"]["verdict"]),
    "seconds": lambda row: decimals(row["defaults"].get("seconds"), ".1f"),
}


def _cells(row: Report) -> list[str]:
    return [cell(row) for cell in COLUMNS.values()]


def report_text(report: Report) -> str:
    rows, settings = report["rows"], report["settings"]
    ratios = [ratio for row in rows if (ratio := _ratio(row)) is not None]
    near = sum(ratio <= RATIO_NEAR for ratio in ratios)
    notes = (
        f"Defaults with at most {RATIO_NEAR:g} times the error of the best sigma: {near} of "
        f"{len(rows)}; median ratio {decimals(median(ratios) if ratios else None, '.2f')}.",
        "Flow: root mean square of its speed for a time of 1, and alpha of the norm in which it is "
        "random. Texture: its correlation length. Error: mean distance from the true map. All are "
        f"over sqrt(area). The target has {100 * settings['noise']:g}% noise. Best sigma: the best "
        f"of {', '.join(f'{sigma:g}' for sigma in SIGMAS)}. Sigma, alpha: of the match with "
        "defaults. log2 J: mean |log2 J| of the true map and of the one found.",
        f"{len(rows)} problems on {len(settings['meshes'])} meshes, seed {settings['seed']}. "
        f"{machine_line(report['machine'])}.",
    )
    return "\n\n".join([markdown([*COLUMNS], map(_cells, rows)), *notes])


if __name__ == "__main__":
    bench("--measured")
