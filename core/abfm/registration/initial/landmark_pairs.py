"""Landmarks, which are pairs of corresponding points of A and B, and their files."""

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
from abfm.functions.value_files import file_errors
from abfm.io import write_csv
from abfm.maps.surface_points import SurfacePoints, project_onto_surface, vertex_points
from abfm.mesh import TriangleMesh
from abfm.numerics.real_numbers import real_numbers
from abfm.reading import Format, open_file, rows_of
from abfm.reading.text_tables import is_number
from abfm.registration.initial.vertex_numbering import warn_of_numbering
from abfm.types import FloatArray
from abfm.wording import counted

_OPTIONAL_COLUMNS = ("name", "weight", "curve")
_SURFACES = {"a": "a", "source": "a", "b": "b", "target": "b"}  # surface by word of a column name
_VERTEX_NUMBER_MAX = 1e15  # larger numbers are not vertex numbers and make long messages
_DISTANCE_MAX = 0.1  # largest distance of a point from its surface, in sqrt(area)
_CURVE_SAMPLES = 32  # points between two given points of a curve, projected onto the surface


@dataclass(frozen=True, eq=False)
class Landmarks:
    """L pairs of corresponding points of A and B.

    Attributes
    ----------
    a, b : SurfacePoints
        Points of A and of B; row i of ``a`` corresponds to row i of ``b``.
    weights : (L,) array
        Positive weights of the pairs.
    names : tuple of str
        Names of the pairs in the file, or numbers counted from 0.
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
                f"landmarks have {counted(counts[0], 'point')} of A, {counts[1]} of B, weights of "
                f"shape {weights.shape} and {counts[2]} names; expected the same number of each"
            )
        if not counts[0]:
            raise AbfmError("the list of landmarks is empty; expected at least one pair of points")
        wrong = np.flatnonzero(~((weights > 0) & np.isfinite(weights)))
        if len(wrong):
            raise AbfmError(
                f"landmark {one_line(self.names[wrong[0]], 40)} has weight {weights[wrong[0]]:g}; "
                "expected a positive number"
            )
        object.__setattr__(self, "weights", weights)

    def __len__(self) -> int:
        return len(self.names)

    @classmethod
    def of_vertices(
        cls, a: TriangleMesh, b: TriangleMesh, of_a: ArrayLike, of_b: ArrayLike
    ) -> Landmarks:
        """Return pairs of vertices of A (L,) and of B (L,), given by their rows in the meshes."""
        points = vertex_points(a, of_a), vertex_points(b, of_b)
        count = len(points[0].faces)
        return cls(*points, np.ones(count), tuple(map(str, range(count))))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the coordinates to a .csv file that `read_landmarks` reads.

        An interrupted call leaves no partial file. Raises ResultError if the file cannot be
        written.
        """
        coordinates = np.concatenate([self.a.positions, self.b.positions], axis=1)
        axes = [f"{axis}_{side}" for side in "ab" for axis in "xyz"]
        cells = zip(coordinates.tolist(), self.weights.tolist(), self.names, strict=True)
        rows = ([*row, weight, name] for row, weight, name in cells)
        write_csv(path, [[*axes, "weight", "name"], *rows])


class _LandmarkRow(NamedTuple):
    number: int  # counted from 1, without empty rows
    a: tuple[float, ...]  # vertex number or coordinates; empty if the cells are empty
    b: tuple[float, ...]
    name: str
    weight: float
    curve: str


def read_landmarks(
    a: TriangleMesh, b: TriangleMesh, path: str, one_based: bool = False
) -> Landmarks:
    """Read pairs of points of A and B from a .csv, .tsv, .txt or .vts file.

    A line has one of two forms:

    - A vertex number of A and one of B, as the mesh files count them. The first vertex is 0, or 1
      in .vts files or with ``one_based``.
    - Six coordinates, x, y, z on A and x, y, z on B, in the units of the meshes. They are projected
      onto the surfaces.

    An optional first line names the columns. It may name additional columns ``name``, ``weight``
    and ``curve``. It may also change the order of the other columns, by surface and axis such as
    ``b`` or ``x_b``. Without that line, one additional column of words is the curve. A warning is
    issued if vertices seem to be counted from 1 instead of 0, or from 0 instead of 1.

    The lines with the same curve are points along it, in their order. The numbers of points on A
    and B may differ; the cells of missing points are empty. The curve is piecewise linear between
    the points and then projected onto the surface. Both curves are divided by arc length into the
    same number of landmarks, that of the side with more points. The landmarks include the ends and
    have the mean weight of the lines.

    Raises
    ------
    AbfmError
        If the file cannot be read or a line has no pair of points. The message names the line.
    """
    rows = _rows(path)
    try:
        single = [row for row in rows if not row.curve]
        is_vts = path.lower().endswith(".vts")
        first = int(one_based or is_vts)
        _refuse_duplicates(single)
        sides = [
            _Side("A", a, [(row.number, row.a) for row in single], first),
            _Side("B", b, [(row.number, row.b) for row in single], first),
        ]
        positions = [[side.positions()] for side in sides]
        weights, names = [row.weight for row in single], [row.name for row in single]
        for curve in dict.fromkeys(row.curve for row in rows if row.curve):
            on_curve = [row for row in rows if row.curve == curve]
            along_a = _Side("A", a, [(row.number, row.a) for row in on_curve if row.a], first)
            along_b = _Side("B", b, [(row.number, row.b) for row in on_curve if row.b], first)
            count = max(len(along_a.given), len(along_b.given))
            for side, found in zip((along_a, along_b), positions, strict=True):
                found.append(side.along(curve, count))
            weights += [float(np.mean([row.weight for row in on_curve]))] * count
            names += [f"{curve} {k}" for k in range(count)]
        on_a, on_b = (
            project_onto_surface(side.mesh, np.concatenate(found))
            for side, found in zip(sides, positions, strict=True)
        )
        if not is_vts and len(rows) == len(single) and len(rows[0].a) == 1:
            of_a, of_b = np.array([[*row.a, *row.b] for row in rows]).astype(np.int64).T
            warn_of_numbering(a, b, of_a, of_b, first)
        return Landmarks(on_a, on_b, np.array(weights), tuple(names))
    except AbfmError as error:
        raise AbfmError(f"landmarks {brief(path)}: {error}") from None


class _Side(NamedTuple):
    """The points of one surface in the rows of a landmark file."""

    which: str  # "A" or "B"
    mesh: TriangleMesh
    given: list[tuple[int, tuple[float, ...]]]  # row numbers and cells
    first: int  # the number of the first vertex

    def positions(self) -> FloatArray:
        """Return the points projected onto the surface, (P, 3)."""
        found = np.array([self._position(*row) for row in self.given]).reshape(-1, 3)
        projected = project_onto_surface(self.mesh, found)
        gaps = projected.distances_from(found) / self.mesh.length_scale
        if len(gaps) and gaps.max() > _DISTANCE_MAX:
            row = self.given[int(gaps.argmax())][0]
            raise AbfmError(
                f"the point of {self.which} in row {row} is {gaps.max():.3g} sqrt(area) away from "
                f"the surface; expected at most {_DISTANCE_MAX:g}. Check that the coordinates are "
                "in the units of the mesh"
            )
        return projected.positions

    def along(self, curve: str, count: int) -> FloatArray:
        """Return points at equal distances on the curve through all points, (count, 3)."""
        through = self.positions()
        if len(through) < 2:
            raise AbfmError(
                f"curve {brief(curve)} has {counted(len(through), 'point')} on {self.which}; "
                "expected at least 2"
            )
        share = np.linspace(0, 1, _CURVE_SAMPLES, endpoint=False)[:, None]
        straight = through[:-1, None] + share * np.diff(through, axis=0)[:, None]
        line = np.concatenate([straight.reshape(-1, 3), through[-1:]])
        line = project_onto_surface(self.mesh, line).positions
        length = np.append(0, np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1)))
        if not length[-1] > 0:
            raise AbfmError(
                f"curve {brief(curve)} has length 0 on {self.which}; expected different points"
            )
        at = np.linspace(0, length[-1], count)
        return np.stack([np.interp(at, length, line[:, x]) for x in range(3)], axis=1)

    def _position(self, row: int, cells: tuple[float, ...]) -> FloatArray:
        if len(cells) == 3:
            return np.array(cells)
        number = cells[0]
        if number != int(number) or abs(number) > _VERTEX_NUMBER_MAX:
            raise AbfmError(
                f"row {row} has {number:g} for the vertex of {self.which}; expected an integer"
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
    with file_errors(path, "landmarks"):
        opened = open_file(path)
        if opened.format is not Format.TABLE:
            raise ValueError(f"it is {opened.format}; expected a table: .csv, .tsv, .txt or .vts")
        table = rows_of(opened.data, comments="#")
        rows = list(table.cells)
        if not rows:
            raise ValueError("it is empty; expected pairs of points")
        columns = _columns(rows[0], table.number)
        body = rows[1:] if columns.named else rows
        if not body:
            raise ValueError("it has only a line of column names; expected pairs of points below")
        return [columns.read(number, cells) for number, cells in enumerate(body, start=1)]


class _Columns(NamedTuple):
    """The meaning of the columns of a landmark file."""

    named: bool  # whether the first line has the names
    places: list[int]  # columns of vertex numbers or coordinates
    others: dict[str, int]  # optional columns, by `_OPTIONAL_COLUMNS`
    width: int  # number of columns
    parse: Callable[[str], float]

    def read(self, number: int, cells: list[str]) -> _LandmarkRow:
        if len(cells) != self.width:
            raise AbfmError(
                f"row {number} has {counted(len(cells), 'cell')}; expected {self.width}"
            )
        texts = {word: cells[k].strip() for word, k in self.others.items()}
        half = len(self.places) // 2
        sides = []
        for which, part in (("A", self.places[:half]), ("B", self.places[half:])):
            given = [cells[k].strip() for k in part]
            if not any(given) and texts.get("curve"):
                sides.append(tuple[float, ...]())
            else:
                sides.append(
                    tuple(self.number(text, number, f"a point of {which}") for text in given)
                )
        if not any(sides):
            raise AbfmError(f"row {number} has no point; expected a point of A or of B, or both")
        name, text = texts.get("name") or str(number - 1), texts.get("weight", "")
        weight = self.number(text, number, "the weight") if text else 1.0
        return _LandmarkRow(number, sides[0], sides[1], name, weight, texts.get("curve", ""))

    def number(self, text: str, row: int, what: str) -> float:
        try:
            found = self.parse(text)
        except ValueError:
            found = math.nan
        if not math.isfinite(found):
            raise AbfmError(f"row {row} has {brief(text)} for {what}; expected a finite number")
        return found


def by_surface(names: list[str], places: list[int]) -> list[int]:
    """Return the columns of points, given by their indices ``places``, with those of A first.

    Names such as ``target`` and ``x_b`` contain a surface; of six columns they also need an axis.
    Without such names the order is unchanged.
    """
    found = {}
    for k in places:
        words = re.findall("[a-z]+", names[k].lower())
        surface = "".join(_SURFACES[word] for word in words if word in _SURFACES)
        found[surface + "".join(word for word in words if word in ("x", "y", "z"))] = k
    keys = [side + axis for side in "ab" for axis in ("xyz" if len(places) == 6 else [""])]
    return [found[key] for key in keys] if sorted(found) == keys else places


def _columns(first: list[str], parse: Callable[[str], float]) -> _Columns:
    count = len(first)
    has_index = not first[0] and count > 1 and not any(not c or is_number(c) for c in first[1:])
    if has_index:  # an unnamed index column, as pandas writes it
        first = ["index", *first[1:]]
    if is_number(first[0]) or not first[0].strip():
        others = {"curve": count - 1} if count in (3, 7) and not is_number(first[-1]) else {}
        named = False
    else:
        names = [name.strip().lower() for name in first]
        others = {name: names.index(name) for name in _OPTIONAL_COLUMNS if name in names}
        named = True
    places = [k for k in range(has_index, count) if k not in others.values()]
    if named:
        places = by_surface(first, places)
    has_decimal_commas = len(places) == 12  # decimal commas between separating commas
    if len(places) not in (2, 6):
        hint = ". Use decimal points, as commas separate columns" if has_decimal_commas else ""
        raise AbfmError(
            f"it has {counted(len(places), 'column')} of numbers; expected 2 (vertices of A and B) "
            "or 6 (x, y, z on A and on B). Name additional columns in the first line: "
            f"{', '.join(_OPTIONAL_COLUMNS)}{hint}"
        )
    return _Columns(named, places, others, count, parse)


def _refuse_duplicates(rows: list[_LandmarkRow]) -> None:
    for which, points in (("A", [row.a for row in rows]), ("B", [row.b for row in rows])):
        seen: dict[tuple[float, ...], int] = {}
        for row, point in zip(rows, points, strict=True):
            if point in seen:
                raise AbfmError(
                    f"rows {seen[point]} and {row.number} have the same point of {which}; expected "
                    "each point in one pair only"
                )
            seen[point] = row.number
