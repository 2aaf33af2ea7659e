"""Which part of a surface a map turns over, told from faces that it only stretches.

Where a map stretches a face to a long sliver on a curved surface, or shears it far, the flat
triangle of its mapped vertices looks against the surface although the map does not turn over
anywhere: with smooth flows that match two functions, several percent of the faces. So those are
looked at more closely, in 64 parts.
"""

from collections.abc import Callable

import numpy as np

from abfm.calculus.operators import face_normals
from abfm.maps.distortion import turned_over
from abfm.maps.surface_points import SurfacePoints
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray, IntArray

MOST = 2048
"""Faces that are looked at closely, unless said."""
_PARTS = 8  # along each side
_INSIDE = 1e-6  # of the way to the centre, so that no point lies on two faces
_FLAT = 1e-12  # of its size before: a part that has less area now has collapsed, not turned over


def folds(
    mesh: TriangleMesh,
    carried: Callable[[SurfacePoints], SurfacePoints],
    faces: IntArray,
    corners: FloatArray,
    most: int = MOST,
) -> tuple[float, float]:
    """Return the shares of some faces, by number, that a map folds, and that its mapped vertices
    alone turn over.

    A face is folded where its mapped vertices turn it over (see `distortion.turned_over`) and
    so do more than half of the 64 parts that it is cut into, each mapped by itself and compared
    with the surface where it lands. Where a map stretches faces so far that even such parts reach
    around the surface this still says too much, never too little.

    Parameters
    ----------
    carried : callable
        The map: points of the surface to points of the surface.
    faces : (S,) array of int
    corners : (S, 3, 3) array
        Where it takes their vertices.
    most : int
        Faces that are cut into parts: of more, so many evenly chosen ones stand for all.
    """
    overturned = faces[turned_over(mesh, corners)]
    if not len(overturned):
        return 0.0, 0.0
    share = len(overturned) / len(faces)
    looked_at = overturned[
        np.linspace(0, len(overturned) - 1, min(len(overturned), most)).astype(np.int64)
    ]
    return share * float((turned_parts(mesh, carried, looked_at) > 0.5).mean()), share


def turned_parts(
    mesh: TriangleMesh, carried: Callable[[SurfacePoints], SurfacePoints], faces: IntArray
) -> FloatArray:
    """Return the share of the 64 parts of each of S faces that a map turns over, (S,)."""
    weights, parts = _grid(_PARTS)
    weights = (1 - _INSIDE) * weights + _INSIDE / 3
    owners, barycentric = np.repeat(faces, len(weights)), np.tile(weights, (len(faces), 1))
    start = SurfacePoints(mesh, owners, barycentric)
    end = carried(start)
    shape = (len(faces), len(weights))
    normals = face_normals(mesh)[end.faces].reshape(*shape, 3)[:, parts].mean(axis=2)
    before, after = (
        _area_vectors(points.positions.reshape(*shape, 3)[:, parts]) for points in (start, end)
    )
    turned = (after * normals).sum(axis=-1) < -_FLAT * np.linalg.norm(before, axis=-1)
    return np.asarray(turned.mean(axis=1))


def _area_vectors(corners: FloatArray) -> FloatArray:
    """Return normals as long as twice the areas of triangles (..., 3, 3)."""
    first, second = corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :]
    return np.cross(first, second)


def _grid(n: int) -> tuple[FloatArray, IntArray]:
    """Return barycentric weights of a grid with n steps a side, and its n^2 triangles."""
    steps = np.indices((n + 1, n + 1)).reshape(2, -1)
    second, third = steps[:, steps.sum(axis=0) <= n]
    number = np.full((n + 2, n + 2), -1)
    number[second, third] = np.arange(len(second))
    ahead = np.stack(
        [number[second, third], number[second + 1, third], number[second, third + 1]], axis=1
    )
    back = np.stack(
        [number[second + 1, third], number[second + 1, third + 1], number[second, third + 1]],
        axis=1,
    )
    triangles = np.concatenate([ahead, back])
    return np.stack([n - second - third, second, third], axis=1) / n, triangles[
        (triangles >= 0).all(axis=1)
    ]
