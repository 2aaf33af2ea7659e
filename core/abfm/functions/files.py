"""Functions and vertex maps read from files that count as the mesh file does."""

import csv
import os
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from abfm.errors import FunctionError, brief, did_you_mean, one_line
from abfm.functions.family import WORD, Family, Spec, file_name, parameter, quoted
from abfm.functions.labels import LISTED, listed_vertices, where_label
from abfm.maps.symmetry import KINDS, SymmetryError, detect_symmetry
from abfm.mesh import TriangleMesh
from abfm.reading import (
    FREESURFER_VALUES,
    LABEL,
    array_from,
    freesurfer_kind,
    freesurfer_label,
    freesurfer_overlay,
    freesurfer_values,
    read_bytes,
    read_gifti,
)
from abfm.types import FloatArray, IntArray

_NO_NUMBER = re.compile(  # NumPy's words, which count rows from 0 and columns from 1
    r"could not convert string (?P<word>.*) to float64 at row (?P<row>\d+), column (?P<column>\d+)",
    re.DOTALL,
)
_SUFFIXES = (".npy", ".csv", ".txt", ".gii", ".gii.gz", ".mgh", ".mgz", ".vts")
_TABLES = (*_SUFFIXES, ".map")
_LABELS = (".annot", LISTED)
_SYMMETRIC = ".sym.vts"
_ARE_LABELS = (
    "it holds labels, which cannot be interpolated; give label=NAME for where one is, carry them "
    "by abfm apply --labels, or use abfm.functions.read_labels"
)


@dataclass(frozen=True, kw_only=True)
class ValuesFile(Family):
    """Values from a file, in its own unit: one per vertex, as the mesh file counts.

    It may be .npy, .csv, .txt, .gii(.gz) or FreeSurfer's. Labels, of .label.gii and .annot files,
    are numbers with nothing between them: a function is where one of them is, 1 there and 0
    elsewhere. So is what a .label file lists.
    """

    family = "file"
    positional = "path"
    path: str = parameter(
        file_name(*_SUFFIXES, *FREESURFER_VALUES, *_LABELS),
        ".npy, .csv, .txt, .gii or FreeSurfer's",
    )
    column: str | None = parameter(
        WORD, "column by its name or number, counted from 0", default=None
    )
    label: str | None = parameter(
        WORD, "of labels, the one that is 1, by its name or key; all else is 0", default=None
    )

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        if self.label is not None:
            values = where_label(self.path, self.label, self.column).astype(np.float64)
        elif self.path.lower().endswith(LISTED):
            return listed_vertices(mesh, self.path, self.column)
        else:
            values = read_column(self.path, self.column)
        try:
            return mesh.restrict(values)
        except FunctionError as error:
            raise FunctionError(f"file {brief(self.path)}: {error}") from None


@dataclass(frozen=True, kw_only=True)
class Permuted(Family):
    """Another function composed with a vertex map: ``result[i] = f[map[i]]``, in the unit of f.

    Any map of the vertices will do: ``mirror`` or ``rotation`` (by 180 degrees), the symmetry that
    :func:`abfm.maps.detect_symmetry` finds, or a file for :func:`read_vertex_map`.
    """

    family = "permuted"
    path: str = parameter(
        file_name(*_SUFFIXES), "file with one vertex number per vertex; or mirror, or rotation"
    )
    function: Spec  # given in parentheses after the path

    def __str__(self) -> str:
        return f"{self.family}:{quoted(self.path)}({self.function})"

    @property
    def is_detected(self) -> bool:
        """Whether the map is a symmetry that is looked for on the mesh, and no file."""
        return self.path in KINDS

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        return self.function.evaluate(mesh)[vertex_map(mesh, self.path)]


def read_column(path: str, column: str | None = None) -> FloatArray:
    """Read one column of numbers, (n,), of a file, or raise a FunctionError; see `read_table`.

    ``column`` is a name, or a number counted from 0, and needed where there are several.
    """
    names, table = read_table(path)
    count = table.shape[1]
    if column is None and count == 1:
        return table[:, 0]
    if column in names:
        return table[:, names.index(column)]
    if column is not None and len(column) < 10 and column.isdecimal() and int(column) < count:
        return table[:, int(column)]
    listed = f" or one of {', '.join(one_line(name, 30) for name in names[:8])}" if names else ""
    asked = "" if column is None else f", none called {brief(column)}{did_you_mean(column, names)}"
    raise FunctionError(
        f"file {brief(path)} has {count} columns{asked}; choose column=0 to {count - 1}{listed}"
    )


def read_table(path: str) -> tuple[list[str], FloatArray]:
    """Read the names of the columns, if any, and the numbers, (n, c), or raise a FunctionError.

    .npy holds an array (n,) or (n, c), no pickle. .csv, .txt, .vts and .map hold lines of
    numbers separated by commas, semicolons, tabs or blanks, with or without a line of names on top;
    empty lines and lines starting with ``#`` are skipped. .gii is GIFTI: its arrays are columns,
    named by their metadata. .mgh and .mgz are FreeSurfer's: frames are the columns. Other names
    may be of FreeSurfer's values, such as ``lh.sulc``, which are known by how they begin; .label
    lists vertices with a value each. Labels are refused: see `read_labels`.
    """
    suffix = next((suffix for suffix in _TABLES if path.lower().endswith(suffix)), None)
    file = Path(os.path.expanduser(path))
    try:
        if suffix is None:
            return _read_freesurfer(file)
        if suffix in (".csv", ".txt", ".vts", ".map"):
            return _read_text(file)
        if suffix == ".npy":
            return [], _as_table(array_from(read_bytes(file)))
        if suffix in (".mgh", ".mgz"):
            return [], freesurfer_overlay(file)
        arrays = read_gifti(file).arrays
        if not arrays:
            raise ValueError("it holds no data array")
        if any(array.intent == LABEL for array in arrays):
            raise ValueError(_ARE_LABELS)
        table = _as_table(np.column_stack([array.values for array in arrays]))
        names = [array.name for array in arrays]
        return names if any(names) and len(names) == table.shape[1] else [], table
    except OSError as error:
        raise FunctionError(f"file {brief(path)} cannot be read: {one_line(error)}") from error
    except Exception as error:  # whatever a broken file makes of the readers
        raise FunctionError(
            f"file {brief(path)} is not a table of numbers: {one_line(error)}"
        ) from error


def _read_freesurfer(file: Path) -> tuple[list[str], FloatArray]:
    """Read values of FreeSurfer's, whatever their file is called."""
    ending = file.suffix.lower()
    if ending == LISTED:
        return ["vertex", "value"], np.column_stack(freesurfer_label(file)).astype(np.float64)
    if ending == ".annot":
        raise ValueError(_ARE_LABELS)
    kind = freesurfer_kind(file)
    if kind == "values":
        return [], freesurfer_values(file).reshape(-1, 1)
    if kind:
        raise ValueError("it is a surface of FreeSurfer's; give values, such as lh.sulc")
    raise ValueError(
        f"the name must end in {', '.join(_SUFFIXES)}, or the file begin as FreeSurfer's values do"
    )


def _as_table(values: np.ndarray) -> FloatArray:
    if values.dtype.kind not in "biuf" or values.ndim not in (1, 2):
        raise ValueError(
            f"an array of {values.dtype} with shape {values.shape}; real numbers (n,) or (n, c) "
            "expected"
        )
    return values.reshape(len(values), -1).astype(np.float64)


def _text_lines(path: Path) -> tuple[list[str], str | None]:
    """Return the lines that are neither empty nor begin with ``#``, and what separates cells; None
    is blanks.
    """
    text = read_bytes(path).decode("utf-8-sig")
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    if not lines:
        raise ValueError("it is empty")
    return lines, next((sign for sign in ";,\t" if sign in lines[0]), None)


def text_rows(path: Path) -> list[list[str]]:
    """Return the cells of the lines of a text file, which may hold words; see `read_table`."""
    lines, delimiter = _text_lines(path)
    if delimiter is None:
        return [line.split() for line in lines]
    try:
        return list(csv.reader(lines, delimiter=delimiter))
    except csv.Error as error:  # which is no ValueError
        raise ValueError(str(error)) from None


def _read_text(path: Path) -> tuple[list[str], FloatArray]:
    lines, delimiter = _text_lines(path)
    names = list[str]()
    first = next(csv.reader(lines[:1], delimiter=delimiter)) if delimiter else lines[0].split()
    try:
        list(map(float, first))
    except ValueError:
        names = [name.strip() for name in first]
    rows = lines[1:] if names else lines
    if not rows:
        raise ValueError(f"it has only the line {brief(lines[0])}")
    try:
        table = np.loadtxt(rows, delimiter=delimiter, comments=None, quotechar='"', ndmin=2)
    except ValueError as error:
        found = _NO_NUMBER.match(str(error))
        raise ValueError(
            f"row {found['row']} of its numbers, counting from 0, has "
            f"{one_line(found['word'], 60)} in column "
            f"{int(found['column']) - 1}, where a number is expected"
            if found
            else str(error).partition("; use `usecols`")[0]  # which is advice to who programs
        ) from error
    return names if len(names) == table.shape[1] else [], table  # other words on top are a title


def vertex_map(mesh: TriangleMesh, name: str) -> IntArray:
    """Return the map, (V,), that a file holds, or that ``mirror`` or ``rotation`` names.

    Raises
    ------
    FunctionError
        If the mesh has no such symmetry, or the file holds no map of its vertices.
    """
    for kind in KINDS:
        if name == kind:
            try:
                return detect_symmetry(mesh, kind).vertex_map
            except SymmetryError as error:
                raise FunctionError(f"permuted:{kind}: {error}") from error
    if "." not in name:
        hint = did_you_mean(name, KINDS)
        raise FunctionError(
            f"permuted: {brief(name)} is neither {' nor '.join(KINDS)} nor the name of a file{hint}"
        )
    return read_vertex_map(mesh, name)


def read_vertex_map(mesh: TriangleMesh, path: str) -> IntArray:
    """Read a map of the vertices, (V,), from any file that `read_table` reads.

    One column, one number per vertex of the mesh file
        The vertex that each vertex is mapped to.
    Two columns
        Pairs of vertices that are mapped to each other; those in no pair are mapped to themselves.
    One column, in a file ``NAME.sym.vts`` with a file ``NAME.vts`` beside it
        As datasets for shape correspondence have them: row k of ``NAME.vts`` is the vertex of a
        template's point k, row k of ``NAME.sym.vts`` that of its mirror image. These two are mapped
        to each other, and vertices of neither file as the nearest vertex that has a partner.

    Numbers count the vertices of the mesh file, from 0 or from 1, whichever all of them fit. If
    both fit: whichever makes the map a permutation; failing that .vts files count from 1, and
    others from 0, as meshes do. A FunctionError tells what else there is, as are pairs of .txt or
    .csv that fit both ways, or two partners of a vertex.
    """
    table = read_table(path)[1]
    template = Path(os.path.expanduser(path[: -len(_SYMMETRIC)] + ".vts"))
    if table.shape[1] == 2:
        return _swapped(mesh, path, _local_vertices(mesh, path, table))
    if path.lower().endswith(_SYMMETRIC) and template.is_file():
        points, mirrored = read_column(str(template)), read_column(path)
        if len(points) != len(mirrored):
            raise FunctionError(
                f"map {brief(path)} has {len(mirrored)} lines, {brief(template.name)} has "
                f"{len(points)}"
            )
        # in both directions, the first pair of a vertex counting, and by the nearest elsewhere
        pairs = _local_vertices(mesh, path, np.column_stack([points, mirrored]))
        both = np.concatenate([pairs, pairs[:, ::-1]])
        known, first = np.unique(both[:, 0], return_index=True)
        nearest = cKDTree(mesh.vertices[known]).query(mesh.vertices)[1]
        return np.asarray(both[first[nearest], 1])
    return mapped_vertices(mesh, mesh, path, table)


def mapped_vertices(
    domain: TriangleMesh, codomain: TriangleMesh, path: str, table: FloatArray
) -> IntArray:
    """Return the vertex of the codomain that each of the domain is mapped to, (V,), by the table
    (n, 1) that a file holds, which counts as `read_vertex_map` says.
    """
    try:
        if table.shape[1] != 1:
            raise FunctionError(f"it has {table.shape[1]} columns; expected 1 or 2")
        column = domain.restrict(table[:, 0])
    except FunctionError as error:
        raise FunctionError(f"map {brief(path)}: {error}") from None
    return _local_vertices(codomain, path, column, domain.vertex_ids)


def _local_vertices(
    mesh: TriangleMesh, path: str, numbers: FloatArray, owners: IntArray | None = None
) -> IntArray:
    """Return the mesh's own numbers, in the same shape, of vertices as its file counts them; an
    error names the owner of the number.
    """
    count = mesh.file_vertex_count
    readings = [mesh.local_vertices(numbers - first) for first in (0, 1)]
    fitting = [reading for reading in readings if (reading >= 0).all()]
    if not fitting:
        wrong = readings[0] < 0
        if not (numbers == 0).any():
            wrong = min(wrong, readings[1] < 0, key=np.count_nonzero)
        row = int(np.flatnonzero(wrong.reshape(len(wrong), -1).any(axis=1))[0])
        example = numbers[row][wrong[row]][0] if numbers.ndim == 2 else numbers[row]
        place = f"line {row + 1}" if owners is None else f"vertex {owners[row]}"
        raise FunctionError(
            f"map {brief(path)}: {np.count_nonzero(wrong)} of {wrong.size} entries are not "
            "numbers of vertices in use, "
            f"0 to {count - 1}, or 1 to {count} if they count from 1 ({place} has {example:g})"
        )
    permutations = [
        r for r in fitting if numbers.ndim == 1 and len(np.unique(r)) == len(mesh.vertices)
    ]
    if len(fitting) == 1 or permutations:
        return (permutations or fitting)[0]
    suffix = path.lower().rpartition(".")[2]
    if numbers.ndim == 2 and suffix in ("txt", "csv"):
        raise FunctionError(
            f"map {brief(path)}: its pairs may count from 0 or from 1, as they have neither 0 nor "
            f"{count}; save them as .npy if they count from 0, or subtract 1 first"
        )
    return fitting[1 if suffix == "vts" else 0]


def _swapped(mesh: TriangleMesh, path: str, pairs: IntArray) -> IntArray:
    """Return the map that swaps the vertices of each pair and keeps the others."""
    both = np.unique(np.concatenate([pairs, pairs[:, ::-1]]), axis=0)
    twice = np.flatnonzero(both[1:, 0] == both[:-1, 0])
    if len(twice):
        vertex = mesh.vertex_ids[both[twice[0], 0]]
        raise FunctionError(
            f"map {brief(path)}: vertex {vertex} (counted from 0) has two partners; one is expected"
        )
    if 2 * len(both) < len(mesh.vertices):
        raise FunctionError(
            f"map {brief(path)}: its pairs name {len(both)} of {len(mesh.vertices)} vertices; give "
            "every pair, as only vertices that the symmetry leaves in place may be left out"
        )
    found = np.arange(len(mesh.vertices))
    found[both[:, 0]] = both[:, 1]
    return found
