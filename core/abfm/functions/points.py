"""Where on the mesh a function is centred: at vertices by number, or at the vertex nearest to a
point.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from abfm.errors import FunctionError
from abfm.functions.family import NUMBER, VERTICES, Family, parameter
from abfm.mesh import TriangleMesh
from abfm.types import IntArray


def _coordinate(summary: str) -> Any:
    return parameter(NUMBER, summary, unit="length", default=None, instead_of="vertex")


@dataclass(frozen=True, kw_only=True)
class AroundPoints(Family):
    """A family centred at ``vertex=`` (as the mesh file counts, from 0) or near ``x=,y=,z=`` (in
    the file's units).
    """

    vertex: tuple[int, ...] | None = parameter(
        VERTICES,
        "where it is, counted as in the mesh file; of several, with commas, the nearest counts",
        default=None,
        empty="at x, y, z",
    )
    x: float | None = _coordinate("instead of vertex: nearest vertex to this point")
    y: float | None = _coordinate("second coordinate of the point")
    z: float | None = _coordinate("third coordinate of the point")

    def is_located(self) -> bool:
        """Return whether any of ``vertex``, ``x``, ``y``, ``z`` is given."""
        return any(value is not None for value in (self.vertex, self.x, self.y, self.z))

    def check(self) -> None:
        given = [value is not None for value in (self.x, self.y, self.z)]
        if self.vertex is None and not all(given):
            raise FunctionError(f"{self.family}: give vertex=, or all of x=, y= and z=")
        if self.vertex is not None and any(given):
            raise FunctionError(f"{self.family}: give either vertex= or x=, y= and z=, not both")

    def sources(self, mesh: TriangleMesh) -> IntArray:
        """Return the indices of the centres among the mesh's vertices, (n,)."""
        if self.vertex is not None:
            return np.array([mesh.local_vertex(index) for index in self.vertex])
        offsets = mesh.vertices - np.array([self.x, self.y, self.z])
        return np.array([np.argmin(np.linalg.norm(offsets, axis=1))])
