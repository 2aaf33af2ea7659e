"""Geodesic distance from vertices."""

from typing import Any

import numpy as np
import potpourri3d
from numpy.typing import ArrayLike

from abfm.errors import FunctionError
from abfm.mesh import TriangleMesh, per_mesh
from abfm.numerics.spare_memory import ask_for
from abfm.progress import step
from abfm.real_numbers import real_numbers
from abfm.types import FloatArray

_BYTES_PER_VERTEX = 6_000  # of memory to ask for; factoring takes 2,700 at 2,600 vertices and 4,100 at 164,000


def geodesic_distance(mesh: TriangleMesh, sources: ArrayLike) -> FloatArray:
    """Distance along the surface to the nearest source, (V,), in the mesh's units; exactly 0 at the sources.

    Largest error on the unit sphere: 0.051 at 642 vertices, 0.029 at 2,562, 0.019 at 10,242. The robust Laplacian is
    what keeps it right on uneven meshes: on a human with edge lengths from 1 to 73 it was off by 0.03 sqrt(area), plain
    cotangent weights by 0.73.

    Parameters
    ----------
    sources : (n,) array of int
        Indices among the mesh's own vertices (not the file's).

    Raises
    ------
    FunctionError
        If a source is no vertex, there is none, or the solver fails on this mesh.

    References
    ----------
    Crane, Weischedel, Wardetzky: Geodesics in Heat, ACM TOG 32(5), 2013, Algorithm 1.
    Sharp, Crane: A Laplacian for Nonmanifold Triangle Meshes, SGP 2020.
    """
    given = np.atleast_1d(real_numbers(sources, "sources", FunctionError)).ravel()
    wrong = given[~np.isin(given, np.arange(len(mesh.vertices)))]  # 3.0, as files have it, is a vertex, too
    if wrong.size or not given.size:
        found = f"{wrong[0]:g}" if wrong.size else "missing"
        raise FunctionError(f"sources are {found}; expected vertices 0 to {len(mesh.vertices) - 1}")
    try:
        solver = _heat_solver(mesh.normalized())
        ways = [(source, solver.compute_distance(source)) for source in given.astype(int).tolist()]
    except RuntimeError as error:
        raise FunctionError(
            f"no geodesic distance on this mesh: {error}; for a gaussian try metric=euclidean"
        ) from error
    nearest = np.min([np.maximum(distance - distance[source], 0) for source, distance in ways], axis=0)
    return np.asarray(mesh.length_scale * nearest)


@per_mesh
def _heat_solver(mesh: TriangleMesh) -> Any:
    with step("factoring for distances", len(mesh.vertices) ** 1.5):
        ask_for(_BYTES_PER_VERTEX * len(mesh.vertices))
        return potpourri3d.MeshHeatMethodDistanceSolver(mesh.vertices, mesh.faces, use_robust=True)
