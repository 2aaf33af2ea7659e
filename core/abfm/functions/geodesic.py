"""Geodesic distance from vertices."""

from dataclasses import dataclass
from typing import ClassVar

from abfm.calculus.geodesics import geodesic_distance
from abfm.functions.points import AroundPoints
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray


@dataclass(frozen=True, kw_only=True)
class Geodesic(AroundPoints):
    """Geodesic distance to a vertex, or to the nearest of several, in the mesh's units of length.

    Heat method [Crane, Weischedel, Wardetzky 2013] on the tufted intrinsic Delaunay triangulation
    [Sharp, Crane 2020]; see :func:`geodesic_distance`.
    """

    family: ClassVar[str] = "geodesic"
    example: ClassVar[str] = "geodesic:vertex={vertex}"

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        return geodesic_distance(mesh, self.sources(mesh))
