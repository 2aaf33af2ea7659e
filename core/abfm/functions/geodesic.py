"""Geodesic distance from vertices."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import potpourri3d
from numpy.typing import ArrayLike

from abfm.errors import FunctionError
from abfm.functions.points import AroundPoints
from abfm.mesh import FloatArray, TriangleMesh, per_mesh


@dataclass(frozen=True, kw_only=True)
class Geodesic(AroundPoints):
    """Geodesic distance to a vertex, or to the nearest of several, in the mesh's units of length.

    Heat method [Crane, Weischedel, Wardetzky 2013] on the tufted intrinsic Delaunay triangulation [Sharp, Crane 2020];
    see :func:`geodesic_distance`.
    """

    family: ClassVar[str] = "geodesic"

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        return geodesic_distance(mesh, self.sources(mesh))


def geodesic_distance(mesh: TriangleMesh, sources: ArrayLike) -> FloatArray:
    """Distance along the surface to the nearest source, (V,), in the mesh's units; exactly 0 at the sources.

    The heat method's error shrinks with the square root of the edge length or better: on the unit sphere 0.029 at
    2,562 vertices, 0.019 at 10,242. The robust Laplacian is what keeps it right on uneven meshes: where the edge lengths
    differ by a factor of 73, plain cotangent weights were wrong by half the size of the surface.

    Parameters
    ----------
    sources : (n,) array of int
        Indices among the mesh's own vertices (not the file's); not checked.

    Raises
    ------
    FunctionError
        If the solver fails on this mesh.

    References
    ----------
    Crane, Weischedel, Wardetzky: Geodesics in Heat, ACM TOG 32(5), 2013, Algorithm 1.
    Sharp, Crane: A Laplacian for Nonmanifold Triangle Meshes, SGP 2020.
    """
    try:
        solver = _heat_solver(mesh.normalized())
        distances = [_from_source(solver, int(source)) for source in np.atleast_1d(sources)]
    except RuntimeError as error:
        raise FunctionError(f"no geodesic distance on this mesh ({error}); try metric=euclidean or repair it") from error
    return mesh.length_scale * np.min(distances, axis=0)


@per_mesh
def _heat_solver(mesh: TriangleMesh) -> Any:
    return potpourri3d.MeshHeatMethodDistanceSolver(mesh.vertices, mesh.faces, use_robust=True)


def _from_source(solver: Any, source: int) -> FloatArray:
    distance: FloatArray = solver.compute_distance(source)
    return np.maximum(distance - distance[source], 0)
