"""Composition of a function with a vertex map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from abfm.errors import FunctionError
from abfm.functions.family import PATH, Family, Spec, parameter, quoted, shown
from abfm.functions.values_file import read_vertex_values
from abfm.mesh import FloatArray, IntArray, TriangleMesh


@dataclass(frozen=True, kw_only=True)
class Permuted(Family):
    """Another function composed with a vertex map: ``result[i] = f[map[i]]``, in the unit of f.

    The map's file (.txt, .csv, .npy or .gii) holds one vertex number per vertex of the mesh file, counted from 0 as the
    mesh file does. It need not be a permutation: any map of the vertices will do.
    """

    family: ClassVar[str] = "permuted"
    path: str = parameter(PATH, "file with one vertex number per vertex")
    function: Spec  # given in parentheses after the path

    def __str__(self) -> str:
        return f"{self.family}:{quoted(self.path)}({self.function})"

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        return self.function.evaluate(mesh)[vertex_map(mesh, self.path)]


def vertex_map(mesh: TriangleMesh, path: str) -> IntArray:
    """Read a vertex map that counts as the mesh file does; the result counts the mesh's own vertices, (V,).

    Raises
    ------
    FunctionError
        If the file has the wrong length, or an entry is no vertex number or names a vertex that no face uses.
    """
    target = read_vertex_values(mesh, path)
    count = mesh.file_vertex_count
    local = np.full(count + 1, -1)
    local[mesh.vertex_ids] = np.arange(len(mesh.vertices))
    is_number = (target == np.floor(target)) & (target >= 0) & (target < count)
    index = local[np.where(is_number, target, count).astype(np.int64)]
    wrong = np.flatnonzero(index < 0)
    if len(wrong):
        raise FunctionError(
            f"map {shown(path)}: {len(wrong)} of {len(target)} entries are not numbers of vertices in use, "
            f"0 to {count - 1} (vertex {mesh.vertex_ids[wrong[0]]} has {target[wrong[0]]:g}); they count from 0"
        )
    return index
