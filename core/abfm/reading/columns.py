"""Values at vertices as files hold them, and the rule by which they become columns of a mesh."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from abfm.errors import brief, did_you_mean, one_line
from abfm.numerics.real_numbers import as_float64
from abfm.reading.labels import NO_LABEL, Color, Labels
from abfm.types import FloatArray, IntArray

_VERTEX_NAMES = (
    *("vertex", "vertexid", "vertexindex", "node", "nodeid", "nodeindex", "pointid", "index"),
)
_UNNAMED_COLUMNS = ("", "unnamed:0")  # what pandas and R call the column of row names
_AXES_MAX = 3
_LABELS_ADVICE = (
    "it holds labels, which cannot be interpolated: use label=NAME for the place of one, abfm "
    "apply --labels to transfer them, or abfm.functions.read_labels"
)


class Numbering(Protocol):
    """What placing values needs of a mesh; see `TriangleMesh`."""

    @property
    def vertex_ids(self) -> IntArray: ...

    @property
    def file_vertex_count(self) -> int: ...

    def local_vertices(self, numbers: NDArray[Any], /) -> IntArray: ...

    def restrict(self, values: NDArray[Any], /) -> NDArray[Any]: ...


class Keys(NamedTuple):
    """Names and colours of the keys in a column of labels."""

    names: Mapping[int, str]
    colors: Mapping[int, Color]


@dataclass(frozen=True, eq=False)
class Columns:
    """Values of a file, before or after they are placed on a mesh.

    Attributes
    ----------
    values : array of real numbers
        With ``vertices`` (n, C), a row for each of them. Otherwise up to three axes, of which any
        may be the vertices.
    names : tuple of str
        Names of the columns, the last axis; empty if the file has none.
    numbers : tuple of str
        Numbers by which columns are chosen; empty for 0, 1, 2, ...
    keys : tuple of `Keys` or None
        For each column what its keys mean, None for values; empty if no column holds labels.
    vertices : (n,) array of int, optional
        Vertices that the rows belong to, counted from 0; none is repeated.
    vertex_count : int, optional
        Number of vertices of the surface that the file belongs to, if it gives one.
    structure : str
        "L", "R", or empty if the file does not name a hemisphere.
    frames_first : bool
        Whether the first axis of a sequence is the frames, if both axes may be the vertices.
    times : (T,) array, optional
        Seconds of the columns.
    notes : tuple of str
        What a user should know.
    """

    values: NDArray[Any]
    names: tuple[str, ...] = ()
    numbers: tuple[str, ...] = ()
    keys: tuple[Keys | None, ...] = ()
    vertices: IntArray | None = None
    vertex_count: int | None = None
    structure: str = ""
    frames_first: bool = False
    times: FloatArray | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.values.dtype.kind not in "biuf" or not 1 <= self.values.ndim <= _AXES_MAX:
            raise ValueError(
                f"it is an array of {self.values.dtype} of shape {self.values.shape}; expected "
                "real numbers, one per vertex in each column"
            )
        if self.vertices is not None and len(np.unique(self.vertices)) < len(self.vertices):
            known, counts = np.unique(self.vertices, return_counts=True)
            raise ValueError(f"it has {counts.max()} values of vertex {known[counts.argmax()]}")

    def table(self) -> FloatArray:
        """Return rows as the file has them, (n, C)."""
        return as_float64(self.values.reshape(len(self.values), -1))

    def on(self, mesh: Numbering) -> Columns:
        """Return columns (V, C) with one row for each vertex of the mesh.

        Rows that name their vertex are placed there, and missing vertices become NaN. Otherwise
        the first axis with as many entries as the mesh or its file has vertices is the vertices.

        Raises
        ------
        ValueError
            If the values do not fit the mesh.
        """
        found = self.by_vertex()
        if found.vertices is not None:
            return found._placed(mesh, found.vertices)
        shape, counts = found.values.shape, counts_of(mesh)
        axis = vertex_axis(shape, counts, 0)
        if shape[axis] not in counts:
            sizes = " x ".join(map(str, shape)) + " values" * (len(shape) == 1)
            if len(shape) == 2:
                sizes = f"{shape[0]} rows and {shape[1]} columns"
            hint = ""
            if shape[0] in [size + 1 for size in counts]:
                hint = "; its first line may be names that are numbers"
            elif {2 * size for size in counts} & {*shape}:
                hint = "; if it holds both hemispheres, give the half of this one"
            raise ValueError(
                f"it has {sizes}, and the mesh {counts[1]} vertices: use one value per vertex{hint}"
            )
        table = np.moveaxis(found.values, axis, 0)
        table = mesh.restrict(as_float64(table.reshape(len(table), -1)))
        known, count = len(found.names or found.numbers), table.shape[1]
        if known and (known != count or (axis and count > 1)):  # those of another axis
            names = found.names if len(found.names) == 1 else ()
            parts = tuple(f"{name}[{k}]" for name in names for k in range(count))
            return replace(found, values=table, names=parts, keys=(), numbers=parts)
        return replace(found, values=table)

    def by_vertex(self) -> Columns:
        """Return columns without the one that names the vertices, which places the others.

        It is called vertex, node or index, or Vertex ID and the like, or is the unnamed first one.
        """
        place = self._place_of_vertices()
        if place is None:
            return self
        column, unnamed = self.values[:, place], _plain(self.names[place]) in _UNNAMED_COLUMNS
        if not np.array_equal(column, np.rint(column)) or (np.abs(column) > 2**53).any():
            if unnamed or _plain(self.names[place]) == "index":
                return self  # values of that name
            raise ValueError(
                f"its column {brief(self.names[place])} is not whole numbers of vertices"
            )
        vertices, count = column.astype(np.int64), len(column)
        rest = [k for k in range(len(self.names)) if k != place]
        in_order = np.array_equal(vertices, np.arange(count))
        if unnamed and not in_order and vertices.min() != 0:
            if not np.array_equal(vertices, np.arange(1, count + 1)):
                raise ValueError(
                    "its first column has no name, and it is not clear whether it counts vertices "
                    "from 0 or from 1: call it vertex and count from 0, or remove it"
                )
            in_order = True
        return replace(self._only(rest), vertices=None if in_order and unnamed else vertices)

    def _place_of_vertices(self) -> int | None:
        if self.vertices is not None or self.values.ndim != 2 or len(self.names) < 2:
            return None
        plain = [_plain(name) for name in self.names]
        found = next((name for name in _VERTEX_NAMES if name in plain), None)
        if found is None:
            return 0 if plain[0] in _UNNAMED_COLUMNS else None
        if plain.count(found) > 1:
            raise ValueError(
                f"it has {plain.count(found)} columns called {found}; rename all but one"
            )
        return plain.index(found)

    def _placed(self, mesh: Numbering, vertices: IntArray) -> Columns:
        count = mesh.file_vertex_count
        if self.vertex_count not in (None, count):
            raise ValueError(
                f"it belongs to a surface of {self.vertex_count} vertices, and the mesh has {count}"
            )
        wrong = vertices[(vertices < 0) | (vertices >= count)]
        if len(wrong):
            from_one = vertices.min() == 1 and vertices.max() == count
            raise ValueError(
                f"it has a value of vertex {wrong[0]}, and the mesh has {count} vertices, counted "
                "from 0: " + ("subtract 1" if from_one else "use the values of this surface")
            )
        order = np.argsort(vertices)[::-1]  # of merged vertices the first one counts
        rows = mesh.local_vertices(vertices[order])
        if len(rows) and (rows < 0).all():
            raise ValueError("it has no value at a vertex of the mesh that is in a face")
        given = self.table()
        table = np.full((len(mesh.vertex_ids), given.shape[1]), np.nan)
        table[rows[rows >= 0]] = given[order[rows >= 0]]
        return replace(self, values=table, vertices=None)

    def number_of(self, column: str | None) -> int:
        """Return the place of a column by its name or number; None chooses the only one.

        Raises
        ------
        ValueError
            If there is no such column, or several have the name.
        """
        count = math.prod(self.values.shape[1:])
        numbers = self.numbers or tuple(map(str, range(count)))
        if column is None and count == 1:
            return 0
        named = [
            number for number, name in zip(numbers, self.names, strict=False) if name == column
        ]
        if len(named) > 1:
            raise ValueError(
                f"{len(named)} of its columns are called {brief(column)}; choose one by its "
                f"number: column={' or '.join(named[:8])}"
            )
        word = str(int(column)) if column and len(column) < 10 and column.isdecimal() else column
        chosen = named[0] if named else word
        if count == 1 and chosen == "0":
            return 0  # whatever the number of its array
        if chosen in numbers:
            return numbers.index(chosen)
        once = [name for name in self.names if name and self.names.count(name) == 1]
        listed = f" or one of {', '.join(one_line(name, 30) for name in once[:8])}" if once else ""
        missing = "" if column is None else f", none called {brief(column)}"
        missing += did_you_mean(column, self.names) if column else ""
        dense = numbers == tuple(map(str, range(count)))
        by_number = f"0 to {count - 1}" if dense else " or ".join(numbers[:8])
        raise ValueError(f"it has {count} columns{missing}; choose column={by_number}{listed}")

    def of_values(self) -> Columns:
        """Return the columns that hold no labels, or raise a ValueError if all do."""
        if not any(self.keys):
            return self
        kept = [k for k, keys in enumerate(self.keys) if keys is None]
        if not kept:
            raise ValueError(_LABELS_ADVICE)
        return self._only(kept)

    def of_labels(self) -> Columns:
        """Return the columns that hold labels, or raise a ValueError if none does."""
        kept = [k for k, keys in enumerate(self.keys) if keys is not None]
        if not kept:
            raise ValueError("it holds values, without names of labels")
        return self._only(kept)

    def labels(self, column: str | int | None = None) -> Labels:
        """Return one column of labels, by its name, number or place; vertices without one have the
        key `NO_LABEL`.
        """
        place = column if isinstance(column, int) else self.number_of(column)
        values = self.values.reshape(len(self.values), -1)[:, place]
        known = ~np.isnan(values) if values.dtype.kind == "f" else np.ones(len(values), dtype=bool)
        with np.errstate(invalid="ignore"):
            keys = np.where(known, values, NO_LABEL).astype(np.int64)
        if not np.array_equal(keys[known], values[known]):
            raise ValueError("a key is not a whole number")
        meaning = self.keys[place] if self.keys else None
        return Labels(keys, *(meaning or ({}, {})))

    def _only(self, kept: list[int]) -> Columns:
        numbers = self.numbers or tuple(map(str, range(self.values.shape[1])))
        return replace(
            self,
            values=self.values[:, kept],
            names=tuple(self.names[k] for k in kept) if self.names else (),
            numbers=tuple(numbers[k] for k in kept),
            keys=tuple(self.keys[k] for k in kept) if self.keys else (),
        )


def names_vertices(name: str) -> bool:
    """Return whether a column or array of this name holds the vertices of the rows."""
    return _plain(name) in _VERTEX_NAMES


def counts_of(mesh: Numbering) -> tuple[int, int]:
    """Return how many vertices a mesh has, and how many its file."""
    return len(mesh.vertex_ids), mesh.file_vertex_count


def vertex_axis(shape: tuple[int, ...], counts: Collection[int], preferred: int) -> int:
    """Return which axis of an array is the vertices: the preferred one, unless only others fit."""
    fitting = [axis for axis, size in enumerate(shape) if size in counts]
    return preferred if preferred in fitting or not fitting else fitting[0]


def even_times(step: float, count: int, begin: float = 0.0) -> FloatArray | None:
    """Return seconds of columns (count,) at even steps; None unless the step is above 0."""
    is_step = step > 0 and math.isfinite(begin + step * count)
    return begin + step * np.arange(count, dtype=np.float64) if is_step else None


def _plain(name: str) -> str:
    """Return a name in small letters, without blanks, hyphens and underscores."""
    return re.sub(r"[\s_-]", "", name).lower()
