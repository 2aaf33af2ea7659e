"""The distortion of maps: what they do to lengths, areas, angles and sides of faces."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.operators import face_normals, hat_gradients
from abfm.errors import AbfmError
from abfm.maps.closest_points import finite_points, project_onto_surface
from abfm.mesh import TriangleMesh
from abfm.types import BoolArray, FloatArray


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
    """Measure the distortion of the map that is linear on faces and takes each vertex to its mapped
    position.

    The Jacobian of a face, ``J = sum_i x_i (grad phi_i)^T`` with ``x_i`` the mapped corners, has
    the singular values ``s_1 >= s_2``. Area and angles are those of the flat mapped triangle in
    space, whose corners lie on the surface. A face counts as flipped where its mapped normal makes
    an obtuse angle with the surface's normal at the point closest to its mapped centroid; a
    collapsed face does not count. For flow maps the error is of first order in the edge length,
    that of the map itself of second.

    Parameters
    ----------
    mapped_positions : (V, 3) array
        Where the map takes each vertex, in the units of ``onto``.
    onto : TriangleMesh, optional
        The surface that the map leads to, by default the mesh itself.

    Raises
    ------
    AbfmError
        If the positions are not (V, 3) or not finite.
    """
    mapped = finite_points(mapped_positions)
    if len(mapped) != len(mesh.vertices):
        raise AbfmError(
            f"{len(mapped)} mapped positions for {len(mesh.vertices)} vertices: give one row per "
            "vertex"
        )
    corners = mapped[mesh.faces]
    other = mesh if onto is None else onto
    jacobian = np.einsum("fcx,fck->fxk", corners - corners[:, :1], hat_gradients(mesh))
    first, second = jacobian[..., 0], jacobian[..., 1]
    normal = np.cross(first, second)
    area = np.linalg.norm(normal, axis=1)
    a = (first * first).sum(axis=1)
    b = (first * second).sum(axis=1)
    c = (second * second).sum(axis=1)
    largest = np.sqrt(0.5 * (a + c + np.hypot(a - c, 2 * b)))
    smallest = np.minimum(
        np.divide(area, largest, out=np.zeros_like(area), where=largest > 0), largest
    )
    conformal = np.divide(largest, smallest, out=np.full_like(area, np.inf), where=smallest > 0)
    return Distortion(
        np.stack([largest, smallest], axis=1), area, conformal, turned_over(other, corners)
    )


def turned_over(mesh: TriangleMesh, corners: FloatArray) -> BoolArray:
    """Say which triangles (S, 3, 3) look against the surface closest to their middles, (S,)."""
    landed = project_onto_surface(mesh, corners.mean(axis=1))
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray((normals * face_normals(mesh)[landed.faces]).sum(axis=1) < 0)
