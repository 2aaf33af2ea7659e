"""Where on the mesh a function is centred: at vertices by number, or at the vertex nearest to a point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from abfm.errors import FunctionError
from abfm.functions.family import INDICES, NUMBER, Family, parameter
from abfm.mesh import TriangleMesh
from abfm.types import IntArray


@dataclass(frozen=True, kw_only=True)
class AroundPoints(Family):
    """A family centred at ``vertex=`` (as the mesh file counts, from 0) or near ``x=,y=,z=`` (in the file's units)."""

    vertex: tuple[int, ...] | None = parameter(
        INDICES, "vertex as the mesh file counts; of several the nearest counts", default=None
    )
    x: float | None = parameter(NUMBER, "instead of vertex: nearest vertex to this point", unit="length", default=None)
    y: float | None = parameter(NUMBER, "second coordinate of the point", unit="length", default=None)
    z: float | None = parameter(NUMBER, "third coordinate of the point", unit="length", default=None)

    def is_located(self) -> bool:
        """Whether any of ``vertex``, ``x``, ``y``, ``z`` is given."""
        return any(value is not None for value in (self.vertex, self.x, self.y, self.z))

    def check(self) -> None:
        given = [value is not None for value in (self.x, self.y, self.z)]
        if self.vertex is None and not all(given):
            raise FunctionError(f"{self.family}: give vertex=, or all of x=, y= and z=")
        if self.vertex is not None and any(given):
            raise FunctionError(f"{self.family}: give either vertex= or x=, y= and z=, not both")

    def sources(self, mesh: TriangleMesh) -> IntArray:
        """Indices of the centres among the mesh's vertices, (n,)."""
        if self.vertex is not None:
            return np.array([mesh.local_vertex(index) for index in self.vertex])
        offsets = mesh.vertices - np.array([self.x, self.y, self.z])
        return np.array([np.argmin(np.linalg.norm(offsets, axis=1))])
