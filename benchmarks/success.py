"""Success rate of the default parameters on random problems on many meshes.

Run it with ``python -m benchmarks.success`` and the options of ``abfm bench --success``.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from math import inf, isfinite
from pathlib import Path
from statistics import median
from typing import Any, Literal, get_args
from zlib import crc32

import numpy as np

from abfm import AbfmError, Parameters, Problem, TriangleMesh, function
from abfm.batch import LedgerEntry, problem_row
from abfm.calculus import geodesic_distance
from abfm.maps import SymmetryError, detect_symmetry
from abfm.matching.solvability import RESOLUTION_MIN, first_difference, range_bound, resolution
from abfm.types import FloatArray
from benchmarks.common import Report, bench, decimals, machine_line, markdown
from benchmarks.trials import MeasuredProblem, Trials, measured

GOAL = Parameters.goal
"""Largest residual of a success, by the discrete flow and along flow lines."""
RESIDUAL_CONFIRMED = 0.1
"""Largest residual along flow lines of a match that counts as confirmed."""
FOLDED_MAX = 0.01
"""Largest share of folded faces of a match that counts as unfolded."""

Family = Literal["gaussian", "one to two", "disc", "eigenfunction", "descriptor"]
FAMILIES: tuple[Family, ...] = get_args(Family)
"""Families of source and target.

- gaussian: a Gaussian and another of the same width
- one to two: a Gaussian and two others, narrower by the root of two, so that the area above each
  level is the same
- disc: the indicators of two geodesic discs; the radius is twice the width, where a Gaussian has
  the value 0.14
- eigenfunction: an eigenfunction of the Laplacian and the next one
- descriptor: the distance to a landmark and its mirror image, if the surface has a mirror symmetry
"""
WIDTHS = (0.05, 0.1, 0.15)
"""Widths of the source, as fractions of sqrt(area)."""
DISTANCES = {"quarter": (0.2, 0.3), "half": (0.45, 0.55), "far": (0.9, 1.0)}
"""Distances of source and target, as fractions of the largest geodesic distance."""
GROUPS = (
    ("resolved",),
    ("distance",),
    ("width",),
    ("family",),
    ("solvable",),
    ("solvable", "resolved"),
    ("solvable", "family"),
    ("solvable", "family", "distance"),
    ("folder",),
    ("folder", "solvable"),
    ("folder", "solvable", "family"),
    ("folder", "solvable", "family", "distance"),
)
"""Groups of the report: it has a row for each combination of the values of these properties."""

_FAMILY_SEQUENCE: tuple[Family, ...] = (
    *("gaussian", "one to two", "disc", "gaussian", "eigenfunction"),
    *("gaussian", "one to two", "descriptor", "gaussian", "disc"),
)
_EIGENFUNCTION_MAX = 8
_TARGET_DISTANCES = (0.5, 1.0)  # of the two targets, relative to the largest possible distance
_MIRROR_DISTANCE_MIN = 0.2  # of a landmark from its image, as a fraction of sqrt(area)


@dataclass(frozen=True, eq=False)
class Trial:
    """A random problem: a mesh, and the source and target functions as text."""

    mesh_name: str
    index: int
    mesh: TriangleMesh
    family: Family
    source: str
    target: str
    width: float | None = None
    distance: str | None = None

    def functions(self) -> tuple[FloatArray, FloatArray]:
        return function(self.mesh, self.source), function(self.mesh, self.target)

    def to_dict(self) -> Report:
        """Return the description of the problem for the report.

        It states whether the mesh resolves the functions. The problem counts as solvable unless the
        values and peaks of its functions show that it is not.
        """
        f, g = self.functions()
        edges = resolution(self.mesh, np.stack([f, g], axis=1))
        term = Problem(self.mesh, f, g).functions
        residual_bound = range_bound(term)
        names = ("index", "family", "width", "distance", "source", "target")
        return {
            "mesh": self.mesh_name,
            "folder": self.mesh_name.rpartition("/")[0],
            "vertices": len(self.mesh.vertices),
            **{key: getattr(self, key) for key in names},
            "edges_per_width": edges,
            "resolved": edges >= RESOLUTION_MIN,
            "residual_bound": residual_bound,
            "solvable": residual_bound <= GOAL and first_difference(term) is None,
        }


def success_problems(
    meshes: Mapping[str, TriangleMesh], seed: int = 0, count: int = 10
) -> Iterator[Trial]:
    """Yield ``count`` problems on each mesh: first problem 0 of all meshes, then problem 1, ...

    Problem k of a mesh depends only on the seed, the mesh and its name. Families alternate, each
    mesh starts with another family, and places are random. Meshes without mirror symmetry have no
    descriptor problem.
    """
    for index in range(count):
        for name, mesh in meshes.items():
            problem = _problem(name, mesh, index, seed)
            if problem is not None:
                yield problem


def _problem(name: str, mesh: TriangleMesh, index: int, seed: int) -> Trial | None:
    key = crc32(name.encode())
    rng = np.random.default_rng([seed, key, index])
    turn = index + key % len(_FAMILY_SEQUENCE)
    family = _FAMILY_SEQUENCE[turn % len(_FAMILY_SEQUENCE)]
    if family == "eigenfunction":
        k = int(rng.integers(1, _EIGENFUNCTION_MAX + 1))
        return Trial(name, index, mesh, family, f"eigenfunction:{k}", f"eigenfunction:{k + 1}")
    if family == "descriptor":
        landmark = _landmark(mesh, rng)
        if landmark is None:
            return None
        source = f"geodesic:vertex={landmark}"
        return Trial(name, index, mesh, family, source, f"permuted:mirror({source})")
    distance = tuple(DISTANCES)[turn % len(DISTANCES)]
    # nine consecutive problems have all pairs of width and distance
    width = WIDTHS[(turn + turn // len(DISTANCES)) % len(WIDTHS)]
    here, there, other = (int(mesh.vertex_ids[v]) for v in _places(mesh, rng, DISTANCES[distance]))

    def gaussian(vertex: int, width: float) -> str:
        return f"gaussian:vertex={vertex},width={width:g}"

    source, target = gaussian(here, width), gaussian(there, width)
    if family == "one to two":
        narrow = round(width / np.sqrt(2), 4)
        target = f"{gaussian(there, narrow)} + {gaussian(other, narrow)}"
    elif family == "disc":
        source, target = (f"indicator:vertex={v},radius={2 * width:g}" for v in (here, there))
    return Trial(name, index, mesh, family, source, target, width, distance)


def _places(
    mesh: TriangleMesh, rng: np.random.Generator, distance: tuple[float, float]
) -> tuple[int, int, int]:
    """Return a random vertex, and two others whose distances from it are in a range.

    The two others are also distant from each other.
    """
    here = int(rng.integers(len(mesh.vertices)))
    distances = geodesic_distance(mesh, [here])
    there = _choice(rng, distances, distance)
    low, high = distance
    fractions = distances / distances.max()
    ring = (fractions >= low) & (fractions <= high)
    between = np.where(ring, geodesic_distance(mesh, [there]), 0.0)
    return here, there, _choice(rng, between, _TARGET_DISTANCES)


def _choice(rng: np.random.Generator, distances: FloatArray, within: tuple[float, float]) -> int:
    """Return a random vertex whose distance is in a range, relative to the largest distance.

    If there is none, return the vertex whose distance is closest to the middle of the range.
    """
    fractions = distances / (distances.max() or 1.0)
    low, high = within
    fitting = np.flatnonzero((fractions >= low) & (fractions <= high))
    if len(fitting):
        return int(rng.choice(fitting))
    return int(np.abs(fractions - (low + high) / 2).argmin())


def _landmark(mesh: TriangleMesh, rng: np.random.Generator) -> int | None:
    """Return the file's number of a vertex far from its mirror image, or None."""
    try:
        mirror = detect_symmetry(mesh, "mirror")
    except SymmetryError:
        return None
    offsets = mesh.vertices - mesh.vertices[mirror.vertex_map]
    is_off = np.linalg.norm(offsets, axis=1) > _MIRROR_DISTANCE_MIN * mesh.length_scale
    fitting = np.flatnonzero(is_off)
    return int(mesh.vertex_ids[rng.choice(fitting)]) if len(fitting) else None


def record_of(entry: LedgerEntry) -> Report:
    """Verify a matched row again, and return its measurements.

    - ``residual``, ``verified``: the residuals by the discrete flow and along flow lines; None if
      unknown
    - ``folded``: the share of folded faces
    - ``row_products``: products of rows of ``D_v`` in all advections and adjoints
    - ``seconds``: the time of the match on a new mesh and of writing the result
    - ``refined``, ``stop_reason``, ``verdict``: as in `abfm.Match`, or the message of an error
    - ``success``: both residuals are at most `GOAL`
    - ``confirmed``: ``verified`` is at most `RESIDUAL_CONFIRMED`
    """
    cost = entry.record
    record: Report = {
        "residual": None,
        "verified": None,
        "folded": None,
        "iterations": 0,
        "evaluations": cost.evaluations or 0,
        "row_products": cost.row_products or 0,
        "seconds": cost.seconds,
        "refined": 0,
        "stop_reason": entry.reason,
        "verdict": "",
    }
    if entry.path is not None:
        try:
            found = entry.load()
            record |= {
                "residual": found.residual,
                "iterations": len(found.energy_history) - 1,
                "refined": found.refined,
                "stop_reason": found.stop_reason,
                "verdict": found.verdict.kind,
            }
            with suppress(AbfmError):  # for fields whose flow lines do not end
                lines = found.verify(subdivided=False)
                record |= {"verified": lines.residual, "folded": lines.folded}
        except AbfmError as error:
            record["stop_reason"] = str(error)
    for key in ("residual", "verified", "folded", "seconds"):
        record[key] = record[key] if isfinite(_or_inf(record[key])) else None
    verified = _or_inf(record["verified"])
    success = max(_or_inf(record["residual"]), verified) <= GOAL
    return record | {"success": success, "confirmed": verified <= RESIDUAL_CONFIRMED}


def _or_inf(value: float | None) -> float:
    return inf if value is None else value


def run(trials: Trials, only_solvable: bool = False, **parameters: Any) -> Report:
    """Match random problems with the default or given parameters, and verify the results.

    Each of the report's ``rows`` has the ``problem`` and its ``result``.
    """
    used = Parameters.of(**parameters)

    def create(folder: Path) -> Iterator[MeasuredProblem]:
        for trial in success_problems(trials.meshes, trials.seed, trials.count):
            try:
                described = trial.to_dict()
                if described["solvable"] or not only_solvable:
                    problem = Problem(trial.mesh, trial.source, trial.target, used)
                    row = problem_row(problem, folder, trial.mesh_name)
                    yield MeasuredProblem({"result": row}, _measure(described))
            except AbfmError as error:  # for meshes on which a function is undefined
                trials.log(f"skipped: {trial.mesh_name}: {error}")

    rows = measured(trials, create, _line)
    return trials.report(rows, solvable=only_solvable, level=GOAL, parameters=used.to_dict())


def _measure(described: Report) -> Any:
    return lambda entries: {"problem": described, "result": record_of(entries["result"])}


def _line(row: Report) -> str:
    problem, result = row["problem"], row["result"]
    kind = [problem["mesh"], problem["family"]]
    kind += [f"{problem['width']:g}", problem["distance"]] if problem["width"] else []
    residuals = f"{decimals(result['residual'], '.2g')} ({decimals(result['verified'], '.2g')})"
    return f"{', '.join(kind)}: {residuals} {decimals(result['seconds'], '.1f')} s"


def _count(key: str) -> Callable[[list[Report]], str]:
    return lambda results: f"{sum(bool(each[key]) for each in results)} of {len(results)}"


def _median(key: str) -> Callable[[list[Report]], str]:
    """Return a function that returns the median of results; missing ones are infinite."""

    def cell(results: list[Report]) -> str:
        values = [_or_inf(result[key]) for result in results]
        return decimals(median(values) if values else None, ".2g")

    return cell


def _unfolded(results: list[Report]) -> str:
    count = sum(_or_inf(result["folded"]) <= FOLDED_MAX for result in results)
    return f"{100 * count / max(len(results), 1):.0f}%"


COLUMNS = {
    f"both at most {GOAL:g}": _count("success"),
    f"flow lines at most {RESIDUAL_CONFIRMED:g}": _count("confirmed"),
    "residual": _median("residual"),
    "along flow lines": _median("verified"),
    "unfolded": _unfolded,
    "refined": _count("refined"),
    "products": _median("row_products"),
    "seconds": _median("seconds"),
}


def report_text(report: Report) -> str:
    rows, settings = report["rows"], report["settings"]
    cells = [
        [name, *(cell([row["result"] for row in group]) for cell in COLUMNS.values())]
        for name, group in _groups(rows).items()
    ]
    seconds = sum(row["result"]["seconds"] or 0 for row in rows)
    notes = (
        f"A success has a residual of at most {GOAL:g} by the discrete flow and along flow lines. "
        "Solvable: the source has the target's values and peaks, also on boundaries and on parts "
        "joined only at vertices. Residuals, products (of rows of D_v) and seconds are medians. "
        f"Unfolded: matches with at most {100 * FOLDED_MAX:g}% folded faces. Refined: "
        "matched on a subdivided mesh.",
        f"{len(rows)} problems on {len(settings['meshes'])} meshes, seed {settings['seed']}; "
        f"{seconds:.0f} s in total. {machine_line(report['machine'])}.",
    )
    return "\n\n".join([markdown(["problems", *COLUMNS], cells), *notes])


def _groups(rows: list[Report]) -> dict[str, list[Report]]:
    """Group results by the values of each property in `GROUPS`; ignore false and empty values."""
    groups = {"all": rows}
    for keys in GROUPS:
        for row in rows:
            values = {key: row["problem"][key] for key in keys}
            if all(values.values()):
                words = (key if value is True else str(value) for key, value in values.items())
                groups.setdefault(", ".join(words), []).append(row)
    return groups


if __name__ == "__main__":
    bench("--success")
