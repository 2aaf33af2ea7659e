"""How far maps between functions as measured ones are end from the truth: known flows and noise."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from statistics import median
from typing import Any
from zlib import crc32

import numpy as np
from scipy import sparse

from abfm import AbfmError, Flow, Match, Parameters, PointMap, Problem, TriangleMesh
from abfm.batch import Entry, problem_row
from abfm.calculus import to_ambient
from abfm.calculus.operators import cotangent_laplacian, vertex_areas
from abfm.matching.objective.regularizer import regularizer
from abfm.numerics.cholesky import factor
from abfm.types import FloatArray
from laboratory.common import aligned, in_words
from laboratory.success import Selection
from laboratory.trials import Place, Posed, Row, Tell, by_batch

SIGMAS = (6.0, 2.0, 1.0, 0.5, 0.25, 0.1)
"""Given values of sigma, the best of which the default is compared with."""
SMOOTHNESSES = (0.03, 0.01)
"""Of true flows: the alpha of the norm in which they are random."""
SIZES = (0.05, 0.1)
"""Of true flows: root mean square of their speed for a time of 1, over sqrt(area)."""
LENGTHS = (0.03, 0.05)
"""Over which textures are correlated, over sqrt(area)."""
NOISE = 0.2
"""Standard deviation of the target's noise over that of the texture."""
NEAR = 1.1
"""Times the best error at which the default is counted as near."""

ALL = Selection()
"""Six problems on each mesh."""

_DEFAULTS = "defaults"


@dataclass(frozen=True, eq=False)
class Trial:
    """A texture, and what is measured of it after a flow that is known."""

    mesh_name: str
    mesh: TriangleMesh
    smoothness: float
    length: float
    size: float
    seed: tuple[int, ...]

    def texture(self) -> FloatArray:
        """Return a random smooth function (V,) of mean 0 and deviation 1."""
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
        """Return a random smooth flow, whose time is 1."""
        rng, mesh = np.random.default_rng([*self.seed, 1]), self.mesh.normalized()
        norm = regularizer(mesh, self.smoothness, 2)
        areas = norm.mass[::2]
        v = norm.inverse(rng.normal(size=(len(areas), 2)) * np.sqrt(areas)[:, None])
        v *= self.size / np.sqrt(np.average((v**2).sum(axis=1), weights=areas))
        return Flow(self.mesh, to_ambient(mesh, v) * self.mesh.length_scale, 1.0)

    def noise(self) -> FloatArray:
        """Return the target's noise, (V,)."""
        rng = np.random.default_rng([*self.seed, 2])
        return NOISE * rng.normal(size=len(self.mesh.vertices))

    def to_dict(self) -> Row:
        """Return all that tells it from others."""
        own = {key: getattr(self, key) for key in ("smoothness", "length", "size")}
        return {"mesh": self.mesh_name, "vertices": len(self.mesh.vertices), **own}


def measured_problems(
    meshes: Mapping[str, TriangleMesh], seed: int = 0, count: int = 6
) -> list[Trial]:
    """Return ``count`` problems of every mesh, the first ones of all meshes first: kinds take
    turns, and problem k of a mesh depends only on the seed, the mesh and its name.
    """
    kinds = list(product(SIZES, LENGTHS, SMOOTHNESSES))
    found = []
    for index, (name, mesh) in product(range(count), meshes.items()):
        key = crc32(name.encode())
        # an odd step through all of them; the first ones are of either value
        size, length, smoothness = kinds[(3 * index + key) % len(kinds)]
        found.append(Trial(name, mesh, smoothness, length, size, (seed, key, index)))
    return found


def apart(first: PointMap, second: PointMap) -> float:
    """Return the mean distance, by area, of what two maps of a mesh make of its vertices, over
    sqrt(area).
    """
    mesh = first.domain
    distances = np.linalg.norm(first.positions - second.positions, axis=1)
    return float(np.average(distances, weights=vertex_areas(mesh)) / mesh.length_scale)


def posed(trial: Trial, folder: Path) -> Posed:
    """State a trial with defaults and with every sigma of `SIGMAS`; maps are held against the true
    one.
    """
    flow, f = trial.flow(), trial.texture()
    truth = flow.point_map()
    g = truth.pull_back(f) + trial.noise()
    described = {
        **trial.to_dict(),
        "error": apart(truth, PointMap.of_vertices(trial.mesh, trial.mesh)),
        "log2_area": flow.distortion().log2_area.mean,
    }
    wanted = {_DEFAULTS: None, **{f"{sigma:g}": sigma for sigma in SIGMAS}}
    matches = {
        name: problem_row(
            Problem(trial.mesh, f, g, Parameters(sigma=sigma)),
            folder,
            f"{trial.mesh_name}, sigma {name}",
        )
        for name, sigma in wanted.items()
    }

    def judge(entries: Mapping[str, Entry]) -> Row:
        found = {name: _of_entry(entry, truth) for name, entry in entries.items()}
        return {"problem": described, "fixed": found, _DEFAULTS: found.pop(_DEFAULTS)}

    return Posed(matches, judge)


def _of_entry(entry: Entry, truth: PointMap) -> Row:
    try:
        return {**_found(entry.load(), truth), "seconds": entry.record.seconds}
    except AbfmError as error:  # also of fields along which flow lines do not end
        return {"error": None, "verdict": str(error)}


def _found(match: Match, truth: PointMap) -> Row:
    step = match.path[match.step]
    return {
        "error": apart(truth, match.point_map()),
        "sigma": step.sigma,
        "alpha": step.alpha,
        "refined": match.refined,
        "residual": match.residual,
        "log2_area": match.distortion().log2_area.mean,
        "verdict": match.verdict.kind,
    }


def best(row: Row) -> tuple[str, float] | None:
    """Return the sigma with the least error, as text, and that error; None without any."""
    errors = {sigma: found["error"] for sigma, found in row["fixed"].items()}
    known = {sigma: error for sigma, error in errors.items() if error is not None}
    return min(known.items(), key=lambda each: each[1]) if known else None


def run_measured(
    meshes: Mapping[str, TriangleMesh],
    tell: Tell = lambda line: None,
    selection: Selection = ALL,
    place: Place | None = None,
) -> dict[str, Any]:
    """Match all problems; `tell` is told in one line what came out of each.

    Only numbers, text, lists and dictionaries come: ``rows``, ``interrupted``, ``settings`` and
    ``machine``, as `laboratory.success.run_success` has them.
    """
    place = place or Place()

    def pose(folder: Path) -> Iterator[Posed]:
        drawn = measured_problems(meshes, selection.seed, selection.count)
        for trial in drawn[selection.places]:
            try:
                yield posed(trial, folder)
            except AbfmError as error:  # of meshes on which there is no such flow
                tell(f"left out: {trial.mesh_name}: {error}")

    rows = by_batch(pose, lambda row: ", ".join(_cells(row)), tell, place)
    return selection.report(rows, place.control.cancelled, meshes, noise=NOISE)


_HEADER = (
    "mesh,flow,texture,error before,of defaults,of the best sigma,ratio,sigma,alpha,"
    "log2 J true,found,verdict,seconds"
)


def _cells(row: Row) -> list[str]:
    problem, found, least = row["problem"], row["defaults"], best(row)
    at_best = "none" if least is None else f"{least[1]:.4f} ({least[0]})"
    kind = [
        problem["mesh"],
        f"{problem['size']:g} at {problem['smoothness']:g}",
        f"{problem['length']:g}",
        f"{problem['error']:.4f}",
    ]
    true = f"{problem['log2_area']:.3f}"
    if found["error"] is None:
        return [*kind, "none", at_best, "none", "none", "none", true, "none", found["verdict"], "-"]
    ratio = _ratio(row)
    return [
        *kind,
        f"{found['error']:.4f}",
        at_best,
        "none" if ratio is None else f"{ratio:.2f}",
        f"{found['sigma']:.3g}",
        f"{found['alpha']:.2g}",
        true,
        f"{found['log2_area']:.3f}",
        found["verdict"],
        "-" if found["seconds"] is None else f"{found['seconds']:.1f}",
    ]


def _ratio(row: Row) -> float | None:
    least, found = best(row), row["defaults"]["error"]
    return None if least is None or found is None else found / least[1]


def format_measured(report: dict[str, Any]) -> str:
    """Return the report of `run_measured` as aligned lines of text."""
    rows, settings = report["rows"], report["settings"]
    ratios = [ratio for row in rows if (ratio := _ratio(row)) is not None]
    near = sum(ratio <= NEAR for ratio in ratios)
    middle = f"{median(ratios):.2f}" if ratios else "none"
    return "\n".join(
        [
            *aligned([_HEADER.split(","), *map(_cells, rows)]),
            "",
            f"Defaults at most {NEAR:g} times the error of the best sigma: {near} of {len(rows)}; "
            f"median ratio {middle}.",
            "Flow: root mean square of its speed for a time of 1, and the alpha of the norm it is "
            "random in. Texture: its correlation length. Error: mean distance from the true map, "
            f"all over sqrt(area). The target has {100 * settings['noise']:g}% noise. Best sigma: "
            f"of {', '.join(f'{sigma:g}' for sigma in SIGMAS)}. Sigma, alpha: of the match with "
            "defaults. log2 J: mean |log2 J| of the true map and of the found one.",
            f"{len(rows)} problems on {len(settings['meshes'])} meshes, seed {settings['seed']}. "
            f"{in_words(report['machine'])}.",
        ]
    )
