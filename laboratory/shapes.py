"""Maps between shapes: initial maps on people and animals, torn ones made continuous, landmarks.

    python -m laboratory.shapes --data FOLDER [--only TABLE ...] [--write docs/shapes.md]

FOLDER holds clones of public repositories: those of `laboratory.shape_pairs`, and RobinMagnet/pyFM
for a cat, a lion and their landmarks. Where ``pyfmaps`` is installed its quickstart is run as well.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import mean, median
from time import perf_counter
from typing import NamedTuple

import numpy as np

from abfm import Correspondence, TriangleMesh, load_mesh, register
from abfm.maps import PointMap, continuous_map
from abfm.registration import prepare
from abfm.registration.initial import SpectralSearch, initial_map
from abfm.registration.initial.given import Given
from abfm.registration.initial.landmark_pairs import Landmarks
from abfm.types import IntArray
from laboratory import bounds, initial_maps, shape_pairs
from laboratory.common import put_between, told_table

PYFM = "pyFM/examples/data"
_PEOPLE = 20  # pairs whose maps are made continuous
_BOUNDED, _ALIKE = 5, "hks:time=0.01"  # pairs that are matched within a bound, and by what


def by_eigenfunctions(pair: shape_pairs.ShapePair) -> PointMap:
    """Return the best map by eigenfunctions, torn."""
    search = SpectralSearch(pair.a, pair.b)
    return search.finished(search.ranked(1)[0])[0]


def people_rows(folder: Path) -> Iterator[list[str]]:
    """Yield a row a pair, and one of what all come to."""
    kept: list[tuple[float, ...]] = []
    for pair in shape_pairs.people(folder / shape_pairs.PEOPLE, _PEOPLE):
        began = perf_counter()
        start = by_eigenfunctions(pair)
        found = perf_counter()
        spheres = continuous_map(start)
        ended = perf_counter()
        smooth = Correspondence.through_sphere(pair.a, pair.b, *spheres)
        torn, whole = start.distortion(), smooth.distortion()
        faces = len(pair.b.faces) / 100
        row = (
            pair.error(start),
            torn.folded / faces,
            torn.collapsed / faces,
            pair.error(smooth.points),
            whole.folded / faces,
            whole.collapsed / faces,
            smooth.coverage(),
            whole.log2_area.mean,
            whole.log2_shape.mean,
            smooth.there_and_back().median,
            found - began,
            ended - found,
        )
        kept.append(row)
        yield _cells(pair.name, row)
    columns = list(zip(*kept, strict=True))
    yield _cells("mean", tuple(map(mean, columns)))
    yield _cells("median", tuple(map(median, columns)))


def _cells(name: str, row: tuple[float, ...]) -> list[str]:
    forms = (".4f", ".1f", ".1f", ".4f", ".2f", ".2f", ".3f", ".2f", ".2f", ".1g", ".0f", ".0f")
    return [name, *(f"{value:{form}}" for value, form in zip(row, forms, strict=True))]


def bounded_people(folder: Path) -> Iterator[list[str]]:
    """Yield rows of what bounds of distortion cost, from continuous maps."""
    for pair in shape_pairs.people(folder / shape_pairs.PEOPLE, _BOUNDED):
        spheres = continuous_map(by_eigenfunctions(pair))
        first = Correspondence.through_sphere(pair.a, pair.b, *spheres)
        prepared = prepare(pair.a, pair.b, _ALIKE, _ALIKE, initial=first)
        yield from bounds.rows(pair.name, prepared, bounds.around)


def bounded_animals(folder: Path) -> Iterator[list[str]]:
    """Yield the same of the cat on the lion, by landmarks alone and beside functions."""
    cat, lion, marks = read_animals(folder)
    few = Landmarks.of_vertices(cat, lion, *marks[:5].T)
    first = initial_map("landmarks", Given(cat, lion, landmarks=few)).correspondence
    for name, f in (("20 landmarks", None), ("20 landmarks and functions", _ALIKE)):
        prepared = prepare(cat, lion, f, f, initial=first, landmarks=marks)
        yield from bounds.rows(f"cat on lion, {name}", prepared, bounds.around)


def read_animals(folder: Path) -> tuple[TriangleMesh, TriangleMesh, IntArray]:
    """Read the cat, the lion, and pairs of their vertices that belong together."""
    cat, lion = (load_mesh(folder / PYFM / f"{name}-00.off") for name in ("cat", "lion"))
    return cat, lion, np.loadtxt(folder / PYFM / "landmarks.txt", dtype=np.int64)


def animal_rows(folder: Path) -> Iterator[list[str]]:
    """Yield rows of the cat on the lion by its first landmarks, and by all."""
    cat, lion, marks = read_animals(folder)
    for count in (5, 10, len(marks)):
        began = perf_counter()
        found = register(cat, lion, landmarks=marks[:count])
        seconds = perf_counter() - began
        errors, distortion = found.landmark_errors, found.distortion()
        assert errors is not None
        yield [
            str(count),
            f"{100 * errors.mean():.2f}",
            f"{100 * errors.max():.2f}",
            str(distortion.folded),
            f"{found.coverage():.3f}",
            f"{distortion.log2_area.mean:.2f}",
            f"{distortion.log2_shape.mean:.2f}",
            f"{found.there_and_back().median:.1g}",
            f"{seconds:.0f}",
        ]


def bounded(folder: Path) -> Iterator[list[str]]:
    """Yield the rows of people, then those of the cat on the lion."""
    yield from bounded_people(folder)
    yield from bounded_animals(folder)


class Table(NamedTuple):
    """A table of the page: its heads, and its rows from the folder of the data."""

    heads: tuple[str, ...]
    rows: Callable[[Path], Iterator[list[str]]]


_OF_MAP = ("error", "turned %", "collapsed %")
_OF_FORM = ("coverage", "abs. log₂ J", "log₂ R", "back (edges)")
_OF_MARKS = ("landmarks", "mean, %", "largest, %", "folded")
TABLES = {
    "initial": Table(initial_maps.HEADS, initial_maps.rows),
    "continuous": Table(
        ("pair", *_OF_MAP, *_OF_MAP, *_OF_FORM, "s, map", "s, continuous"), people_rows
    ),
    "landmarks": Table((*_OF_MARKS, *_OF_FORM, "s"), animal_rows),
    "bounds": Table(bounds.HEADS, bounded),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--only", nargs="+", choices=TABLES, default=list(TABLES))
    parser.add_argument("--write", type=Path)
    given = parser.parse_args()
    for name in given.only:
        table = told_table(TABLES[name].heads, TABLES[name].rows(given.data))
        if given.write:
            put_between(given.write, (f"<!-- table: {name} -->", f"<!-- end: {name} -->"), [table])


if __name__ == "__main__":
    main()
