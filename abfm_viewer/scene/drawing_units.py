"""The units that graphics cards draw in: they compute with seven digits, in the mesh's own units too few."""

from __future__ import annotations

from dataclasses import dataclass

from abfm import TriangleMesh
from abfm.types import FloatArray


@dataclass(frozen=True, eq=False)
class DrawingUnits:
    """Coordinates from a mesh's middle, in lengths of the mesh.

    Attributes
    ----------
    center : (3,) array
    length : float
    """

    center: FloatArray
    length: float

    def drawn(self, points: FloatArray) -> FloatArray:
        """Points (..., 3) in the mesh's units as they are drawn."""
        return (points - self.center) / self.length

    def undrawn(self, points: FloatArray) -> FloatArray:
        """The inverse of `drawn`."""
        return self.center + self.length * points


def drawing_units(mesh: TriangleMesh) -> DrawingUnits:
    """The units for a mesh: the middle of its bounding box, and the square root of its area."""
    return DrawingUnits((mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2, mesh.length_scale)
