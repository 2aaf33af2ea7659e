"""Geodesic distances by three algorithms: heat, a straightened edge path, and exact distances.

The heat method is the fastest, and exact distances are the slowest.
"""

from typing import Any

import igl
import numpy as np
import potpourri3d
from numpy.typing import ArrayLike

from abfm.calculus.operators import face_areas
from abfm.errors import FunctionError
from abfm.mesh import TriangleMesh, per_mesh
from abfm.numerics.available_memory import require_memory
from abfm.numerics.real_numbers import real_numbers
from abfm.types import FloatArray, IntArray
from abfm.workers.progress import step

EXACT_VERTICES_MAX = 6_000
"""Number of vertices up to which `surface_distance` is exact.

It takes about a second there, and 30 times as long at four times as many vertices.
"""
# least height of a face over its longest edge; below 1e-4 the exact algorithm may not end
_EXACT_HEIGHT_MIN = 1e-3
# memory to require; factoring takes 2,700 bytes per vertex at 2,600 vertices, 4,100 at 164,000
_BYTES_PER_VERTEX = 6_000


def geodesic_distance(mesh: TriangleMesh, sources: ArrayLike) -> FloatArray:
    """Return the distance (V,) along the surface to the nearest source, in the mesh's units.

    The sources (n,) are vertex indices of the mesh itself; the distance is exactly 0 there. The
    largest error on the unit sphere is 0.051 at 642 vertices, 0.029 at 2,562, and 0.019 at 10,242.
    The robust Laplacian keeps the distance correct on uneven meshes.

    References
    ----------
    Crane, Weischedel, Wardetzky: Geodesics in Heat, ACM TOG 32(5), 2013, Algorithm 1.
    Sharp, Crane: A Laplacian for Nonmanifold Triangle Meshes, SGP 2020.
    """
    given = np.atleast_1d(real_numbers(sources, "sources", FunctionError)).ravel()
    # files may store vertex 3 as 3.0
    wrong = given[~np.isin(given, np.arange(len(mesh.vertices)))]
    if wrong.size or not given.size:
        found = f"{wrong[0]:g}" if wrong.size else "missing"
        raise FunctionError(f"sources are {found}; expected vertices 0 to {len(mesh.vertices) - 1}")
    try:
        solver = _heat_solver(mesh.normalized())
        distances = [
            (source, solver.compute_distance(source)) for source in given.astype(int).tolist()
        ]
    except RuntimeError as error:
        raise FunctionError(
            f"no geodesic distance on this mesh: {error}. For a gaussian, try metric=euclidean"
        ) from error
    nearest = np.min(
        [np.maximum(distance - distance[source], 0) for source, distance in distances], axis=0
    )
    return np.asarray(mesh.length_scale * nearest)


@per_mesh
def _heat_solver(mesh: TriangleMesh) -> Any:
    with step("factoring for distances", len(mesh.vertices) ** 1.5):
        require_memory(_BYTES_PER_VERTEX * len(mesh.vertices))
        return potpourri3d.MeshHeatMethodDistanceSolver(mesh.vertices, mesh.faces, use_robust=True)


def path_length(mesh: TriangleMesh, first: int, last: int) -> float:
    """Return the length of a geodesic between two vertices, found by straightening an edge path.

    The geodesic is not always the shortest one. On two human meshes the lengths of paths up to 0.3
    long are off by 0.001 on average. Reference: Sharp, Crane: You Can Find Geodesic Paths in
    Triangle Meshes by Just Flipping Edges, ACM TOG 39(6), 2020.
    """
    try:
        path: FloatArray = _path_solver(mesh).find_geodesic_path(first, last)
    except RuntimeError as error:
        raise FunctionError(f"no geodesic on this mesh: {error}. Remesh it") from error
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def exact_distances(mesh: TriangleMesh, sources: ArrayLike, targets: IntArray) -> FloatArray:
    """Return exact distances along the surface from the nearest source to the targets (P,).

    Sources and targets are vertices. Algorithm: Mitchell, Mount, Papadimitriou, The Discrete
    Geodesic Problem, SIAM J. Comput. 16(4), 1987.
    """
    none, start = np.zeros(0, dtype=np.int64), np.atleast_1d(np.asarray(sources, dtype=np.int64))
    found = igl.exact_geodesic(mesh.vertices, mesh.faces, start, none, targets, none)
    return np.asarray(found, dtype=np.float64)


def surface_distance(mesh: TriangleMesh, sources: IntArray) -> FloatArray:
    """Return the distance (V,) along the surface to the nearest source, in the mesh's units.

    The sources (n,) are vertices. On meshes of up to `EXACT_VERTICES_MAX` vertices the distances
    are exact (`exact_distances`). On larger meshes they are those of `geodesic_distance`, which are
    approximate. The same holds for surfaces that touch themselves at a vertex, or have triangles
    1,000 times as long as high.
    """
    has_exact = (
        len(mesh.vertices) <= EXACT_VERTICES_MAX
        and not mesh.is_pinched_vertex.any()
        and _least_height(mesh) >= _EXACT_HEIGHT_MIN
    )
    if has_exact:
        return exact_distances(mesh, sources, np.arange(len(mesh.vertices)))
    return geodesic_distance(mesh, sources)


@per_mesh
def _least_height(mesh: TriangleMesh) -> float:
    """Return the smallest ratio of height to longest edge among the faces."""
    corners = mesh.normalized().vertices[mesh.faces]
    squares = (np.diff(corners[:, [0, 1, 2, 0]], axis=1) ** 2).sum(axis=2).max(axis=1)
    return float((2 * face_areas(mesh.normalized()) / squares).min())


@per_mesh
def _path_solver(mesh: TriangleMesh) -> Any:
    return potpourri3d.EdgeFlipGeodesicSolver(mesh.vertices, mesh.faces)
