"""A continuous field at points of a surface, and straightest geodesics from them."""

from __future__ import annotations

import numpy as np

from abfm.calculus.operators import face_frames, hat_gradients
from abfm.flow.continuous_flow import SmoothFlow, Walker, enter, leave, smooth_flow, walk_straight
from abfm.maps.surface_points import SurfacePoints
from abfm.mesh import TriangleMesh, per_mesh
from abfm.numerics.kernels import kernel
from abfm.types import BoolArray, FloatArray, IndexArray


def vectors_at(mesh: TriangleMesh, field: FloatArray, points: SurfacePoints) -> FloatArray:
    """Return the vectors (P, 3) of a field (F, 3) at P points.

    The field is first made continuous, as for the flow lines of `ContinuousFlow`.
    """
    unit = mesh.normalized()
    vectors = smooth_flow(unit, field).vectors[points.faces]
    places = np.empty((len(points.faces), 2))
    enter(hat_gradients(unit), points.faces, points.barycentric, places)
    found = vectors[:, 0] + np.einsum("pj,pjk->pk", places, vectors[:, 1:])
    return np.asarray(np.einsum("pk,pkx->px", found, face_frames(mesh)[points.faces]))


def straightest_geodesics(
    mesh: TriangleMesh, start: SurfacePoints, vectors: FloatArray
) -> tuple[SurfacePoints, BoolArray]:
    """Follow the straightest geodesics [Polthier and Schmies, 1998] from P points.

    The vectors (P, 3), in the planes of the faces of the points, give directions and lengths.
    Return the end points, and a mask (P,) of the geodesics that met no boundary. A geodesic that
    met a boundary ends at the point where it began.
    """
    unit, faces = mesh.normalized(), start.faces.copy()
    frames = face_frames(mesh)[faces]
    ways = np.einsum("px,pkx->pk", vectors, frames) / mesh.length_scale
    places, weights = np.empty((len(faces), 2)), start.barycentric.copy()
    inside = np.empty(len(faces), dtype=np.bool_)
    gradients = hat_gradients(unit)
    enter(gradients, faces, weights, places)
    walk(_unfolded(unit), faces, places, ways, inside)
    leave(gradients, faces, places, weights)
    return SurfacePoints(mesh, faces, weights), inside


@per_mesh
def _unfolded(mesh: TriangleMesh) -> SmoothFlow:
    """Return a `SmoothFlow` with a zero field, which has the data that geodesics need."""
    return smooth_flow(mesh, np.zeros((len(mesh.faces), 3)))


@kernel
def walk(
    flow: SmoothFlow, faces: IndexArray, places: FloatArray, ways: FloatArray, inside: BoolArray
) -> None:
    """Follow P geodesics along the vectors ``ways`` (P, 2); update ``faces`` and ``places``.

    ``places`` (P, 2) are the coordinates of the points in the local frames of their faces, as are
    the vectors. ``inside`` (P,) becomes False for a geodesic that meets a boundary; its point does
    not move.
    """
    for i in range(faces.size):
        x, y, u, v = places[i, 0], places[i, 1], ways[i, 0], ways[i, 1]
        end = walk_straight(flow, Walker(faces[i], x, y, u, v), False)
        inside[i] = end.face >= 0
        if end.face >= 0:
            faces[i], places[i, 0], places[i, 1] = end.face, end.x, end.y
