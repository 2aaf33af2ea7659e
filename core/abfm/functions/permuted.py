"""Composition of a function with a vertex map."""

from dataclasses import dataclass
from typing import ClassVar

from abfm.errors import FunctionError, brief, did_you_mean
from abfm.functions.family import Family, Spec, file_name, parameter, quoted
from abfm.functions.values_file import SUFFIXES
from abfm.functions.vertex_map_file import read_vertex_map
from abfm.maps.symmetry import KINDS, SymmetryError, detect_symmetry
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class Permuted(Family):
    """Another function composed with a vertex map: ``result[i] = f[map[i]]``, in the unit of f.

    The map is ``mirror`` or ``rotation``, the symmetry of this kind that the mesh is found to have
    (see :func:`abfm.maps.symmetry.detect_symmetry`; the rotation by 180 degrees), or a file (see
    :func:`abfm.functions.vertex_map_file.read_vertex_map`): one vertex number per vertex of the
    mesh file, counted from 0 or 1, or pairs of vertices. It need not be a permutation: any map of
    the vertices will do.
    """

    family: ClassVar[str] = "permuted"
    path: str = parameter(
        file_name(*SUFFIXES), "file with one vertex number per vertex; or mirror, or rotation"
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
