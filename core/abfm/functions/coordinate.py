"""Coordinates in space."""

from dataclasses import dataclass
from typing import ClassVar

from abfm.functions.family import Family, choice, parameter
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray

AXIS = choice("x", "y", "z")


def along(mesh: TriangleMesh, axis: str) -> FloatArray:
    """Return the coordinate x, y or z of every vertex, (V,)."""
    return mesh.vertices[:, "xyz".index(axis)]


@dataclass(frozen=True, kw_only=True)
class Coordinate(Family):
    """Coordinate x, y or z of the vertices, in the mesh's units of length."""

    family: ClassVar[str] = "coordinate"
    positional: ClassVar[str | None] = "axis"
    example: ClassVar[str] = "coordinate:y"
    axis: str = parameter(AXIS, "which coordinate")

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        return along(mesh, self.axis)
