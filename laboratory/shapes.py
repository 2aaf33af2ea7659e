"""Maps between shapes: torn ones made continuous, on people, and landmarks alone, on animals.

    python -m laboratory.shapes --people SHREC19 [--pairs 20] --animals FOLDER
        [--write docs/shapes.md]

People are a checkout of the repository SHREC19_matching_humans (``mat/``, ``matches/FARMgt_txt/``
and the list of pairs), coarsened to 5,000 vertices; animals a folder with ``cat-00.off``,
``lion-00.off`` and ``landmarks.txt``, as the examples of pyFM have them.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from statistics import mean, median
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from scipy.io import loadmat
from scipy.spatial import cKDTree

from abfm import AbfmError, Correspondence, TriangleMesh, load_mesh, register
from abfm.maps import continuous_map, map_accuracy
from abfm.mesh.coarsening import coarsened
from abfm.registration import prepare
from abfm.registration.initial import functional_map_start, initial_map
from abfm.registration.initial.given import Given
from abfm.registration.initial.landmark_pairs import Landmarks
from abfm.types import FloatArray, IntArray
from laboratory import bounds
from laboratory.common import put_between, told_table

MARKS = ("<!-- table of laboratory.shapes -->", "<!-- end of the table -->")
_VERTICES = 5000
_FAR = 0.1  # of sqrt(area): truth that is farther from the surface than this is on a part cut off
_SEED = 7
_MEASURED = 500  # vertices of each pair whose errors are measured
_BOUNDED, _ALIKE = 5, "hks:time=0.01"  # pairs that are matched within a bound, and by what


class Pair(NamedTuple):
    """Two people, and where on A each vertex of B truly lies, (V_B,)."""

    name: str
    a: TriangleMesh
    b: TriangleMesh
    truth: IntArray


def pairs_of_people(folder: Path, count: int) -> Iterator[Pair]:
    """Yield pairs of people, drawn at random, always the same ones; those of several parts, one of
    which has to be cut off, are left out where it is known that they matter.
    """

    @cache
    def person(number: str) -> tuple[FloatArray, TriangleMesh, TriangleMesh]:
        found: dict[str, Any] = loadmat(str(folder / f"mat/{number}.mat"), simplify_cells=True)
        shape = next(value for value in found.values() if isinstance(value, dict))
        columns = [shape[axis] for axis in "XYZ"] if "X" in shape else shape["VERT"].T
        vertices = np.column_stack(list(columns)).astype(float)
        faces = np.asarray(shape["TRIV"], dtype=np.int64) - 1
        sides = np.sort(faces, axis=1)
        proper = (sides[:, 0] != sides[:, 1]) & (sides[:, 1] != sides[:, 2])
        first = np.unique(sides, axis=0, return_index=True)[1]
        faces = faces[np.intersect1d(first, np.flatnonzero(proper))]
        whole = TriangleMesh(vertices, faces, largest_component=True)
        return vertices, whole, coarsened(whole, _VERTICES) or whole

    lines = (folder / "PAIRS_list_SHREC19_connectivity.txt").read_text().split()
    order = np.random.default_rng(_SEED).permutation(len(lines))
    given = 0
    for line in (lines[number] for number in order):
        number_b, number_a = line.split(",")
        try:
            (_, whole, b), (places, _, a) = person(number_b), person(number_a)
        except (AbfmError, OSError) as error:
            print(f"{line}: left out, {error}", flush=True)
            continue
        matches = folder / f"matches/FARMgt_txt/{number_b}_{number_a}.txt"
        true = np.array(matches.read_text().split(), dtype=np.int64) - 1
        nearest = whole.vertex_ids[cKDTree(whole.vertices).query(b.vertices)[1]]
        off, truth = cKDTree(a.vertices).query(places[true[nearest]])
        if a.genus or b.genus or np.quantile(off, 0.99) > _FAR * a.length_scale:
            continue
        yield Pair(f"{number_b} to {number_a}", a, b, np.asarray(truth, dtype=np.int64))
        given += 1
        if given == count:
            return


def people_rows(folder: Path, count: int) -> Iterator[list[str]]:
    """Yield a row a pair, and one of what all come to."""
    kept: list[tuple[float, ...]] = []
    for pair in pairs_of_people(folder, count):
        began = perf_counter()
        start, _ = functional_map_start(pair.a, pair.b)
        found = perf_counter()
        spheres = continuous_map(start)
        ended = perf_counter()
        smooth = Correspondence.through_sphere(pair.a, pair.b, *spheres)
        torn, whole = start.distortion(), smooth.distortion()
        faces = len(pair.b.faces) / 100
        row = (
            map_accuracy(start, pair.truth, _MEASURED).mean,
            torn.folded / faces,
            torn.collapsed / faces,
            smooth.accuracy(pair.truth, _MEASURED).mean,
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
    for pair in pairs_of_people(folder, _BOUNDED):
        spheres = continuous_map(functional_map_start(pair.a, pair.b)[0])
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
    cat, lion = (load_mesh(folder / f"{name}-00.off") for name in ("cat", "lion"))
    return cat, lion, np.loadtxt(folder / "landmarks.txt", dtype=np.int64)


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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("people", "animals", "write"):
        parser.add_argument(f"--{name}", type=Path)
    parser.add_argument("--pairs", type=int, default=20)
    given = parser.parse_args()
    parts = []
    if given.people:
        heads = ("pair", "error", "turned %", "collapsed %", "error", "turned %", "collapsed %")
        told = ("coverage", "abs. log₂ J", "log₂ R", "back (edges)", "s, map", "s, continuous")
        rows = people_rows(given.people, given.pairs)
        parts += ["People:", told_table((*heads, *told), rows)]
    if given.animals:
        left = ("landmarks", "mean, %", "largest, %", "folded", "coverage", "abs. log₂ J")
        rows = animal_rows(given.animals)
        parts += ["A cat on a lion:", told_table((*left, "log₂ R", "back (edges)", "s"), rows)]
    of_both = (
        row
        for path, told in ((given.people, bounded_people), (given.animals, bounded_animals))
        if path
        for row in told(path)
    )
    parts += ["Bounds of distortion (`max_distortion`):", told_table(bounds.HEADS, of_both)]
    if given.write:
        put_between(given.write, MARKS, parts)


if __name__ == "__main__":
    main()
