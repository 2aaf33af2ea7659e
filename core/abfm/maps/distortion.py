"""What maps do to lengths, areas, angles and sides of faces, and which part they turn over."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.operators import face_normals, hat_gradients
from abfm.errors import AbfmError
from abfm.maps.surface_points import SurfacePoints, finite_points, project_onto_surface
from abfm.mesh import TriangleMesh
from abfm.types import BoolArray, FloatArray, IntArray

MOST = 2048  # faces that are looked at closely, unless said
_PARTS = 8  # along each side
_INSIDE = 1e-6  # of the way to the centre, so that no point lies on two faces
_FLAT = 1e-12  # of its size before: a part that has less area now has collapsed, not turned over
Map = Callable[[SurfacePoints], SurfacePoints]


@dataclass(frozen=True)
class Distortion:
    """What a piecewise linear map does to each of F faces; see `distortion`."""

    singular_values: FloatArray  # (F, 2), largest and smallest stretch ``s_1 >= s_2 >= 0``
    area: FloatArray  # (F,), ``s_1 s_2``: mapped area over area
    conformal: FloatArray  # (F,), ``s_1 / s_2 >= 1``; inf where a face collapses
    # (F,), True where the mapped face looks against the surface that it landed on
    flipped: BoolArray


def distortion(
    mesh: TriangleMesh, mapped_positions: ArrayLike, onto: TriangleMesh | None = None
) -> Distortion:
    """Measure the map that is linear on faces and takes each vertex to its position (V, 3) on a
    surface, by default the mesh itself: by the singular values ``s_1 >= s_2`` of each face's
    Jacobian, ``J = sum_i x_i (grad phi_i)^T`` with ``x_i`` the mapped corners. A face is flipped
    where its mapped normal makes an obtuse angle with the surface's normal at the point closest to
    its mapped centroid. For flow maps the error is of first order in the edge length.
    """
    mapped = finite_points(mapped_positions)
    if len(mapped) != len(mesh.vertices):
        raise AbfmError(
            f"{len(mapped)} mapped positions for {len(mesh.vertices)} vertices: give one row per "
            "vertex"
        )
    corners = mapped[mesh.faces]
    jacobian = np.einsum("fcx,fck->fxk", corners - corners[:, :1], hat_gradients(mesh))
    first, second = jacobian[..., 0], jacobian[..., 1]
    normal = np.cross(first, second)
    area = np.linalg.norm(normal, axis=1)
    a, b, c = ((x * y).sum(axis=1) for x, y in ((first, first), (first, second), (second, second)))
    largest = np.sqrt(0.5 * (a + c + np.hypot(a - c, 2 * b)))
    smallest = np.divide(area, largest, out=np.zeros_like(area), where=largest > 0)
    smallest = np.minimum(smallest, largest)
    conformal = np.divide(largest, smallest, out=np.full_like(area, np.inf), where=smallest > 0)
    flipped = turned_over(mesh if onto is None else onto, corners)
    return Distortion(np.stack([largest, smallest], axis=1), area, conformal, flipped)


def turned_over(mesh: TriangleMesh, corners: FloatArray) -> BoolArray:
    """Say which triangles (S, 3, 3) look against the surface closest to their middles, (S,)."""
    landed = project_onto_surface(mesh, corners.mean(axis=1))
    return np.asarray((_areas(corners) * face_normals(mesh)[landed.faces]).sum(axis=1) < 0)


def folds(
    mesh: TriangleMesh, carried: Map, faces: IntArray, corners: FloatArray, most: int = MOST
) -> tuple[float, float]:
    """Return the shares of some faces (S,), by number, that a map folds, and that its mapped
    vertices alone, ``corners`` (S, 3, 3), turn over.

    Smooth flows that stretch faces to slivers seem to turn several percent of them over. So a face
    is folded where more than half of its 64 parts, each mapped by itself, are turned over, too.
    Where even parts reach around the surface this still says too much, never too little. Of more
    than ``most`` faces to cut, evenly chosen ones stand for all.
    """
    overturned = faces[turned_over(mesh, corners)]
    if not len(overturned):
        return 0.0, 0.0
    share = len(overturned) / len(faces)
    chosen = np.linspace(0, len(overturned) - 1, min(len(overturned), most)).astype(np.int64)
    turned = turned_parts(mesh, carried, overturned[chosen])
    return share * float((turned > 0.5).mean()), share


def turned_parts(mesh: TriangleMesh, carried: Map, faces: IntArray) -> FloatArray:
    """Return the share of the 64 parts of each of S faces that a map turns over, (S,)."""
    weights, parts = _grid(_PARTS)
    weights = (1 - _INSIDE) * weights + _INSIDE / 3
    tiled = np.tile(weights, (len(faces), 1))
    start = SurfacePoints(mesh, np.repeat(faces, len(weights)), tiled)
    end, shape = carried(start), (len(faces), len(weights), 3)
    normals = face_normals(mesh)[end.faces].reshape(shape)[:, parts].mean(axis=2)
    before, after = (_areas(points.positions.reshape(shape)[:, parts]) for points in (start, end))
    turned = (after * normals).sum(axis=-1) < -_FLAT * np.linalg.norm(before, axis=-1)
    return np.asarray(turned.mean(axis=1))


def _areas(corners: FloatArray) -> FloatArray:
    return np.cross(
        corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :]
    )


def _grid(n: int) -> tuple[FloatArray, IntArray]:
    """Return barycentric weights of a grid with n steps a side, and its n^2 triangles."""
    steps = np.indices((n + 1, n + 1)).reshape(2, -1)
    second, third = steps[:, steps.sum(axis=0) <= n]
    number = np.full((n + 2, n + 2), -1)
    number[second, third] = np.arange(len(second))
    here, right = number[second, third], number[second + 1, third]
    above, across = number[second, third + 1], number[second + 1, third + 1]
    triangles = np.concatenate(
        [np.stack(t, axis=1) for t in ((here, right, above), (right, across, above))]
    )
    inside = triangles[(triangles >= 0).all(axis=1)]
    return np.stack([n - second - third, second, third], axis=1) / n, inside
