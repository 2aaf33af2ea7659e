"""Functions and vertex maps from files that number vertices like the mesh file."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from abfm.errors import FunctionError, brief, did_you_mean
from abfm.functions.family import WORD, Family, Wrapper, choice, file_name, parameter, quoted
from abfm.functions.labels import has_label
from abfm.functions.value_files import columns_of, file_errors, read_map_table, request_for
from abfm.maps.symmetry import KINDS, SymmetryError, detect_symmetry
from abfm.mesh import TriangleMesh
from abfm.reading import FREESURFER_VALUES, LABELS_ENDINGS, VALUES_ENDINGS, Format, open_file
from abfm.types import FloatArray, IntArray
from abfm.wording import counted

_SYMMETRIC_SUFFIX = ".sym.vts"


@dataclass(frozen=True, kw_only=True)
class ValuesFile(Family):
    """Values from a file, one for each vertex of the mesh file, in the unit of the file.

    The file may be a table, or an array of NumPy, MATLAB, GIFTI, CIFTI or FreeSurfer; see
    :func:`abfm.functions.read_values`. For a label of a file of labels, the function is 1 where
    vertices have the label, and 0 elsewhere. For a .label file, it is 1 at the listed vertices.
    """

    family = "file"
    positional = "path"
    path: str = parameter(
        file_name(*VALUES_ENDINGS, *FREESURFER_VALUES, *LABELS_ENDINGS),
        "table, array, GIFTI, CIFTI or FreeSurfer file",
    )
    column: str | None = parameter(
        WORD, "column by its name or number, counted from 0", default=None
    )
    label: str | None = parameter(
        WORD, "for a file of labels: name or key of the label where the function is 1", default=None
    )
    hemisphere: str | None = parameter(
        choice("L", "R"), "hemisphere in a file of both", default=None, empty="auto"
    )

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        side = self.hemisphere or ""
        if self.label is not None:
            return has_label(self.path, self.label, mesh, self.column, side).astype(np.float64)
        with file_errors(self.path):
            opened = open_file(self.path)
            request = request_for(mesh, self.column, side)
            found = columns_of(opened, request).of_values().on(mesh)
            values = found.table()[:, found.number_of(self.column)]
            if opened.format is not Format.LABEL_LIST:
                return values
            return np.where(np.isnan(values), 0.0, 1.0 if self.column is None else values)


@dataclass(frozen=True, kw_only=True)
class Permuted(Wrapper):
    """Another function composed with a vertex map: ``result[i] = f[map[i]]``, in the unit of f.

    The map is a file for :func:`read_vertex_map`, or a symmetry that
    :func:`abfm.maps.detect_symmetry` finds: ``mirror`` or ``rotation`` (by 180 degrees).
    """

    family = "permuted"
    path: str = parameter(
        file_name(*VALUES_ENDINGS), "file with one vertex number per vertex; or mirror, or rotation"
    )

    def __str__(self) -> str:
        return f"{self.family}:{quoted(self.path)}({self.function})"

    @property
    def is_detected(self) -> bool:
        """Whether the map is a detected symmetry instead of a file."""
        return self.path in KINDS

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        return self.function.evaluate(mesh)[vertex_map(mesh, self.path)]


def vertex_map(mesh: TriangleMesh, name: str) -> IntArray:
    """Return the vertex map (V,) in a file, or that of the symmetry ``mirror`` or ``rotation``.

    Vertex i is mapped to the vertex in entry i.

    Raises
    ------
    FunctionError
        If the mesh has no such symmetry, or the file is not a map of its vertices.
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
            f"permuted: the map is {brief(name)}{hint}; expected {' or '.join(KINDS)}, or the name "
            "of a file"
        )
    return read_vertex_map(mesh, name)


def read_vertex_map(mesh: TriangleMesh, path: str) -> IntArray:
    """Read a map of the vertices, (V,), from any file that `read_values` can read.

    One column, with a number for each vertex of the mesh file
        The vertex that each vertex is mapped to.
    Two columns
        Pairs of vertices that are mapped to each other. Other vertices are mapped to themselves.
    One column, in a file ``NAME.sym.vts`` in the same folder as a file ``NAME.vts``
        Format of datasets for shape correspondence. Row k of ``NAME.vts`` is the vertex of a point
        of a template. Row k of ``NAME.sym.vts`` is the vertex of its mirror image. These two are
        mapped to each other. Other vertices are mapped like the nearest vertex with a partner.

    Vertices are counted as in the mesh file, from 0 or from 1. If all numbers are valid both from 0
    and from 1, the choice that makes the map a permutation is used. Otherwise .vts files count from
    1, and other files from 0.

    Raises
    ------
    FunctionError
        If the file is not a map, or a vertex has two partners. Also if pairs in a .txt or .csv file
        may count from 0 or from 1.
    """
    table = read_map_table(path, mesh)
    template = Path(os.path.expanduser(path[: -len(_SYMMETRIC_SUFFIX)] + ".vts"))
    if table.shape[1] == 2:
        return _swapped(mesh, path, _local_vertices(mesh, path, table))
    if path.lower().endswith(_SYMMETRIC_SUFFIX) and template.is_file():
        points, mirrored = read_map_table(template, mesh)[:, 0], table[:, 0]
        if len(points) != len(mirrored):
            raise FunctionError(
                f"map {brief(path)} has {counted(len(mirrored), 'line')}, but "
                f"{brief(template.name)} has {len(points)}; expected equal numbers"
            )
        # in both directions; the first pair of a vertex is used, or that of the nearest vertex
        pairs = _local_vertices(mesh, path, np.column_stack([points, mirrored]))
        both = np.concatenate([pairs, pairs[:, ::-1]])
        paired, first = np.unique(both[:, 0], return_index=True)
        from scipy.spatial import cKDTree  # imported late, as most processes do not use it

        nearest = cKDTree(mesh.vertices[paired]).query(mesh.vertices)[1]
        return np.asarray(both[first[nearest], 1])
    return mapped_vertices(mesh, mesh, path, table)


def mapped_vertices(
    domain: TriangleMesh, codomain: TriangleMesh, path: str, table: FloatArray
) -> IntArray:
    """Return the vertex of the codomain to which each vertex of the domain is mapped, (V,).

    ``table`` (n, 1) has the contents of a file; vertices are counted as in `read_vertex_map`.
    """
    try:
        if table.shape[1] != 1:
            raise FunctionError(f"the file has {table.shape[1]} columns; expected 1 or 2")
        column = domain.restrict(table[:, 0])
    except FunctionError as error:
        raise FunctionError(f"map {brief(path)}: {error}") from None
    return _local_vertices(codomain, path, column, domain.vertex_ids)


def _local_vertices(
    mesh: TriangleMesh, path: str, numbers: FloatArray, owners: IntArray | None = None
) -> IntArray:
    """Convert vertex numbers of the mesh file to indices in the mesh, in the same shape.

    ``owners`` are the vertices to which the rows of the file belong, for messages.
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
            f"vertices that a face of the mesh uses ({place} has {example:g}). Expected 0 to "
            f"{count - 1}, or 1 to {count} if they count from 1"
        )
    permutations = [
        r for r in fitting if numbers.ndim == 1 and len(np.unique(r)) == len(mesh.vertices)
    ]
    if len(fitting) == 1 or permutations:
        return (permutations or fitting)[0]
    suffix = path.lower().rpartition(".")[2]
    if numbers.ndim == 2 and suffix in ("txt", "csv"):
        raise FunctionError(
            f"map {brief(path)}: the pairs have neither 0 nor {count}, so they may count from 0 or "
            "from 1. Save them as .npy, counted from 0"
        )
    return fitting[1 if suffix == "vts" else 0]


def _swapped(mesh: TriangleMesh, path: str, pairs: IntArray) -> IntArray:
    """Return the map (V,) that swaps the vertices of each pair, and maps others to themselves."""
    both = np.unique(np.concatenate([pairs, pairs[:, ::-1]]), axis=0)
    twice = np.flatnonzero(both[1:, 0] == both[:-1, 0])
    if len(twice):
        vertex = mesh.vertex_ids[both[twice[0], 0]]
        raise FunctionError(
            f"map {brief(path)}: vertex {vertex} (counted from 0) has two partners; expected one"
        )
    if 2 * len(both) < len(mesh.vertices):
        raise FunctionError(
            f"map {brief(path)}: the pairs contain {len(both)} of {len(mesh.vertices)} vertices; "
            "expected all vertices except those that the symmetry maps to themselves"
        )
    found = np.arange(len(mesh.vertices))
    found[both[:, 0]] = both[:, 1]
    return found
