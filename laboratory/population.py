"""A population made from a template by known flows, and what comes back of it.

    python -m laboratory.population [--folder DIR] [--jobs N] [--write docs/population.md]
        [--picture docs/images/population.png]

Subjects are made on the sphere of nilearn's fsaverage5, on the 2,562 vertices of the icosphere
that its 10,242 were subdivided from: its sulcal depth, carried along known fields whose mean is
zero, and noise. One subject is odd: the depth of the other hemisphere's mesh. Registrations are
kept in the folder, so that it goes on where it was stopped.
"""

from __future__ import annotations

import argparse
import math
import resource
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from time import process_time
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.spatial import ConvexHull

from abfm import (
    Flow,
    Population,
    TriangleMesh,
    function,
    load_mesh,
    load_registration,
    register,
    register_population,
)
from abfm.batch import Cluster, Entry, Ledger, Row
from abfm.batch.attempt import Task, attempt
from abfm.calculus.operators import face_areas, gradient, vertex_areas
from abfm.functions import quoted
from abfm.io import write_surface
from abfm.io.sheets import Panel, Sheet, Values
from abfm.population import Channel, Cohort, Settings, Subject
from abfm.population.work import Work
from abfm.types import FloatArray
from abfm_viewer.files.outputs import write_picture
from abfm_viewer.pictures import figure_picture
from laboratory.common import in_words, machine, put_between, told_table

MARKS = ("<!-- tables of laboratory.population -->", "<!-- end of the tables -->")
_SUBJECTS, _NOISE = 20, 0.1
_COARSE = 2562  # vertices of the icosphere that fsaverage5's was subdivided from
_SMOOTHED = 4  # times by half with the neighbours' mean, so that the coarse mesh resolves the depth
_SIZE = 0.05  # of sqrt(area): root of the mean square of the known fields
_WAVES, _FASTEST = 12, 4.0  # in each known field, and the largest wave number on the unit sphere
_LEAST_SLOPE = 0.5  # of the median gradient: where it is less, the function tells no direction
_PLANNED, _ROUNDS, _WORKERS = 200, 3, (1, 16, 256)
_MB, _WIDE = 1e6, 1150  # pixels


class Made(NamedTuple):
    """A template, its function, and subjects made of it by known fields (N, F, 3)."""

    mesh: TriangleMesh
    function: FloatArray
    fields: FloatArray
    subjects: tuple[FloatArray, ...]
    odd: FloatArray


def depth_of(side: str, coarse: bool = True) -> tuple[TriangleMesh, FloatArray]:
    """Return a sphere of fsaverage5, and its sulcal depth less its mean over its deviation."""
    spec = find_spec("nilearn")
    if spec is None or spec.origin is None:
        raise SystemExit('fsaverage5 comes with nilearn: pip install "abfm[brain]"')
    folder = Path(spec.origin).parent / "datasets" / "data" / "fsaverage5"
    mesh = load_mesh(folder / f"sphere_{side}.gii.gz")
    depth = function(mesh, f"file:{folder / f'sulc_{side}.gii.gz'}")
    if coarse:
        places = mesh.vertices[:_COARSE]
        faces = ConvexHull(places).simplices
        corners = places[faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        inward = np.einsum("fx,fx->f", normals, corners.mean(axis=1)) < 0
        faces[inward] = faces[inward][:, ::-1]
        mesh, depth = TriangleMesh(places, faces), depth[:_COARSE]
    depth = smoothed(mesh, depth, _SMOOTHED)
    areas = vertex_areas(mesh)
    depth = depth - np.average(depth, weights=areas)
    return mesh, np.asarray(depth / math.sqrt(np.average(depth**2, weights=areas)))


def smoothed(mesh: TriangleMesh, values: FloatArray, times: int) -> FloatArray:
    """Return values (V,) that came half the way to the mean of their neighbours, so many times."""
    i, j = mesh.edges.T
    size = len(mesh.vertices)
    adjacent = sparse.csr_array((np.ones(2 * len(i)), (np.r_[i, j], np.r_[j, i])), (size, size))
    means = sparse.diags_array(1 / adjacent.sum(axis=1)) @ adjacent
    for _ in range(times):
        values = 0.5 * (values + means @ values)
    return values


def known_fields(mesh: TriangleMesh, count: int, size: float, seed: int = 0) -> FloatArray:
    """Return smooth random fields (N, F, 3) on a sphere about 0, whose mean is zero: waves along
    random directions, half of them gradients and half of them turned by a right angle; the root of
    the mean square is ``size`` of sqrt(area).
    """
    rng = np.random.default_rng(seed)
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    middles /= np.linalg.norm(middles, axis=1)[:, None]
    found = np.zeros((count, len(middles), 3))
    for field in found:
        for turned in range(2 * _WAVES):
            along = rng.normal(size=3)
            along /= np.linalg.norm(along)
            number, phase = rng.uniform(1, _FASTEST), rng.uniform(0, 2 * np.pi)
            waves = rng.normal() * np.cos(number * (middles @ along) + phase)[:, None] * along
            waves -= (waves * middles).sum(axis=1)[:, None] * middles
            field += np.cross(middles, waves) if turned % 2 else waves
    found -= found.mean(axis=0)
    squares = (found**2).sum(axis=2) @ face_areas(mesh) / face_areas(mesh).sum()
    return np.asarray(found * (size * mesh.length_scale / math.sqrt(squares.mean())))


def made(count: int = _SUBJECTS, coarse: bool = True) -> Made:
    """Make a population."""
    mesh, depth = depth_of("left", coarse)
    fields, rng = known_fields(mesh, count, _SIZE), np.random.default_rng(1)
    subjects = tuple(
        Flow(mesh, field).point_map().pull_back(depth) + _NOISE * rng.normal(size=len(depth))
        for field in fields
    )
    return Made(mesh, depth, fields, subjects, depth_of("right", coarse)[1])


def written(population: Made, folder: Path) -> tuple[Cohort, Path]:
    """Write the files of a population."""
    folder.mkdir(parents=True, exist_ok=True)
    template = folder / "template.ply"
    write_surface(template, population.mesh)
    subjects = []
    for number, values in enumerate((*population.subjects, population.odd), 1):
        name = "odd" if number > len(population.subjects) else f"subject {number:02}"
        np.save(folder / f"{name}.npy", values)
        subjects.append(Subject(name, (_file(folder / f"{name}.npy"),)))
    np.save(folder / "own.npy", population.function)
    np.save(folder / "plain.npy", np.mean(population.subjects, axis=0))
    return Cohort((Channel("depth"),), tuple(subjects)), template


def _file(path: Path) -> str:
    return f"file:{quoted(str(path.absolute()))}"


@dataclass(frozen=True)
class Judge:
    """Holds what was found against what is known."""

    made: Made
    folder: Path

    def error(self, mean: FloatArray) -> float:
        """Return the L2 error of a mean against the template's function, over its deviation."""
        squares = (mean - self.made.function) ** 2
        return math.sqrt(np.average(squares, weights=vertex_areas(self.made.mesh)))

    def fields(self, found: Population) -> tuple[float, float, float]:
        """Return the relative L2 error of the fields, and over where the function is not flat the
        median of the angle between found and known, in degrees, and of the ratio of their lengths.
        """
        mesh, known = self.made.mesh, -self.made.fields
        own = np.stack([self._field(found, i) for i in range(len(known))])
        slope = np.linalg.norm((gradient(mesh) @ self.made.function).reshape(-1, 2), axis=1)
        seen = slope > _LEAST_SLOPE * np.median(slope)
        areas = face_areas(mesh)
        off = ((own - known) ** 2).sum(axis=2) @ areas
        relative = math.sqrt(off.sum() / ((known**2).sum(axis=2) @ areas).sum())
        lengths = [np.linalg.norm(each, axis=2)[:, seen] for each in (own, known)]
        cosines = (own * known).sum(axis=2)[:, seen] / (lengths[0] * lengths[1])
        angles = np.degrees(np.arccos(np.clip(cosines, -1, 1)))
        return relative, float(np.median(angles)), float(np.median(lengths[0] / lengths[1]))

    def _field(self, found: Population, i: int) -> FloatArray:
        match = load_registration(self.folder / f"{found.digests[i]}.npz").match
        return np.asarray(match.parameters.tau * match.velocity.mean(axis=0) - found.drift)

    def points(self, found: Population) -> list[tuple[float, float]]:
        """Return median and 95% of how far vertices are from where they belong, in edges: before,
        and registered.
        """
        mesh = self.made.mesh
        edge = math.sqrt(4 / math.sqrt(3) * face_areas(mesh).mean())
        drift = Flow(mesh, -found.drift).point_map()
        before, after = [], []
        for i, field in enumerate(self.made.fields):
            place = Flow(mesh, field).point_map(inverse=True).positions
            own = load_registration(self.folder / f"{found.digests[i]}.npz").points
            after.append(np.linalg.norm(drift.followed_by(own).positions - place, axis=1))
            before.append(np.linalg.norm(mesh.vertices - place, axis=1))
        return [
            (float(np.median(each)) / edge, float(np.percentile(each, 95)) / edge)
            for each in (before, after)
        ]


def registered(population: Made, folder: Path, cluster: Cluster) -> dict[str, Population]:
    """Register a population, from three first targets."""
    cohort, template = written(population, folder)
    starts = {
        "the subject most like the plain mean": Settings(),
        "the template's own function": Settings({"depth": _file(folder / "own.npy")}),
        "the plain mean": Settings({"depth": _file(folder / "plain.npy")}),
    }
    return {
        name: register_population(
            cohort,
            template,
            folder / "out",
            settings,
            cluster,
            on_change=lambda entry: print(
                f"{entry.row.name}: {entry.state}, {entry.record.seconds:.1f} s", flush=True
            ),
        )
        for name, settings in starts.items()
    }


def told(judge: Judge, found: Mapping[str, Population]) -> list[str]:
    """Return what came of a population, from each first target."""
    population, usual = judge.made, next(iter(found.values()))
    plain = judge.error(np.mean(population.subjects, axis=0))
    rows = [
        (
            name,
            str(len(each.changes)),
            f"{each.changes[-1]:.3f}",
            f"{judge.error(each.mean()):.3f}",
            f"{judge.error(each.mean()) / plain:.2f}",
            f"{judge.fields(each)[0]:.2f}",
            ", ".join(each.names[i] for i in np.flatnonzero(~each.fits)) or "nobody",
        )
        for name, each in found.items()
    ]
    heads = ("first target", "rounds", "last change", "error of the mean", "of the plain mean's")
    table = told_table((*heads, "error of the fields", "left out"), rows)
    relative, angle, ratio = judge.fields(usual)
    (before, before_95), (after, after_95) = judge.points(usual)
    phase = usual.phase_and_amplitude()
    odd = usual.reasons[usual.subject("odd")]
    farthest = np.linalg.norm(population.fields, axis=2).max() / population.mesh.length_scale
    return [
        f"{len(population.subjects)} subjects of {len(population.mesh.vertices):,} vertices, and "
        f"an odd one. The known fields are {_SIZE:g} sqrt(area) (root of the mean square) and at "
        f"most {farthest:.2f}; noise is {_NOISE:g} of the function's deviation. The plain mean's "
        f"error is {plain:.3f}, without the odd one.",
        table,
        f"From the first of these, fields are off by {relative:.2f} in relative L2; where the "
        f"function is not flat, by {angle:.1f} degrees (median), and their length is {ratio:.2f} "
        f"of the known one's. Vertices lie {before:.2f} edges from where they belong before "
        f"(median; 95% below {before_95:.2f}), and {after:.2f} after (95% below {after_95:.2f}).",
        f"Of the variance {100 * phase.phase / phase.total:.1f}% is position and "
        f"{100 * phase.amplitude / phase.total:.1f}% value. The value's is {phase.amplitude:.4f}, "
        f"of which noise between vertices is {_NOISE**2 / 2:.4f}; the rest is position that "
        "registering left.",
        f"The odd one was left out, as {odd}.",
    ]


def draw(population: Made, found: Population, path: Path) -> None:
    """Draw the template's function, a subject, means, and how subjects vary."""
    mesh = population.mesh
    shown = {
        "the template": population.function,
        "a subject": population.subjects[0],
        "plain mean": np.mean(population.subjects, axis=0),
        "mean, registered": found.mean(),
    }
    panels = [Panel(mesh, Values(each, "depth"), name) for name, each in shown.items()]
    panels.append(Panel(mesh, Values(found.deviation(), "deviation"), "deviation"))
    sheet = Sheet((tuple(panels),), seen=(population.function,))
    drawn = figure_picture(sheet)
    write_picture(path, drawn.resize((_WIDE, round(_WIDE * drawn.height / drawn.width))))


class Cost(NamedTuple):
    """What a subject costs: seconds of one core, and bytes."""

    vertices: float
    register: float
    carry: float  # in each round, by who registers
    part: float  # position and value, at the end, by who registers
    add: float  # to the means in each round, by one process
    add_parted: float
    worker: float  # the most memory of a process that registers
    client: float  # memory that a subject adds to that of who makes the means
    file: float
    carried: float  # bytes of its files besides those of registrations, in each round


def costs(coarse: bool) -> Cost:
    """Measure a registration and a mean, in a process of their own."""
    words = [sys.executable, "-m", "laboratory.population", "--cost", "coarse" if coarse else "own"]
    told = subprocess.run(words, check=True, capture_output=True, text=True).stdout
    return Cost(*map(float, told.split()))


class _Timed:
    """Solves rows in this process, and tells the seconds of that from those of who asks."""

    def __init__(self, folder: Path) -> None:
        self.ledger, self.solving = Ledger(folder), dict[str, float]()
        self._identity = self.ledger.make()

    def __call__(self, rows: Sequence[Row], task: str) -> list[Entry]:
        tasks = [Task(row, str(self.ledger.folder), self._identity) for row in rows]
        self.ledger.entries(rows)  # as `abfm.batch.run` asks first
        start = process_time()
        for each in tasks:
            attempt(each)
        self.solving[task] = self.solving.get(task, 0.0) + process_time() - start
        return self.ledger.entries(rows)


def _measured(coarse: bool) -> Cost:
    population = made(3, coarse)
    mesh, depth = population.mesh, population.function
    register(mesh, mesh, population.subjects[0], depth)  # kernels are compiled
    start = process_time()
    for values in population.subjects[1:]:
        register(mesh, mesh, values, depth)
    seconds = (process_time() - start) / 2
    worker = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024.0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        cohort, template = written(population, folder)
        cohort = Cohort(cohort.channels, cohort.subjects[:3])
        settings = Settings({"depth": _file(folder / "own.npy")})
        registering = _Timed(folder / "out")
        for tried in ("kernels are compiled", "measured"):
            carrying = _Timed(folder / tried)
            work = Work(cohort, template, folder / "out", settings, carrying)
            entries = registering(work.rows(work.first_target(), 1), "registering")
            start = process_time()
            found = work.round(entries, [], 1)
            middle = process_time()
            work.phases(entries, found)
            ends = middle - start, process_time() - middle
        carry, part = carrying.solving.values()
        file = max(each.stat().st_size for each in (folder / "out").glob("*.npz"))
        kept = max(each.stat().st_size for each in carrying.ledger.folder.glob("*.npz"))
    count = len(cohort.subjects)
    client = sum(each.nbytes for each in (*found.before, *found.after, found.log2_areas)) / count
    carry, part, add, add_parted = (
        each / count for each in (carry, part, ends[0] - carry, ends[1] - part)
    )
    times = seconds, carry, part, add, add_parted
    return Cost(len(mesh.vertices), *times, worker, client, file, kept)


def plan(found: Sequence[Cost]) -> str:
    """Return what 200 subjects cost on paper, by measured costs of one."""
    rows = []
    for cost in found:
        for workers in _WORKERS:
            each = _ROUNDS * (cost.register + cost.carry) + cost.part
            by_workers = math.ceil(_PLANNED / workers) * each
            adding = _PLANNED * (_ROUNDS * cost.add + cost.add_parted)
            rows.append(
                (
                    f"{cost.vertices:,.0f}",
                    str(workers),
                    f"{cost.register:.1f}",
                    f"{cost.carry:.2f} and {cost.part:.2f}",
                    f"{cost.add:.3f} and {cost.add_parted:.3f}",
                    _minutes(by_workers),
                    _minutes(adding),
                    _minutes(by_workers + adding),
                    f"{cost.worker / _MB:.0f}",
                    f"{min(workers, _PLANNED) * cost.worker / _MB / 1000:.1f}",
                    f"{_PLANNED * cost.client / _MB:.0f}",
                    f"{_ROUNDS * _PLANNED * (cost.file + cost.carried) / _MB / 1000:.1f}",
                )
            )
    heads = (
        "vertices",
        "workers",
        "s to register",
        "s to carry, and to part",
        "s to add both",
        "workers take",
        "means take",
        "in all",
        "MB a worker",
        "GB all workers",
        "MB for means",
        "GB of files",
    )
    return told_table(heads, rows)


def _minutes(seconds: float) -> str:
    return f"{seconds / 60:.1f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def main() -> None:
    """Measure, and write the page's tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, help="for registrations; kept")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--write", type=Path, help="a page with the marks of the tables")
    parser.add_argument("--picture", type=Path)
    parser.add_argument("--cost", choices=("coarse", "own"), help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.cost:
        print(*_measured(given.cost == "coarse"))
        return
    with tempfile.TemporaryDirectory() as name:
        population, folder = made(), given.folder or Path(name)
        found = registered(population, folder, Cluster(jobs=given.jobs))
        parts = told(Judge(population, folder / "out"), found)
    if given.picture:
        draw(population, next(iter(found.values())), given.picture)
    parts += [
        f"### {_PLANNED} subjects, on paper",
        plan([costs(coarse) for coarse in (True, False)]),
        f"On {in_words(machine())}.",
    ]
    print("\n\n".join(parts))
    if given.write:
        put_between(given.write, MARKS, parts)


if __name__ == "__main__":
    main()
