"""How often matches succeed: random problems by several versions, side by side."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any, Literal, get_args
from zlib import crc32

import numpy as np

from abfm import (
    AbfmError,
    ParameterError,
    Parameters,
    Problem,
    TriangleMesh,
    function,
)
from abfm.batch import Entry, problem_row
from abfm.calculus import geodesic_distance
from abfm.maps import SymmetryError, detect_symmetry
from abfm.matching.solvability import RESOLVED, range_bound, resolution, unmatched
from abfm.types import FloatArray
from laboratory.common import LEVEL, aligned, in_words, machine, markdown
from laboratory.trials import Place, Posed, Row, Tell, by_batch

BEFORE = Parameters.of(
    reach=0.0,
    order=1,
    levels=1,
    sigma=1e-3,
    sigma_unit="absolute",
    alpha=0.02,
    iterations=150,
    cooling_stages=3,
    cooling_factor=10.0,
)
"""The paper's energy on the mesh alone, in three stages of sigma: the solver as it was before it
had a reach.
"""
VERSIONS = {"before": BEFORE, "now": Parameters()}
"""What is compared."""
CONFIRMED = 0.1
"""Largest residual by flow lines that says that a field carries about what it is said to carry."""
UNFOLDED = 0.01
"""Largest share of folded faces of a flow that folds none but for its discretisation."""

Family = Literal["gaussian", "one to two", "disc", "eigenfunction", "descriptor"]
FAMILIES: tuple[Family, ...] = get_args(Family)
"""What is matched, by name.

- gaussian: one to another of the same width
- one to two: one to two others, narrower by the root of two, so that what lies above a level keeps
  its area
- disc: the indicator of a geodesic disc to another; the radius is twice the width, where a Gaussian
  has fallen to 0.14
- eigenfunction: of the Laplacian, to the next one
- descriptor: the distance to a landmark and its mirror image, where the surface has a mirror
"""
WIDTHS = (0.05, 0.1, 0.15)
"""Of the source, as fractions of sqrt(area)."""
DISTANCES = {"quarter": (0.2, 0.3), "half": (0.45, 0.55), "far": (0.9, 1.0)}
"""From the source's centre to the target's, as fractions of the largest geodesic distance from
there.
"""

_TURN: tuple[Family, ...] = (
    *("gaussian", "one to two", "disc", "gaussian", "eigenfunction"),
    *("gaussian", "one to two", "descriptor", "gaussian", "disc"),
)
_HIGHEST = 8  # of the eigenfunctions matched
# of the most possible: how far the two targets of one source are from each other
_APART = (0.5, 1.0)
_OFF_MIRROR = 0.2  # of sqrt(area): how far a landmark is from its image
_ARROW = " → "


@dataclass(frozen=True, eq=False)
class Trial:
    """A source and a target on a mesh as text; families without width or distance have None."""

    mesh_name: str
    index: int
    mesh: TriangleMesh
    family: Family
    source: str
    target: str
    width: float | None = None
    distance: str | None = None

    def functions(self) -> tuple[FloatArray, FloatArray]:
        """Return source and target, (V,)."""
        return function(self.mesh, self.source), function(self.mesh, self.target)

    def to_dict(self) -> dict[str, Any]:
        """Return all that tells it from others, whether the mesh resolves it, and what is known to
        be in any flow's way.
        """
        f, g = self.functions()
        edges = resolution(self.mesh, np.stack([f, g], axis=1))
        term = Problem(self.mesh, f, g).functions
        least = range_bound(term)
        names = ("index", "family", "width", "distance", "source", "target")
        return {
            "mesh": self.mesh_name,
            "folder": self.mesh_name.rpartition("/")[0],
            "vertices": len(self.mesh.vertices),
            **{key: getattr(self, key) for key in names},
            "edges_per_width": edges,
            "resolved": edges >= RESOLVED,
            "least": least,
            "solvable": least <= LEVEL and unmatched(term) is None,
        }


def success_problems(
    meshes: Mapping[str, TriangleMesh], seed: int = 0, count: int = 10
) -> Iterator[Trial]:
    """Return the first ``count`` problems of every mesh, the first ones of all meshes first.

    Problem k of a mesh depends only on the seed, the mesh and its name: kinds take turns, each mesh
    beginning with another one, and places are random. A descriptor is left out where the mesh has
    no mirror.
    """
    for index in range(count):
        for name, mesh in meshes.items():
            problem = _problem(name, mesh, index, seed)
            if problem is not None:
                yield problem


def _problem(name: str, mesh: TriangleMesh, index: int, seed: int) -> Trial | None:
    key = crc32(name.encode())
    rng = np.random.default_rng([seed, key, index])
    turn = index + key % len(_TURN)
    family = _TURN[turn % len(_TURN)]
    if family == "eigenfunction":
        k = int(rng.integers(1, _HIGHEST + 1))
        return Trial(name, index, mesh, family, f"eigenfunction:{k}", f"eigenfunction:{k + 1}")
    if family == "descriptor":
        landmark = _landmark(mesh, rng)
        if landmark is None:
            return None
        source = f"geodesic:vertex={landmark}"
        return Trial(name, index, mesh, family, source, f"permuted:mirror({source})")
    distance = tuple(DISTANCES)[turn % len(DISTANCES)]
    width = WIDTHS[(turn + turn // len(DISTANCES)) % len(WIDTHS)]  # nine in a row are all pairs
    here, there, beside = (int(mesh.vertex_ids[v]) for v in _places(mesh, rng, DISTANCES[distance]))

    def gaussian(vertex: int, width: float) -> str:
        return f"gaussian:vertex={vertex},width={width:g}"

    source, target = gaussian(here, width), gaussian(there, width)
    if family == "one to two":
        narrow = round(width / np.sqrt(2), 4)
        target = f"{gaussian(there, narrow)} + {gaussian(beside, narrow)}"
    elif family == "disc":
        source, target = (f"indicator:vertex={v},radius={2 * width:g}" for v in (here, there))
    return Trial(name, index, mesh, family, source, target, width, distance)


def _places(
    mesh: TriangleMesh, rng: np.random.Generator, between: tuple[float, float]
) -> tuple[int, int, int]:
    """Return a random vertex, one as far as asked for, and another, not near the second."""
    here = int(rng.integers(len(mesh.vertices)))
    distances = geodesic_distance(mesh, [here])
    there = _choice(rng, distances, between)
    low, high = between
    fractions = distances / distances.max()
    ring = (fractions >= low) & (fractions <= high)
    apart = np.where(ring, geodesic_distance(mesh, [there]), 0.0)
    return here, there, _choice(rng, apart, _APART)


def _choice(rng: np.random.Generator, distances: FloatArray, between: tuple[float, float]) -> int:
    """Return a vertex in this range of fractions of the largest distance, or the nearest to it."""
    fractions = distances / (distances.max() or 1.0)
    low, high = between
    fitting = np.flatnonzero((fractions >= low) & (fractions <= high))
    if len(fitting):
        return int(rng.choice(fitting))
    return int(np.abs(fractions - (low + high) / 2).argmin())


def _landmark(mesh: TriangleMesh, rng: np.random.Generator) -> int | None:
    """Return a vertex as in the file, not near its mirror image; None without a mirror."""
    try:
        mirror = detect_symmetry(mesh, "mirror")
    except SymmetryError:
        return None
    offsets = mesh.vertices - mesh.vertices[mirror.vertex_map]
    apart = np.flatnonzero(np.linalg.norm(offsets, axis=1) > _OFF_MIRROR * mesh.length_scale)
    return int(mesh.vertex_ids[rng.choice(apart)]) if len(apart) else None


@dataclass(frozen=True)
class Record:
    """One problem by one version of the solver, in numbers; NaN is what could not be had."""

    residual: float = math.nan
    # residual by flow lines of the continuous field, and shares of the faces, see `abfm.verify`
    verified: float = math.nan
    folded: float = math.nan
    overturned: float = math.nan
    # up to the last iterate, on all meshes together
    iterations: int = 0
    evaluations: int = 0
    # of ``D_v``, by advections and adjoints; factorisations and flow lines come on top
    row_products: int = 0
    # of a process that matched nothing else meanwhile, on a mesh of which nothing was known, until
    # the result was written; without the verification here
    seconds: float = math.nan
    seconds_to_level: float = math.nan
    refined: int = 0  # how often the mesh was subdivided, as of `abfm.Match`
    stop_reason: str = ""  # as `abfm.Match.stop_reason`, or the error
    verdict: str = ""  # kind of `abfm.Match.verdict`; empty where there was an error

    def to_dict(self) -> dict[str, Any]:
        """Return all fields, None for what is not a finite number, and whether it arrived, by the
        discrete flow, is a success, by both witnesses, and confirmed, by the weaker word of flow
        lines alone.
        """
        numbers = {
            key: None if isinstance(value, float) and not math.isfinite(value) else value
            for key, value in asdict(self).items()
        }
        arrived = self.residual <= LEVEL
        success = arrived and self.verified <= LEVEL
        confirmed = self.verified <= CONFIRMED
        return {**numbers, "arrived": arrived, "success": success, "confirmed": confirmed}


def record_of(entry: Entry) -> Record:
    """Return what came of a problem's row, and verify it."""
    cost = entry.record
    spent = Record(
        evaluations=cost.evaluations or 0,
        row_products=cost.row_products or 0,
        seconds=_known(cost.seconds),
        seconds_to_level=_known(cost.seconds_to_goal),
        stop_reason=entry.reason,
    )
    if entry.path is None:
        return spent
    try:
        found = entry.load()
    except AbfmError as error:
        return replace(spent, stop_reason=str(error))
    record = replace(
        spent,
        residual=found.residual,
        iterations=len(found.energy_history) - 1,
        refined=found.refined,
        stop_reason=found.stop_reason,
        verdict=found.verdict.kind,
    )
    with suppress(AbfmError):  # of fields along which flow lines do not end
        said = found.verify(subdivided=False)
        folded, overturned = said.folded, said.overturned
        return replace(record, verified=said.residual, folded=folded, overturned=overturned)
    return record


def _known(number: float | None) -> float:
    return math.nan if number is None else number


@dataclass(frozen=True)
class Selection:
    """Which problems: `seed` and `count` on each mesh, and of ``part = (k, n)`` only every n-th,
    from the k-th, which is 1 for the first; or those alone that are known to be solvable.
    """

    seed: int = 0
    count: int = 6
    part: tuple[int, int] = (1, 1)
    solvable: bool = False

    @property
    def places(self) -> slice:
        """Places of its part in a list of all problems."""
        return slice(self.part[0] - 1, None, self.part[1])

    def report(
        self,
        rows: list[Row],
        interrupted: bool,
        meshes: Mapping[str, TriangleMesh],
        **settings: Any,
    ) -> dict[str, Any]:
        """Return what came out, with all that tells the problems and the machine."""
        sizes = {name: len(mesh.vertices) for name, mesh in meshes.items()}
        of_all = {"seed": self.seed, "count": self.count, "solvable": self.solvable}
        return {
            "rows": rows,
            "interrupted": interrupted,
            "settings": {**of_all, "meshes": sizes, **settings},
            "machine": machine(),
        }


def run_success(
    meshes: Mapping[str, TriangleMesh],
    tell: Tell = lambda line: None,
    selection: Selection = Selection(),
    versions: Mapping[str, Parameters] = VERSIONS,
    place: Place | None = None,
) -> dict[str, Any]:
    """Match all problems by all versions, the first of which the others are compared with; `tell`
    is told in one line what came out of each.

    Only numbers, text, lists and dictionaries come: ``rows``, with the ``problem`` and a record
    under the name of every version, then ``settings`` and ``machine``. If it was cancelled,
    ``interrupted`` is true and rows are those that were finished.
    """
    place = place or Place()

    def pose(folder: Path) -> Iterator[Posed]:
        drawn = success_problems(meshes, selection.seed, selection.count)
        for trial in [*drawn][selection.places]:
            try:
                described = trial.to_dict()
                if selection.solvable and not described["solvable"]:
                    continue
                yield _posed(trial, described, versions, folder)
            except AbfmError as error:  # of meshes on which its functions are none
                tell(f"left out: {trial.mesh_name}: {error}")

    rows = by_batch(pose, lambda row: _line(row, versions), tell, place)
    of_versions = {name: parameters.to_dict() for name, parameters in versions.items()}
    stopped = place.control.cancelled
    return selection.report(rows, stopped, meshes, level=LEVEL, versions=of_versions)


def _posed(trial: Trial, described: Row, versions: Mapping[str, Parameters], folder: Path) -> Posed:
    """State a problem for each version."""
    stated = Problem(trial.mesh, trial.source, trial.target)
    matches = {
        name: problem_row(stated.with_parameters(each), folder, f"{trial.mesh_name} {name}")
        for name, each in versions.items()
    }

    def judge(entries: Mapping[str, Entry]) -> Row:
        records = {name: record_of(entry).to_dict() for name, entry in entries.items()}
        return {"problem": described, **records}

    return Posed(matches, judge)


def _line(row: Row, versions: Mapping[str, Parameters]) -> str:
    def digits(value: float | None, form: str = ".2g") -> str:
        return "none" if value is None else f"{value:{form}}"

    problem = row["problem"]
    kind = [problem["mesh"], problem["family"]]
    kind += [f"{problem['width']:g}", problem["distance"]] if problem["width"] else []
    results = [
        f"{name} {digits(row[name]['residual'])} ({digits(row[name]['verified'])}) "
        f"{digits(row[name]['seconds'], '.1f')} s"
        for name in versions
    ]
    return f"{', '.join(kind)}: {'; '.join(results)}"


def merged(reports: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return one report of several reports of `run_success`: of other parts, or other meshes.

    ParameterError if there is none, or they are of different versions or seeds.
    """
    if not reports:
        raise ParameterError("no reports to put together; give at least one")
    first = reports[0]
    meshes: dict[str, int] = {}
    for report in reports:
        for key in ("versions", "seed", "level"):
            if report["settings"][key] != first["settings"][key]:
                raise ParameterError(f"reports of different {key} cannot be put together")
        meshes |= report["settings"]["meshes"]
    return {
        "rows": [row for report in reports for row in report["rows"]],
        "interrupted": any(report["interrupted"] for report in reports),
        "settings": {**first["settings"], "meshes": meshes},
        "machine": first["machine"],
    }


def format_success(report: dict[str, Any]) -> str:
    """Return the report of `run_success` as aligned lines of text."""
    return "\n".join([*aligned(_table(report)), "", *_context(report)])


def success_table(report: dict[str, Any]) -> str:
    """Return the report of `run_success` as a table in Markdown."""
    return "\n".join([*markdown(_table(report)), "", "\n\n".join(_context(report))])


def _table(report: dict[str, Any]) -> list[list[str]]:
    """Return a header, and a row for every group of problems that has any."""
    rows, versions = report["rows"], list(report["settings"]["versions"])
    header = (
        f"problems,both at most {LEVEL:g},flow lines at most {CONFIRMED:g},residual,by flow lines,"
        "unfolded,refined,products,seconds,seconds where refined,seconds where not"
    )
    far: dict[str, Row] = {
        f"solvable, {name}": {"solvable": True, "distance": name} for name in DISTANCES
    }
    gaussian: Row = {"family": "gaussian"}
    bumps = {f"gaussian, {name}": {**wanted, **gaussian} for name, wanted in far.items()}
    groups: dict[str, Row] = {
        "resolved": {"resolved": True},
        **{f"distance {distance}": {"distance": distance} for distance in DISTANCES},
        **{f"width {width:g}": {"width": width} for width in WIDTHS},
        **{family: {"family": family} for family in FAMILIES},
        "solvable": {"solvable": True},
        "solvable, resolved": {"solvable": True, "resolved": True},
        **far,
        **bumps,
    }
    for folder in dict.fromkeys(row["problem"]["folder"] for row in rows):
        if folder:
            own: dict[str, Row] = {"": {}, ", solvable": {"solvable": True}}
            own |= {f", {name}": wanted for name, wanted in (far | bumps).items()}
            groups |= {folder + end: {**wanted, "folder": folder} for end, wanted in own.items()}
    table = [header.split(","), _cells("all", rows, versions)]
    for name, wanted in groups.items():
        group = [row for row in rows if wanted.items() <= row["problem"].items()]
        if group:
            table.append(_cells(name, group, versions))
    return table


def _cells(name: str, group: list[Row], versions: list[str]) -> list[str]:
    first, last = versions[0], versions[-1]

    def count(key: str) -> str:
        counts = [str(sum(bool(row[version][key]) for row in group)) for version in versions]
        return f"{_ARROW.join(counts)} of {len(group)}"

    def each(words: Callable[[list[float]], str], key: str) -> str:
        """Say something of each version's values, where what could not be had is infinite."""
        found = [[row[version][key] for row in group] for version in versions]
        known = [[math.inf if value is None else value for value in values] for values in found]
        return _ARROW.join(words(values) if values else "none" for values in known)

    def middle(values: list[float]) -> str:
        value = median(values) if values else math.inf
        return f"{value:.2g}" if math.isfinite(value) else "none"

    def unfolded(values: list[float]) -> str:
        return f"{100 * sum(value <= UNFOLDED for value in values) / len(values):.0f}%"

    def cost(key: str, among: list[Row] = group) -> str:
        """Say what the first version costs over the last, at the median, where both arrive; what
        one alone costs.
        """
        if first == last:
            return middle([row[last][key] for row in among if row[last][key] is not None])
        pairs = [(row[first], row[last]) for row in among]
        arrived = [(a[key], b[key]) for a, b in pairs if a["arrived"] and b["arrived"]]
        both = [cost / other for cost, other in arrived if cost and other]
        return middle(both)

    return [
        name,
        count("success"),
        count("confirmed"),
        each(middle, "residual"),
        each(middle, "verified"),
        each(unfolded, "folded"),
        count("refined"),
        cost("row_products"),
        cost("seconds"),
        cost("seconds", [row for row in group if row[last]["refined"]]),
        cost("seconds", [row for row in group if not row[last]["refined"]]),
    ]


def _context(report: dict[str, Any]) -> list[str]:
    """Say what the columns mean, and where this was measured."""
    settings, rows = report["settings"], report["rows"]
    versions = list(settings["versions"])
    sums = [f"{sum(row[version]['seconds'] or 0 for row in rows):.0f} s" for version in versions]
    first, last = versions[0], versions[-1]
    costs = "Products (of rows of D_v), seconds: "
    if first == last:
        costs += "medians"
    else:
        costs += f"what {first} costs over what {last} costs, median over problems in which both "
        costs += f"leave at most {LEVEL:g} by the discrete flow"
    return [
        f"{_ARROW.join(versions)}. Both: the discrete flow and flow lines each leave a residual of "
        f"at most {LEVEL:g}, which is a success. Flow lines at most {CONFIRMED:g}: what was called "
        "confirmed before, whatever the discrete flow leaves. Solvable: the source has the "
        "target's values and peaks, also on boundaries and on parts joined at vertices alone. "
        "Mismatches are medians. Unfolded: share of matches that fold at most "
        f"{100 * UNFOLDED:g}% of the faces. Refined: on a subdivision. "
        f"{costs}, also of the problems that {last} refined and of the others.",
        f"{len(rows)} problems on {len(settings['meshes'])} meshes, seed {settings['seed']}; "
        f"{_ARROW.join(sums)} in all. {in_words(report['machine'])}.",
    ]
