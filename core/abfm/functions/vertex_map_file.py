"""Vertex maps from files: vertex numbers counted from 0 or from 1, or pairs of vertices that a
symmetry swaps.
"""

from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from abfm.errors import FunctionError, brief
from abfm.functions.values_file import read_column, read_table
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray, IntArray

_SYMMETRIC = ".sym.vts"


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
    others from 0, as meshes do.

    Raises
    ------
    FunctionError
        If the file cannot be read, has the wrong length, numbers that fit neither way or, in pairs
        of .txt or .csv, both ways, or two partners for a vertex.
    """
    table = read_table(path)[1]
    template = Path(path[: -len(_SYMMETRIC)] + ".vts").expanduser()
    if table.shape[1] == 2:
        pairs = _local_vertices(mesh, path, table)
        return _swapped(mesh, path, pairs)
    if path.lower().endswith(_SYMMETRIC) and template.is_file():
        points = read_column(str(template))
        mirrored = read_column(path)
        if len(points) != len(mirrored):
            raise FunctionError(
                f"map {brief(path)} has {len(mirrored)} lines, {brief(template.name)} has "
                f"{len(points)}"
            )
        return _spread(mesh, _local_vertices(mesh, path, np.column_stack([points, mirrored])))
    try:
        column = mesh.restrict(read_column(path))
    except FunctionError as error:
        raise FunctionError(f"map {brief(path)}: {error}") from None
    return _local_vertices(mesh, path, column)


def _local_vertices(mesh: TriangleMesh, path: str, numbers: FloatArray) -> IntArray:
    """Return the numbers of vertices as the mesh file counts them, from 0 or 1, as the mesh's own,
    in the same shape.
    """
    count = mesh.file_vertex_count
    readings = []
    for first in (0, 1):
        nearest = np.searchsorted(mesh.vertex_ids, numbers - first).clip(max=len(mesh.vertices) - 1)
        readings.append(np.where(mesh.vertex_ids[nearest] == numbers - first, nearest, -1))
    fitting = [reading for reading in readings if (reading >= 0).all()]
    if not fitting:
        wrong = readings[0] < 0
        if not (numbers == 0).any():
            wrong = min(wrong, readings[1] < 0, key=np.count_nonzero)
        row = int(np.flatnonzero(wrong.reshape(len(wrong), -1).any(axis=1))[0])
        example = numbers[row][wrong[row]][0] if numbers.ndim == 2 else numbers[row]
        place = f"line {row + 1}" if numbers.ndim == 2 else f"vertex {mesh.vertex_ids[row]}"
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
    vertex_map = np.arange(len(mesh.vertices))
    vertex_map[both[:, 0]] = both[:, 1]
    return vertex_map


def _spread(mesh: TriangleMesh, pairs: IntArray) -> IntArray:
    """Return the map given by pairs in both directions, the first pair of a vertex counting, and by
    the nearest elsewhere.
    """
    both = np.concatenate([pairs, pairs[:, ::-1]])
    known, first = np.unique(both[:, 0], return_index=True)
    nearest = cKDTree(mesh.vertices[known]).query(mesh.vertices)[1]
    return np.asarray(both[first[nearest], 1])
