"""Rings and wedges on V1 to V3, whose motion is known: the fields of `abfm.sequence` compared with
linear Horn-Schunck, and the verdicts of a whole sequence, in which they also jump, come and go.

    python -m laboratory.retinotopy FOLDER [--side lh] [--jobs N]
        [--write docs/sequences.md] [--picture docs/images/retinotopy.png]

The folder has the maps of Benson et al. as neuropythy has them on fsaverage
(``neuropythy/lib/data/fsaverage/surf``): `lh.benson14_eccen.v4_0.mgz`, `_angle`, `_varea`. The
surface is nilearn's white one of fsaverage5, whose vertices are the first of fsaverage's.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from abfm import Sequence, TriangleMesh, load_mesh, sequence
from abfm.batch import Cluster
from abfm.calculus.operators import edge_lengths, face_areas, face_normals, gradient
from abfm.calculus.vector_fields import to_ambient
from abfm.functions import read_column
from abfm.outcome import worse_residual
from abfm.types import BoolArray, FloatArray, IntArray
from laboratory.common import mapped, put_between, told_table
from laboratory.motion import HEADS, Errors, Result, angles, compared, solved
from laboratory.waves import fsaverage5

if TYPE_CHECKING:
    from matplotlib.axes import Axes

NOISES = (0.0, 0.05, 0.1)  # standard deviation, of the frames'
DISPLACEMENTS = {"ring": (0.7, 2.0, 4.0, 6.0), "wedge": (0.7, 2.0, 4.0)}
"""From frame to frame, median over the faces, in mean edges."""
FRAMES = 6  # at most
MARKS = ("<!-- tables of laboratory.retinotopy -->", "<!-- end of these tables -->")
_SIDES = {"lh": "left", "rh": "right"}
_AREAS = (1, 2, 3)
_FOVEA = 1e-3  # degrees, below which eccentricities are that
_FLAT = 0.5  # of the root mean square of the slope: less is not told
_DRAWN = 0.7  # edges from frame to frame, in the picture
_FAR = 2.0  # widths, beyond which nothing is felt of a stimulus
_MOVES, _TURNS, _AWAY, _JUMPS = "moves", "comes or goes", "is elsewhere", "jumps back"


@dataclass(frozen=True, eq=False)
class Maps:
    """Eccentricity and angle (V,), in degrees, 0 the upper vertical meridian, and visual areas."""

    mesh: TriangleMesh
    eccentricity: FloatArray
    angle: FloatArray
    area: FloatArray

    @cached_property
    def seen(self) -> BoolArray:
        """Vertices of V1 to V3."""
        return np.asarray(np.isin(self.area, _AREAS) & (self.eccentricity > 0))

    @cached_property
    def inside(self) -> BoolArray:
        """Faces within one area, as angles turn back where one meets the next."""
        corners, seen = self.area[self.mesh.faces], self.seen[self.mesh.faces]
        return np.asarray((corners == corners[:, :1]).all(axis=1) & seen.all(axis=1))

    @property
    def edge(self) -> float:
        return float(edge_lengths(self.mesh).mean())


def read_maps(folder: Path, side: str, mesh: TriangleMesh) -> Maps:
    """Read the maps of a side, on the first vertices of theirs."""
    eccentricity, angle, area = (
        read_column(folder / f"{side}.benson14_{name}.v4_0.mgz", "0")[: len(mesh.vertices)]
        for name in ("eccen", "angle", "varea")
    )
    return Maps(mesh, eccentricity, angle, area)


@dataclass(frozen=True, eq=False)
class Stimulus:
    """A bump in the logarithm of eccentricity, or in the angle, that goes outward or round."""

    maps: Maps
    kind: str  # "ring" or "wedge"

    @property
    def width(self) -> float:
        """Standard deviation of the bump, in e-folds of eccentricity or degrees."""
        return 0.6 if self.kind == "ring" else 30.0

    @property
    def _ends(self) -> tuple[float, float]:
        """Between these, centres are well inside the areas."""
        return (np.log(0.8), np.log(30.0)) if self.kind == "ring" else (30.0, 150.0)

    @cached_property
    def phase(self) -> FloatArray:
        """What the bump is a function of, (V,)."""
        if self.kind == "wedge":
            return self.maps.angle
        return np.asarray(np.log(np.maximum(self.maps.eccentricity, _FOVEA)))

    @cached_property
    def normal(self) -> FloatArray:
        """The field (F, 3) along the phase's gradient that carries it by 1 in a unit of time."""
        slope = (gradient(self.maps.mesh) @ self.phase).reshape(-1, 2)
        squares = (slope**2).sum(axis=1, keepdims=True)
        safe = np.where(squares > 0, squares, 1.0)
        return to_ambient(self.maps.mesh, np.where(squares > 0, slope / safe, 0.0))

    @property
    def pace(self) -> float:
        """How much a centre moves for a displacement of one edge, median over the faces."""
        speeds = np.linalg.norm(self.normal[self.maps.inside], axis=1)
        return self.maps.edge / float(np.median(speeds))

    def shown(self, centres: FloatArray) -> FloatArray:
        """Return the activity for each centre, (T, V)."""
        off = self.phase - centres[:, None]
        if self.kind == "wedge":
            off = (off + 180) % 360 - 180
        return np.asarray(np.exp(-0.5 * (off / self.width) ** 2))

    def measured(self, centres: FloatArray, noise: float) -> FloatArray:
        """Return it with noise, NaN where it is not V1 to V3."""
        shown, seen = self.shown(centres), self.maps.seen
        scatter = np.random.default_rng(0).standard_normal(shown.shape)
        return np.where(seen, shown + noise * shown[:, seen].std() * scatter, np.nan)

    def centres(self, displacement: float) -> FloatArray:
        """Return where it is in each frame, well inside the areas, two at least."""
        first, last = self._ends
        step = displacement * self.pace
        count = min(FRAMES, max(int((last - first) / step) + 1, 2))
        return np.asarray((first + last) / 2 + step * (np.arange(count) - (count - 1) / 2))

    def course(self, step: float) -> FloatArray:
        """Return centres in two rounds of an experiment: a ring begins anew at the fovea, a wedge
        is in the other half of the visual field for half of the time.
        """
        first, last = (np.log(0.5), np.log(40.0)) if self.kind == "ring" else (0.0, 360.0)
        count = round(2 * (last - first) / step)
        return np.asarray(first + (step * np.arange(count)) % (last - first))

    def happens(self, one: float, other: float) -> str:
        """Say what a step of the course from a centre to another is."""
        if self.kind == "ring":
            return _MOVES if other > one else _JUMPS
        outside = [max(abs((centre + 90) % 360 - 180) - 90, 0) for centre in (one, other)]
        if max(outside) == 0:
            return _MOVES
        return _AWAY if min(outside) > _FAR * self.width else _TURNS

    def told(self, shown: FloatArray) -> BoolArray:
        """Faces within an area where a frame is not flat."""
        maps = self.maps
        slope = np.linalg.norm((gradient(maps.mesh) @ shown).reshape(-1, 2), axis=1)
        areas = np.where(maps.inside, face_areas(maps.mesh), 0.0)
        usual = np.sqrt(areas @ slope**2 / areas.sum())
        return np.asarray(maps.inside & (slope > _FLAT * usual))

    def errors(self, centre: float, step: float, found: FloatArray) -> Errors:
        """Return the median angle to the gradient, in degrees, and the median of the relative error
        of the speed along it, of a field that is to carry the bump by a step.
        """
        told = self.told(self.shown(np.array([centre]))[0])
        a, b = found[told], step * self.normal[told]
        along = np.einsum("fx,fx->f", a, b) / (b**2).sum(axis=1)
        return float(np.median(angles(a, b))), float(np.median(np.abs(along - 1)))


class Case(NamedTuple):
    """A stimulus, its displacement from frame to frame in edges, and its noise."""

    stimulus: Stimulus
    displacement: float
    noise: float

    def measured(self) -> Result:
        """Return the errors of Horn-Schunck, and of both sequences."""
        stimulus = self.stimulus
        centres = stimulus.centres(self.displacement)
        step = float(centres[1] - centres[0])

        def errors(i: int, found: FloatArray) -> Errors:
            return stimulus.errors(float(centres[i]), step, found)

        found = solved(stimulus.maps.mesh, stimulus.measured(centres, self.noise))
        return Result(stimulus.kind, self.noise, self.displacement, compared(found, errors))

    def course_rows(self) -> list[list[str]]:
        """Return what `course_rows` does."""
        return list(course_rows(*self))


def cases(maps: Maps) -> list[Case]:
    """Return both stimuli at all displacements with all amounts of noise."""
    return [
        Case(Stimulus(maps, kind), displacement, noise)
        for kind, displacements in DISPLACEMENTS.items()
        for displacement in displacements
        for noise in NOISES
    ]


def course_rows(stimulus: Stimulus, displacement: float, noise: float) -> Iterator[list[str]]:
    """Say of two rounds of a stimulus what its intervals came to, by what happens in them."""
    step = displacement * stimulus.pace
    centres = stimulus.course(step)
    found = sequence(stimulus.maps.mesh, stimulus.measured(centres, noise))
    what = [stimulus.happens(*pair) for pair in pairwise(centres.tolist())]
    left = worse_residual(found.residual, found.verified_residual)
    for kind in dict.fromkeys(what):
        these = [i for i, each in enumerate(what) if each == kind]
        yield [
            stimulus.kind,
            kind,
            str(len(these)),
            str(sum(found.verdicts[i].kind.is_good for i in these)),
            f"{np.median([_first(found, i) for i in these]):.2f}",
            f"{np.median(left[these]):.2f}",
            f"{np.median(found.speed[these]) / stimulus.maps.edge:.2f}",
            *_course_errors(stimulus, found, centres, step, these if kind == _MOVES else []),
        ]


def _first(found: Sequence, interval: int) -> float:
    functions = found[interval].problem.functions
    return functions.residual(functions.source)


def _course_errors(
    stimulus: Stimulus, found: Sequence, centres: FloatArray, step: float, these: list[int]
) -> list[str]:
    if not these:
        return ["", ""]
    all_errors = [stimulus.errors(float(centres[i]), step, found.velocity[i]) for i in these]
    angle, speed = np.mean(all_errors, axis=0)
    return [f"{angle:.1f}°", f"{100 * speed:.1f}%"]


COURSE_HEADS = (
    "sequence",
    "the stimulus",
    "intervals",
    "confirmed",
    "change",
    "residual",
    "speed (edges)",
    "angle",
    "speed",
)


def drawn(maps: Maps, surface: TriangleMesh, path: Path, noise: float = 0.05) -> None:
    """Draw both stimuli at two times each, with the fields found, on a surface of the same faces,
    seen from where the areas look.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 9), layout="constrained")
    for row, kind in zip(figure.subplots(2, 2), DISPLACEMENTS, strict=True):
        stimulus = Stimulus(maps, kind)
        centres = stimulus.centres(_DRAWN)
        film = sequence(maps.mesh, stimulus.measured(centres, noise))
        for plot, i in zip(row, (0, len(film) - 1), strict=True):
            at = np.exp(centres[i]) if kind == "ring" else centres[i]
            name = "eccentricity" if kind == "ring" else "polar angle"
            plot.set_title(f"{kind} at {name} {at:.{1 if kind == 'ring' else 0}f}°")
            _draw_frame(plot, surface, maps.seen, film.frames[i, :, 0])
            told = stimulus.told(stimulus.shown(centres[i : i + 1])[0])
            _draw_arrows(plot, maps, surface, film.velocity[i], told)
    figure.savefig(path, dpi=90)


def _draw_frame(plot: Axes, surface: TriangleMesh, seen: BoolArray, values: FloatArray) -> None:
    inside: BoolArray = np.asarray(seen[surface.faces].all(axis=1))
    view, front = _view(surface, inside)
    points, shades = surface.vertices @ view.T, face_normals(surface) @ view[2]
    means = values[surface.faces].mean(axis=1)
    for faces, shown, colours, limits in (
        (front, shades, "gray", (-0.8, 1.2)),
        (front[inside[front]], means, "YlGnBu", (-0.1, 1.3)),
    ):
        plot.tripcolor(
            *points[:, :2].T,
            triangles=surface.faces[faces],
            facecolors=shown[faces],
            cmap=colours,
            vmin=limits[0],
            vmax=limits[1],
            edgecolors="face",
            linewidth=0.2,
        )
    corners = points[surface.faces[inside & (shades > 0)]].reshape(-1, 3)[:, :2]
    low, high = corners.min(axis=0), corners.max(axis=0)
    half = 0.55 * (high - low).max()
    for which, middle in zip(("x", "y"), (low + high) / 2, strict=True):
        plot.set(**{f"{which}lim": (middle - half, middle + half)})
    plot.set_aspect("equal")
    plot.axis("off")


def _draw_arrows(
    plot: Axes, maps: Maps, surface: TriangleMesh, field: FloatArray, told: BoolArray
) -> None:
    view, front = _view(surface, np.asarray(maps.seen[surface.faces].all(axis=1)))
    middles = surface.vertices[surface.faces].mean(axis=1) @ view.T
    arrows = np.einsum("fxy,fy->fx", _carriers(maps.mesh, surface), field) @ view.T
    chosen = _apart(middles, front[told[front]], 1.7 * maps.edge)
    plot.quiver(
        *middles[chosen, :2].T,
        *arrows[chosen, :2].T,
        angles="xy",
        scale_units="xy",
        scale=0.5,  # twice the way to the next frame
        width=0.006,
        color="#c2273a",
    )


def _view(surface: TriangleMesh, inside: BoolArray) -> tuple[FloatArray, IntArray]:
    """Return axes (3, 3) of a picture of these faces: right, up (as far as z is), and towards
    whoever looks; and the faces that look there, what is nearer later.
    """
    normals = face_normals(surface)
    ahead = normals[inside].sum(axis=0)
    ahead /= np.linalg.norm(ahead)
    right = np.cross([0.0, 0.0, 1.0], ahead)
    right /= np.linalg.norm(right)
    front = np.flatnonzero(normals @ ahead > 0)
    depths = surface.vertices[surface.faces[front]].mean(axis=1) @ ahead
    return np.stack([right, np.cross(ahead, right), ahead]), front[np.argsort(depths)]


def _carriers(mesh: TriangleMesh, surface: TriangleMesh) -> FloatArray:
    """Return what takes tangent vectors of a mesh to another with the same faces, (F, 3, 3)."""
    ours, theirs = (
        np.stack([m.vertices[m.faces[:, k]] - m.vertices[m.faces[:, 0]] for k in (1, 2)], axis=2)
        for m in (mesh, surface)
    )
    return np.asarray(theirs @ np.linalg.pinv(ours))


def _apart(middles: FloatArray, faces: IntArray, distance: float) -> list[int]:
    """Return faces, those in front first, of which none is nearer to another than that."""
    found: list[int] = []
    for face in faces[::-1].tolist():
        offs = middles[found] - middles[face]
        if not found or np.linalg.norm(offs, axis=1).min() > distance:
            found.append(face)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--side", choices=tuple(_SIDES), default="lh")
    for name in ("write", "picture"):
        parser.add_argument(f"--{name}", type=Path)
    parser.add_argument("--jobs", type=int, help="so many processes (default: one for each core)")
    given = parser.parse_args()
    white = fsaverage5().with_name(f"white_{_SIDES[given.side]}.gii.gz")
    maps = read_maps(given.folder, given.side, load_mesh(white))
    if given.picture:
        inflated = load_mesh(white.with_name(f"infl_{_SIDES[given.side]}.gii.gz"))
        drawn(maps, inflated, given.picture)
    parts = [
        "Median errors of the angle to the gradient (first three), and of the speed along it; bold "
        "where Horn-Schunck is better than all intervals together:"
    ]
    jobs = Cluster(given.jobs).processes
    results = mapped(Case.measured, cases(maps), jobs)
    parts.append(told_table(("stimulus", *HEADS), (each.row() for each in results)))
    parts.append("Two rounds of each, an edge from frame to frame, with 5% noise:")
    courses = mapped(
        Case.course_rows, [Case(Stimulus(maps, kind), 1.0, 0.05) for kind in DISPLACEMENTS], jobs
    )
    parts.append(told_table(COURSE_HEADS, chain.from_iterable(courses)))
    if given.write:
        put_between(given.write, MARKS, parts)


if __name__ == "__main__":
    main()
