"""Known waves on a cortex: the fields of `abfm.sequence` beside linear Horn-Schunck, and films.

    python -m laboratory.waves [--surface white_left.gii.gz] [--film MESH FRAMES.npy SECONDS ...]
        [--folder DIR] [--jobs N] [--write docs/sequences.md]
        [--picture docs/images/waves.png] [--tracks docs/images/tracks.png]

The surface is by default nilearn's white one of fsaverage5, left. Waves are solved and compared on
all cores, and kept in the folder, so that the same command resumes. Each film is measured as it
is, by one process: how many intervals flow lines confirm, and which tracks there are; those of the
first are drawn.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import numpy as np

from abfm import TriangleMesh, load_mesh, sequence
from abfm.batch import Cluster, Entry, Row, run
from abfm.calculus import eigenbasis
from abfm.calculus.operators import edge_lengths, face_areas, gradient
from abfm.calculus.vector_fields import to_ambient
from abfm.flow.continuous_flow import ContinuousFlow
from abfm.types import BoolArray, FloatArray
from laboratory.common import mapped, put_between, told_table
from laboratory.film_tracks import draw_tracks
from laboratory.motion import GAMMAS, HEADS, Result, angles, compared

KINDS = ("travelling", "rotating", "source and sink")
NOISES = (0.0, 0.1, 0.3)  # standard deviation, of the frames'
DISPLACEMENTS = (0.5, 1.0, 2.0, 4.0)  # root mean square from frame to frame, in mean edges
FRAMES, WAVELENGTH = 6, 16.0  # mean edges, where the phase has its mean slope
MARKS = ("<!-- tables of laboratory.waves -->", "<!-- end of the tables -->")
_FLAT = 0.5  # of the root mean square of the slope: less is not told
_SLOW = 0.2  # the same of the speed


@dataclass(frozen=True)
class Wave:
    """A wave of a kind on a surface, whose field is known and the same at all times: that of
    eigenfunctions, so that it is smooth, times a speed; its phase is carried along.
    """

    mesh: TriangleMesh
    kind: str
    displacement: float

    @property
    def edge(self) -> float:
        return float(edge_lengths(self.mesh).mean())

    def _slope(self, function: FloatArray) -> FloatArray:
        return np.asarray((gradient(self.mesh) @ function).reshape(-1, 2))

    def _size(self, field: FloatArray) -> float:
        areas = face_areas(self.mesh)
        return float(np.sqrt(areas @ (field**2).sum(axis=1) / areas.sum()))

    @cached_property
    def field(self) -> FloatArray:
        """The field (F, 3) per frame: up the first eigenfunction, around it, or up the fourth."""
        basis = eigenbasis(self.mesh, 5)[1]
        slope = self._slope(basis[:, 4 if self.kind == "source and sink" else 1])
        if self.kind == "rotating":
            slope = np.stack([-slope[:, 1], slope[:, 0]], axis=1)
        speed = self.displacement * self.edge / self._size(slope)
        return to_ambient(self.mesh, speed * slope)

    @cached_property
    def frames(self) -> FloatArray:
        """The wave without noise, (T, V)."""
        basis = eigenbasis(self.mesh, 5)[1]
        phase = basis[:, {"travelling": 1, "rotating": 2, "source and sink": 4}[self.kind]]
        phase = phase / self._size(self._slope(phase)) * 2 * np.pi / (WAVELENGTH * self.edge)
        flow, points, found = ContinuousFlow(self.mesh, self.field, 1.0), None, [phase]
        for _ in range(FRAMES - 1):
            points = flow.origins(points)
            found.append(points.pull_back(phase))
        return np.cos(np.array(found))

    def told(self, frame: int) -> BoolArray:
        """Faces where the function is not flat, and something moves."""
        slope = self._slope(self.frames[frame])
        steep = np.linalg.norm(slope, axis=1) > _FLAT * self._size(slope)
        speed = np.linalg.norm(self.field, axis=1)
        return np.asarray(steep & (speed > _SLOW * self._size(self.field)))

    def errors(self, frame: int, found: FloatArray) -> tuple[float, float]:
        """Return the median angle, in degrees, and the median of the speed's relative error."""
        told = self.told(frame)
        a, b = found[told], self.field[told]
        sizes, wanted = (np.linalg.norm(v, axis=1) for v in (a, b))
        off = np.abs(sizes - wanted) / wanted
        return float(np.median(angles(a, b))), float(np.median(off))


class Noisy(NamedTuple):
    """A wave, its standard deviation of noise, and its frames (T, V) with that."""

    wave: Wave
    noise: float
    frames: FloatArray

    def rows(self, surface: Path, folder: Path) -> list[Row]:
        """Return rows of a batch that solve it frame by frame, and together."""
        name = f"{self.wave.kind}, {self.wave.displacement:g} edges, {100 * self.noise:g}% noise"
        path = folder / f"{name}.npy"
        np.save(path, self.frames)
        options = {"mesh": surface, "frames": path}
        return [Row(f"{name}, gamma {g:g}", {**options, "gamma": g}) for g in GAMMAS]


def noisy(mesh: TriangleMesh) -> Iterator[Noisy]:
    """Yield all waves with all amounts of noise."""
    for kind in KINDS:
        for displacement in DISPLACEMENTS:
            wave = Wave(mesh, kind, displacement)
            for noise in NOISES:
                rng = np.random.default_rng(0)
                scatter = noise * wave.frames.std() * rng.standard_normal(wave.frames.shape)
                yield Noisy(wave, noise, wave.frames + scatter)


def measured(surface: Path, folder: Path, cluster: Cluster) -> Iterator[Result]:
    """Measure all waves, whose films are solved by a batch and kept in a folder."""
    waves = [*noisy(load_mesh(surface))]
    rows = [row for each in waves for row in each.rows(surface, folder)]
    entries = iter(run(rows, folder, cluster, on_change=lambda e: print(e.row.name, flush=True)))
    found = [(each, [next(entries) for _ in GAMMAS]) for each in waves]
    yield from mapped(_result, found, cluster.processes)


def _result(found: tuple[Noisy, list[Entry]]) -> Result:
    each, entries = found
    wave, errors = each.wave, compared([entry.load() for entry in entries], each.wave.errors)
    return Result(wave.kind, each.noise, wave.displacement, errors)


def drawn(results: list[Result], path: Path) -> None:
    """Draw errors over displacements, a column for each amount of noise, means over the waves."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 5.6), layout="constrained")
    plots = figure.subplots(2, len(NOISES), sharex=True, sharey="row")
    names = ("Horn-Schunck, best smoothness", "abfm, frame by frame", "abfm, together in time")
    looks = (("#8a8f98", "s", "--"), ("#3b7dd8", "o", "-"), ("#d1495b", "o", "-"))
    for column, noise in enumerate(NOISES):
        own = [r for r in results if r.noise == noise]
        means = np.array(
            [np.mean([r.errors for r in own if r.displacement == d], axis=0) for d in DISPLACEMENTS]
        )
        for row, (word, factor) in enumerate((("angle, degrees", 1), ("speed, %", 100))):
            plot = plots[row, column]
            for number, (name, (color, marker, line)) in enumerate(zip(names, looks, strict=True)):
                values = factor * means[:, number, row]
                plot.plot(DISPLACEMENTS, values, line, color=color, marker=marker, label=name)
            plot.set_xscale("log", base=2)
            plot.set_xticks(DISPLACEMENTS, [f"{d:g}" for d in DISPLACEMENTS])
            plot.spines[["top", "right"]].set_visible(False)
            plot.grid(color="#e6e8ec")
            if column == 0:
                plot.set_ylabel(f"error of {word}")
        plots[0, column].set_title(f"{100 * noise:g}% noise" if noise else "no noise")
        plots[1, column].set_xlabel("displacement (edges per frame)")
    for row in plots:  # the columns of a row share their range
        row[0].set_ylim(bottom=0)
    plots[0, 0].legend(frameon=False, fontsize=8.5)
    figure.savefig(path, dpi=115)


def film_row(given: tuple[str, str, str, Path | None]) -> list[str]:
    """Return the row of frames whose motion is not known: the files of the mesh and the frames,
    seconds from frame to frame, and a picture of the tracks to draw.
    """
    mesh_path, frames_path, seconds, picture = given
    mesh = load_mesh(mesh_path, largest_component=True)
    frames = np.load(frames_path)
    start = perf_counter()
    found = sequence(mesh, frames, float(seconds) * np.arange(len(frames)))
    taken = perf_counter() - start
    tracks = found.tracks(5)
    kinds = Counter(track.kind for track in tracks)
    longest = max((len(track) for track in tracks), default=0)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    if picture:
        draw_tracks(found, picture)
    return [
        Path(frames_path).stem,
        f"{len(frames)} of {len(mesh.vertices):,}",
        f"{found.parameters.solver.order}",
        f"{found.parameters.alpha:g}",
        f"{found.sigma:g}",
        f"{found.confirmed} of {len(found)}",
        f"{np.median(found.residual):.3f}",
        f"{np.median(found.verified_residual):.3f}",
        f"{np.median(found.speed):.3g}",
        ", ".join(f"{kinds[kind]} {kind}" for kind in sorted(kinds)),
        str(longest),
        f"{taken:.0f}",
        f"{memory:.2f}",
    ]


_FILM_HEADS = (
    "sequence",
    "frames, vertices",
    "order",
    "alpha",
    "sigma",
    "confirmed",
    "residual",
    "by flow lines",
    "speed (a second)",
    "tracks of 5 or more",
    "longest",
    "s",
    "GB",
)


def fsaverage5() -> Path:
    """Return nilearn's white surface."""
    found = find_spec("nilearn")
    if found is None or found.origin is None:
        raise SystemExit('nilearn is not installed: pip install "abfm[brain]", or give --surface')
    folder = Path(found.origin).parent / "datasets" / "data" / "fsaverage5"
    return folder / "white_left.gii.gz"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--surface", type=Path)
    parser.add_argument("--film", nargs=3, action="append", default=[])
    for name in ("write", "picture", "tracks"):
        parser.add_argument(f"--{name}", type=Path)
    parser.add_argument("--films-only", action="store_true")
    parser.add_argument("--folder", type=Path, help="for what is solved of the waves; kept")
    parser.add_argument("--jobs", type=int, help="so many processes (default: one for each core)")
    given = parser.parse_args()
    parts, results = [], list[Result]()
    if not given.films_only:

        def rows(folder: Path) -> Iterator[list[str]]:
            for result in measured(given.surface or fsaverage5(), folder, Cluster(given.jobs)):
                results.append(result)
                yield result.row()

        parts.append(
            "Median errors of the angle (first three), and of the speed; bold where Horn-Schunck "
            "is better than all intervals together:"
        )
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(given.folder or temporary)
            folder.mkdir(parents=True, exist_ok=True)
            parts.append(told_table(("wave", *HEADS), rows(folder)))
        if given.picture:
            drawn(results, given.picture)
    if given.film:
        pictures = given.tracks, *[None] * (len(given.film) - 1)
        films = [(*film, picture) for film, picture in zip(given.film, pictures, strict=True)]
        rows_of_films = mapped(film_row, films, Cluster(given.jobs).processes)
        parts += ["Sequences:", told_table(_FILM_HEADS, rows_of_films)]
    if given.write:
        put_between(given.write, MARKS, parts)


if __name__ == "__main__":
    main()
