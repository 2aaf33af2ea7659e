"""Landmarks: points of A and points of B that belong together, and the file that holds them."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from abfm.errors import AbfmError, brief, one_line
from abfm.functions.value_files import reported
from abfm.io import write_csv
from abfm.maps.surface_points import SurfacePoints, project_onto_surface, vertex_points
from abfm.mesh import TriangleMesh
from abfm.numerics.real_numbers import real_numbers
from abfm.reading import Format, open_file, rows_of
from abfm.reading.text_tables import is_number
from abfm.registration.initial.vertex_numbering import warn_of_numbering
from abfm.types import FloatArray

_WORDS = ("name", "weight", "curve")  # columns beside the places, by their names
_SURFACES = {"a": "a", "source": "a", "b": "b", "target": "b"}  # words in names of columns
_VERTEX_NUMBER_MAX = 1e15  # number of a vertex; larger ones are none and fill lines
_DISTANCE_MAX = 0.1  # of sqrt(area): a place that is farther from its surface is none of its points
_CURVE_PLACES = 32  # places between two points of a curve that are brought onto the surface


@dataclass(frozen=True, eq=False)
class Landmarks:
    """L points of A and the L points of B that belong to them.

    Attributes
    ----------
    a, b : SurfacePoints
        Row i of one belongs to row i of the other.
    weights : (L,) array
        Positive; how much each one counts.
    names : tuple of str
        As a file names them, or by their numbers, counted from 0.
    """

    a: SurfacePoints
    b: SurfacePoints
    weights: FloatArray
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        weights = real_numbers(self.weights, "weights of landmarks", AbfmError)
        counts = len(self.a.faces), len(self.b.faces), len(self.names)
        if len(set(counts)) > 1 or weights.shape != (counts[0],):
            raise AbfmError(
                f"landmarks have {counts[0]} points of A, {counts[1]} of B, weights of shape "
                f"{weights.shape} and {counts[2]} names; expected as many of each"
            )
        if not counts[0]:
            raise AbfmError("there are no landmarks; expected one pair of points or more")
        wrong = np.flatnonzero(~((weights > 0) & np.isfinite(weights)))
        if len(wrong):
            raise AbfmError(
                f"landmark {one_line(self.names[wrong[0]], 40)} has weight {weights[wrong[0]]:g}; "
                "expected positive numbers"
            )
        object.__setattr__(self, "weights", weights)

    def __len__(self) -> int:
        return len(self.names)

    @classmethod
    def of_vertices(
        cls, a: TriangleMesh, b: TriangleMesh, of_a: ArrayLike, of_b: ArrayLike
    ) -> Landmarks:
        """Return pairs of vertices of A (L,) and of B (L,), by their rows in the meshes."""
        points = vertex_points(a, of_a), vertex_points(b, of_b)
        count = len(points[0].faces)
        return cls(*points, np.ones(count), tuple(map(str, range(count))))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a .csv file that `read_landmarks` reads, as coordinates, whole or not at all, or
        raise ResultError.
        """
        places = np.concatenate([self.a.positions, self.b.positions], axis=1)
        axes = [f"{axis}_{side}" for side in "ab" for axis in "xyz"]
        cells = zip(places.tolist(), self.weights.tolist(), self.names, strict=True)
        rows = ([*row, weight, name] for row, weight, name in cells)
        write_csv(path, [[*axes, "weight", "name"], *rows])


class _LandmarkRow(NamedTuple):
    number: int  # counted from 1, among the rows of the file that are not empty
    a: tuple[float, ...]  # none where the cells are empty
    b: tuple[float, ...]
    name: str
    weight: float
    curve: str


def read_landmarks(
    a: TriangleMesh, b: TriangleMesh, path: str, one_based: bool = False
) -> Landmarks:
    """Read pairs of points of A and of B from a .csv, .tsv, .txt or .vts file.

    A line holds the number of a vertex of A and that of one of B, as the mesh files count them,
    from 0 (in .vts files, or if they are ``one_based``, from 1); or six coordinates, x, y, z on A
    and x, y, z on B, in the units of the meshes, which are brought onto the surfaces. A line of
    names on top may call further columns ``name``, ``weight`` and ``curve``, and those of places in
    another order by surface and axis, such as ``b`` or ``x_b``; without it one more column of words
    is the curve. Numbers that fit better if counted the other way give a warning.

    The lines of a curve, in their order, are points along it; A may have more of them than B or
    fewer, whose cells are empty then. Between them it goes straight, then onto the surface. Both
    are cut by arc length into equally many points, as many as the side with more has, ends
    included; these are landmarks, with the mean weight of its lines.

    Raises
    ------
    AbfmError
        If the file cannot be read, or a line holds no pair of points; which line, and why.
    """
    rows = _rows(path)
    try:
        single = [row for row in rows if not row.curve]
        is_vts = path.lower().endswith(".vts")
        first = int(one_based or is_vts)
        _refuse_doubles(single)
        sides = [
            _Side("A", a, [(row.number, row.a) for row in single], first),
            _Side("B", b, [(row.number, row.b) for row in single], first),
        ]
        places = [[side.places()] for side in sides]
        weights, names = [row.weight for row in single], [row.name for row in single]
        for curve in dict.fromkeys(row.curve for row in rows if row.curve):
            own = [row for row in rows if row.curve == curve]
            along_a = _Side("A", a, [(row.number, row.a) for row in own if row.a], first)
            along_b = _Side("B", b, [(row.number, row.b) for row in own if row.b], first)
            count = max(len(along_a.given), len(along_b.given))
            for side, found in zip((along_a, along_b), places, strict=True):
                found.append(side.along(curve, count))
            weights += [float(np.mean([row.weight for row in own]))] * count
            names += [f"{curve} {k}" for k in range(count)]
        on_a, on_b = (
            project_onto_surface(side.mesh, np.concatenate(found))
            for side, found in zip(sides, places, strict=True)
        )
        if not is_vts and len(rows) == len(single) and len(rows[0].a) == 1:
            of_a, of_b = np.array([[*row.a, *row.b] for row in rows]).astype(np.int64).T
            warn_of_numbering(a, b, of_a, of_b, first)
        return Landmarks(on_a, on_b, np.array(weights), tuple(names))
    except AbfmError as error:
        raise AbfmError(f"landmarks {brief(path)}: {error}") from None


class _Side(NamedTuple):
    """What rows of a file say of one surface."""

    which: str
    mesh: TriangleMesh
    given: list[tuple[int, tuple[float, ...]]]  # numbers of rows, and their cells
    first: int  # the number of the first vertex

    def places(self) -> FloatArray:
        """Return the points on the surface, (P, 3)."""
        found = np.array([self._place(*row) for row in self.given]).reshape(-1, 3)
        near = project_onto_surface(self.mesh, found)
        gaps = near.distances_from(found) / self.mesh.length_scale
        if len(gaps) and gaps.max() > _DISTANCE_MAX:
            row = self.given[int(gaps.argmax())][0]
            raise AbfmError(
                f"the point of {self.which} in row {row} is {gaps.max():.3g} sqrt(area) away from "
                f"the surface; expected at most {_DISTANCE_MAX:g}: are coordinates in the mesh's "
                "units?"
            )
        return near.positions

    def along(self, curve: str, count: int) -> FloatArray:
        """Return points (count, 3) at equal distances along a curve through the points."""
        through = self.places()
        if len(through) < 2:
            raise AbfmError(
                f"curve {brief(curve)} has {len(through)} points on {self.which}; expected 2 or "
                "more"
            )
        share = np.linspace(0, 1, _CURVE_PLACES, endpoint=False)[:, None]
        straight = through[:-1, None] + share * np.diff(through, axis=0)[:, None]
        line = np.concatenate([straight.reshape(-1, 3), through[-1:]])
        line = project_onto_surface(self.mesh, line).positions
        length = np.append(0, np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1)))
        if not length[-1] > 0:
            raise AbfmError(
                f"curve {brief(curve)} has no length on {self.which}: give points that differ"
            )
        at = np.linspace(0, length[-1], count)
        return np.stack([np.interp(at, length, line[:, x]) for x in range(3)], axis=1)

    def _place(self, row: int, cells: tuple[float, ...]) -> FloatArray:
        if len(cells) == 3:
            return np.array(cells)
        number = cells[0]
        if number != int(number) or abs(number) > _VERTEX_NUMBER_MAX:
            raise AbfmError(
                f"row {row} has {number:g} for the vertex of {self.which}; expected a whole number"
            )
        try:
            vertex = self.mesh.local_vertex(int(number) - self.first)
        except AbfmError as error:
            raise AbfmError(
                f"row {row} has {number:g} for the vertex of {self.which}, counted from "
                f"{self.first}: {error}"
            ) from None
        return np.asarray(self.mesh.vertices[vertex])


def _rows(path: str) -> list[_LandmarkRow]:
    """Read what the lines of the file say."""
    with reported(path, "landmarks"):
        opened = open_file(path)
        if opened.format is not Format.TABLE:
            raise ValueError(f"it is {opened.format}; expected a table: .csv, .tsv, .txt or .vts")
        table = rows_of(opened.data, comments="#")
        rows = list(table.cells)
        if not rows:
            raise ValueError("it is empty")
        columns = _columns(rows[0], table.number)
        body = rows[1:] if columns.named else rows
        if not body:
            raise ValueError("it has only a line of names; expected pairs of points below it")
        return [columns.read(number, cells) for number, cells in enumerate(body, start=1)]


class _Columns(NamedTuple):
    """Which column is what."""

    named: bool  # whether the first line says it
    places: list[int]
    others: dict[str, int]  # by `_WORDS`
    width: int  # how many there are
    parse: Callable[[str], float]

    def read(self, number: int, cells: list[str]) -> _LandmarkRow:
        if len(cells) != self.width:
            raise AbfmError(f"row {number} has {len(cells)} cells; expected {self.width}")
        texts = {word: cells[k].strip() for word, k in self.others.items()}
        half = len(self.places) // 2
        sides = []
        for which, part in (("A", self.places[:half]), ("B", self.places[half:])):
            given = [cells[k].strip() for k in part]
            if not any(given) and texts.get("curve"):
                sides.append(tuple[float, ...]())
            else:
                sides.append(
                    tuple(self.number(text, number, f"a place on {which}") for text in given)
                )
        if not any(sides):
            raise AbfmError(f"row {number} has no point; expected one of A, of B, or both")
        weight = texts.get("weight", "")
        return _LandmarkRow(
            number,
            sides[0],
            sides[1],
            texts.get("name") or str(number - 1),
            self.number(weight, number, "the weight") if weight else 1.0,
            texts.get("curve", ""),
        )

    def number(self, text: str, row: int, what: str) -> float:
        try:
            found = self.parse(text)
        except ValueError:
            found = math.nan
        if not math.isfinite(found):
            raise AbfmError(f"row {row} has {brief(text)} for {what}; expected a finite number")
        return found


def by_surface(names: list[str], places: list[int]) -> list[int]:
    """Return columns in the order A, B if their names have a surface, and an axis if they are six,
    such as ``target`` or ``x_b``; otherwise as they are.
    """
    found = {}
    for k in places:
        words = re.findall("[a-z]+", names[k].lower())
        surface = "".join(_SURFACES[word] for word in words if word in _SURFACES)
        found[surface + "".join(word for word in words if word in ("x", "y", "z"))] = k
    wanted = [side + axis for side in "ab" for axis in ("xyz" if len(places) == 6 else [""])]
    return [found[each] for each in wanted] if sorted(found) == wanted else places


def _columns(first: list[str], parse: Callable[[str], float]) -> _Columns:
    """Tell by the first line what the columns are."""
    count = len(first)
    has_index = not first[0] and count > 1 and not any(not c or is_number(c) for c in first[1:])
    if has_index:  # as pandas writes
        first = ["index", *first[1:]]
    if is_number(first[0]) or not first[0].strip():
        others = {"curve": count - 1} if count in (3, 7) and not is_number(first[-1]) else {}
        named = False
    else:
        names = [name.strip().lower() for name in first]
        others = {word: names.index(word) for word in _WORDS if word in names}
        named = True
    places = [k for k in range(has_index, count) if k not in others.values()]
    if named:
        places = by_surface(first, places)
    is_doubled = len(places) == 12  # numbers with decimal commas between commas
    if len(places) not in (2, 6):
        raise AbfmError(
            f"it has {len(places)} columns of numbers; expected 2 (a vertex of A, a vertex of B) "
            "or 6 (x, y, z on A, x, y, z on B); name others in the first line: "
            f"{', '.join(_WORDS)}" + "; commas separate them, and are not decimal" * is_doubled
        )
    return _Columns(named, places, others, count, parse)


def _refuse_doubles(rows: list[_LandmarkRow]) -> None:
    """Refuse a place that belongs to two."""
    for which, places in (("A", [row.a for row in rows]), ("B", [row.b for row in rows])):
        seen: dict[tuple[float, ...], int] = {}
        for row, place in zip(rows, places, strict=True):
            if place in seen:
                raise AbfmError(
                    f"rows {seen[place]} and {row.number} have the same point of {which}; expected "
                    "one partner for each"
                )
            seen[place] = row.number
