"""Columns of values from files, and their assignment to the vertices of a mesh."""

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
from abfm.wording import counted

_VERTEX_NAMES = (
    *("vertex", "vertexid", "vertexindex", "node", "nodeid", "nodeindex", "pointid", "index"),
)
_UNNAMED_COLUMNS = ("", "unnamed:0")  # names that R and pandas write for the column of row names
_AXES_MAX = 3
_LABELS_ADVICE = (
    "the data are labels, which cannot be used as values. Use label=NAME for the region of a "
    "label, abfm apply --labels to transfer labels, or abfm.functions.read_labels"
)


class Numbering(Protocol):
    """The part of `TriangleMesh` that `Columns` need to assign rows of a file to vertices."""

    @property
    def vertex_ids(self) -> IntArray: ...

    @property
    def file_vertex_count(self) -> int: ...

    def local_vertices(self, numbers: NDArray[Any], /) -> IntArray: ...

    def restrict(self, values: NDArray[Any], /) -> NDArray[Any]: ...


class Keys(NamedTuple):
    """Names and colours by key, for a column of labels."""

    names: Mapping[int, str]
    colors: Mapping[int, Color]


@dataclass(frozen=True, eq=False)
class Columns:
    """Values of a file, before or after they are assigned to the vertices of a mesh.

    If ``vertices`` is not None, ``values`` are (n, C): a row for each of these vertices. Otherwise
    they have up to three axes, of which any may be the vertices.
    """

    values: NDArray[Any]
    names: tuple[str, ...] = ()  # names of the columns (the last axis); empty if the file has none
    numbers: tuple[str, ...] = ()  # numbers that choose columns; empty for 0, 1, 2, ...
    # labels of each column, None for a column of values; empty if no column has labels
    keys: tuple[Keys | None, ...] = ()
    vertices: IntArray | None = None  # (n,), vertices of the rows, from 0, without repetitions
    vertex_count: int | None = None  # number of vertices of the surface, if the file has it
    structure: str = ""  # "L", "R", or empty if the file does not name a hemisphere
    frames_first: bool = False  # first axis is that of frames if both axes fit the vertices
    times: FloatArray | None = None  # (T,), times of the columns in seconds
    notes: tuple[str, ...] = ()  # notes for the user

    def __post_init__(self) -> None:
        if self.values.dtype.kind not in "biuf" or not 1 <= self.values.ndim <= _AXES_MAX:
            raise ValueError(
                f"the values have type {self.values.dtype} and shape {self.values.shape}; expected "
                "real numbers, one per vertex in each column"
            )
        if self.vertices is not None and len(np.unique(self.vertices)) < len(self.vertices):
            unique, counts = np.unique(self.vertices, return_counts=True)
            raise ValueError(
                f"vertex {unique[counts.argmax()]} has {counts.max()} values; expected one"
            )

    def table(self) -> FloatArray:
        """Return the values as a table (n, C) with the rows of the file."""
        return as_float64(self.values.reshape(len(self.values), -1))

    def on(self, mesh: Numbering) -> Columns:
        """Return columns (V, C) with one row for each vertex of the mesh.

        If rows have vertex numbers, other vertices get NaN. Otherwise the axis of the vertices is
        the first one whose size is the number of vertices of the mesh or its file. Raises
        ValueError if the values do not fit the mesh.
        """
        found = self.by_vertex()
        if found.vertices is not None:
            return found._placed(mesh, found.vertices)
        shape, counts = found.values.shape, counts_of(mesh)
        axis = vertex_axis(shape, counts, 0)
        if shape[axis] not in counts:
            sizes = " x ".join(map(str, shape)) + (" value" if shape == (1,) else " values")
            if len(shape) == 2:
                sizes = f"{counted(shape[0], 'row')} and {counted(shape[1], 'column')}"
            hint = ""
            if shape[0] in [size + 1 for size in counts]:
                hint = "; the first line may be names that look like numbers"
            elif {2 * size for size in counts} & {*shape}:
                hint = "; if these are both hemispheres, use the half of this one"
            raise ValueError(
                f"the data have {sizes}, but the mesh has {counts[1]} vertices. Use one value per "
                f"vertex{hint}"
            )
        table = np.moveaxis(found.values, axis, 0)
        table = mesh.restrict(as_float64(table.reshape(len(table), -1)))
        named_count, count = len(found.names or found.numbers), table.shape[1]
        if named_count and (named_count != count or (axis and count > 1)):
            # the names are those of another axis
            names = found.names if len(found.names) == 1 else ()
            parts = tuple(f"{name}[{k}]" for name in names for k in range(count))
            return replace(found, values=table, names=parts, keys=(), numbers=parts)
        return replace(found, values=table)

    def by_vertex(self) -> Columns:
        """Convert the column of vertex numbers, if there is one, to the attribute ``vertices``.

        It is named vertex, node, index, Vertex ID or similar, or is the first one and has no name.
        """
        place = self._place_of_vertices()
        if place is None:
            return self
        column, unnamed = self.values[:, place], _normalized(self.names[place]) in _UNNAMED_COLUMNS
        if not np.array_equal(column, np.rint(column)) or (np.abs(column) > 2**53).any():
            if unnamed or _normalized(self.names[place]) == "index":
                return self  # the column has other values, in spite of its name
            raise ValueError(
                f"the column {brief(self.names[place])} has numbers that are not integers; "
                "expected vertex numbers"
            )
        vertices, count = column.astype(np.int64), len(column)
        rest = [k for k in range(len(self.names)) if k != place]
        in_order = np.array_equal(vertices, np.arange(count))
        if unnamed and not in_order and vertices.min() != 0:
            if not np.array_equal(vertices, np.arange(1, count + 1)):
                raise ValueError(
                    "the first column has no name, and may count vertices from 0 or from 1. Name "
                    "it vertex and count from 0, or remove it"
                )
            in_order = True
        return replace(self._only(rest), vertices=None if in_order and unnamed else vertices)

    def _place_of_vertices(self) -> int | None:
        if self.vertices is not None or self.values.ndim != 2 or len(self.names) < 2:
            return None
        names = [_normalized(name) for name in self.names]
        found = next((name for name in _VERTEX_NAMES if name in names), None)
        if found is None:
            return 0 if names[0] in _UNNAMED_COLUMNS else None
        if names.count(found) > 1:
            raise ValueError(f"{names.count(found)} columns are named {found}. Rename all but one")
        return names.index(found)

    def _placed(self, mesh: Numbering, vertices: IntArray) -> Columns:
        count = mesh.file_vertex_count
        if self.vertex_count not in (None, count):
            raise ValueError(
                f"the values belong to a surface of {self.vertex_count} vertices, but the mesh has "
                f"{count}. Use the values of this surface"
            )
        wrong = vertices[(vertices < 0) | (vertices >= count)]
        if len(wrong):
            from_one = vertices.min() == 1 and vertices.max() == count
            raise ValueError(
                f"there is a value of vertex {wrong[0]}, but the mesh has {count} vertices, "
                "counted from 0. " + ("Subtract 1" if from_one else "Use values of this surface")
            )
        order = np.argsort(vertices)[::-1]  # the first of merged vertices overwrites the others
        rows = mesh.local_vertices(vertices[order])
        if len(rows) and (rows < 0).all():
            raise ValueError("the only values are those of vertices that no face of the mesh uses")
        values = self.table()
        table = np.full((len(mesh.vertex_ids), values.shape[1]), np.nan)
        table[rows[rows >= 0]] = values[order[rows >= 0]]
        return replace(self, values=table, vertices=None)

    def number_of(self, column: str | None) -> int:
        """Return the index of a column by its name or number; None chooses the only column.

        Raises ValueError if there is no such column, or if several have the name.
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
                f"{len(named)} columns are named {brief(column)}. Choose one by its number: "
                f"column={' or '.join(named[:8])}"
            )
        word = str(int(column)) if column and len(column) < 10 and column.isdecimal() else column
        chosen = named[0] if named else word
        if count == 1 and chosen == "0":
            return 0  # the only column, whatever the number of its array
        if chosen in numbers:
            return numbers.index(chosen)
        once = [name for name in self.names if name and self.names.count(name) == 1]
        listed = f" or one of {', '.join(one_line(name, 30) for name in once[:8])}" if once else ""
        missing = "" if column is None else f", but none named {brief(column)}"
        missing += did_you_mean(column, self.names) if column else ""
        dense = numbers == tuple(map(str, range(count)))
        by_number = f"0 to {count - 1}" if dense and count > 1 else " or ".join(numbers[:8])
        columns = counted(count, "column")
        raise ValueError(f"the data have {columns}{missing}. Choose column={by_number}{listed}")

    def of_values(self) -> Columns:
        """Return the columns of values, without those of labels; ValueError if there are none."""
        if not any(self.keys):
            return self
        chosen = [k for k, keys in enumerate(self.keys) if keys is None]
        if not chosen:
            raise ValueError(_LABELS_ADVICE)
        return self._only(chosen)

    def of_labels(self) -> Columns:
        """Return the columns of labels, without those of values; ValueError if there are none."""
        chosen = [k for k, keys in enumerate(self.keys) if keys is not None]
        if not chosen:
            raise ValueError("the data are values; expected labels with names")
        return self._only(chosen)

    def labels(self, column: str | int | None = None) -> Labels:
        """Return one column of labels, by its name, number or index.

        Vertices without a label have the key `NO_LABEL`.
        """
        place = column if isinstance(column, int) else self.number_of(column)
        values = self.values.reshape(len(self.values), -1)[:, place]
        is_label = (
            ~np.isnan(values) if values.dtype.kind == "f" else np.ones(len(values), dtype=bool)
        )
        with np.errstate(invalid="ignore"):
            keys = np.where(is_label, values, NO_LABEL).astype(np.int64)
        if not np.array_equal(keys[is_label], values[is_label]):
            raise ValueError("a label is not an integer; expected integer labels")
        names_and_colors = self.keys[place] if self.keys else None
        return Labels(keys, *(names_and_colors or ({}, {})))

    def _only(self, chosen: list[int]) -> Columns:
        numbers = self.numbers or tuple(map(str, range(self.values.shape[1])))
        return replace(
            self,
            values=self.values[:, chosen],
            names=tuple(self.names[k] for k in chosen) if self.names else (),
            numbers=tuple(numbers[k] for k in chosen),
            keys=tuple(self.keys[k] for k in chosen) if self.keys else (),
        )


def names_vertices(name: str) -> bool:
    """Return whether a column or array of this name has vertex numbers."""
    return _normalized(name) in _VERTEX_NAMES


def counts_of(mesh: Numbering) -> tuple[int, int]:
    """Return the numbers of vertices of a mesh and of the file that it is read from."""
    return len(mesh.vertex_ids), mesh.file_vertex_count


def vertex_axis(shape: tuple[int, ...], counts: Collection[int], preferred: int) -> int:
    """Return the axis of an array whose size is one of ``counts``, numbers of vertices.

    It is the ``preferred`` one, or else the first. If there is none, it is the ``preferred`` one.
    """
    fitting = [axis for axis, size in enumerate(shape) if size in counts]
    return preferred if preferred in fitting or not fitting else fitting[0]


def even_times(step: float, count: int, begin: float = 0.0) -> FloatArray | None:
    """Return evenly spaced times (count,) in seconds; None unless they are finite and increase."""
    is_step = step > 0 and math.isfinite(begin + step * count)
    return begin + step * np.arange(count, dtype=np.float64) if is_step else None


def _normalized(name: str) -> str:
    """Return a name in lower case, without blanks, hyphens and underscores."""
    return re.sub(r"[\s_-]", "", name).lower()
