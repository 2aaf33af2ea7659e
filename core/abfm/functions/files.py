"""Functions and vertex maps read from files that count as the mesh file does."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from abfm.errors import FunctionError, brief, did_you_mean
from abfm.functions.family import WORD, Family, Spec, choice, file_name, parameter, quoted
from abfm.functions.labels import where_label
from abfm.functions.value_files import (
    columns_of,
    read_map_table,
    reported,
    request_for,
)
from abfm.maps.symmetry import KINDS, SymmetryError, detect_symmetry
from abfm.mesh import TriangleMesh
from abfm.reading import (
    FREESURFER_VALUES,
    LABELS_ENDINGS,
    VALUES_ENDINGS,
    Format,
    open_file,
)
from abfm.types import FloatArray, IntArray

_SYMMETRIC_SUFFIX = ".sym.vts"


@dataclass(frozen=True, kw_only=True)
class ValuesFile(Family):
    """Values from a file, in its own unit: one per vertex, as the mesh file counts.

    Tables, arrays of NumPy and MATLAB, GIFTI, CIFTI, and FreeSurfer's files hold them, see
    :func:`abfm.functions.read_values`. Labels are numbers with nothing between them: a function is
    where one of them is, 1 there and 0 elsewhere. So is what a .label file lists.
    """

    family = "file"
    positional = "path"
    path: str = parameter(
        file_name(*VALUES_ENDINGS, *FREESURFER_VALUES, *LABELS_ENDINGS),
        "a table, array, GIFTI, CIFTI or FreeSurfer file",
    )
    column: str | None = parameter(
        WORD, "column by its name or number, counted from 0", default=None
    )
    label: str | None = parameter(
        WORD, "of labels, the one that is 1, by its name or key; all else is 0", default=None
    )
    hemisphere: str | None = parameter(
        choice("L", "R"), "of files of both hemispheres", default=None
    )

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        side = self.hemisphere or ""
        if self.label is not None:
            return where_label(self.path, self.label, mesh, self.column, side).astype(np.float64)
        with reported(self.path):
            opened = open_file(self.path)
            request = request_for(mesh, self.column, side)
            found = columns_of(opened, request).of_values().on(mesh)
            values = found.table()[:, found.number_of(self.column)]
            if opened.format is not Format.LABEL_LIST:
                return values
            listed = ~np.isnan(values)
            return np.where(listed, 1.0 if self.column is None else values, 0.0)


@dataclass(frozen=True, kw_only=True)
class Permuted(Family):
    """Another function composed with a vertex map: ``result[i] = f[map[i]]``, in the unit of f.

    Any map of the vertices will do: ``mirror`` or ``rotation`` (by 180 degrees), the symmetry that
    :func:`abfm.maps.detect_symmetry` finds, or a file for :func:`read_vertex_map`.
    """

    family = "permuted"
    path: str = parameter(
        file_name(*VALUES_ENDINGS), "file with one vertex number per vertex; or mirror, or rotation"
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
    """Read a map of the vertices, (V,), from any file that `read_values` reads.

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
    table = read_map_table(path, mesh)
    template = Path(os.path.expanduser(path[: -len(_SYMMETRIC_SUFFIX)] + ".vts"))
    if table.shape[1] == 2:
        return _swapped(mesh, path, _local_vertices(mesh, path, table))
    if path.lower().endswith(_SYMMETRIC_SUFFIX) and template.is_file():
        points, mirrored = read_map_table(template, mesh)[:, 0], table[:, 0]
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
