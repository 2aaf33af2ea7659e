"""Gaussian and mean curvature."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from abfm.errors import FunctionError
from abfm.functions.extension import extend
from abfm.functions.family import Family, choice, parameter
from abfm.mesh import FloatArray, TriangleMesh
from abfm.operators import cotangent_laplacian, face_areas, face_normals, vertex_areas


@dataclass(frozen=True, kw_only=True)
class Curvature(Family):
    """Gaussian curvature (1/length^2) or mean curvature (1/length, positive where the surface bulges outward).

    See :func:`gaussian_curvature` and :func:`mean_curvature`. Both formulas hold off the boundary only: a boundary vertex
    gets the mean of its neighbours.

    References
    ----------
    Meyer, Desbrun, Schröder, Barr: Discrete Differential-Geometry Operators for Triangulated 2-Manifolds, 2003,
    equations (8) and (9), with a third of the adjacent area in the place of its mixed area.
    """

    family: ClassVar[str] = "curvature"
    positional: ClassVar[str | None] = "kind"
    kind: str = parameter(choice("gaussian", "mean"), "which curvature")

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        inner = ~mesh.is_boundary_vertex
        if not inner.any():
            raise FunctionError("curvature: every vertex of this mesh lies on its boundary, where curvature is not defined")
        curvature = gaussian_curvature if self.kind == "gaussian" else mean_curvature
        return extend(mesh, curvature(mesh), inner)


def gaussian_curvature(mesh: TriangleMesh) -> FloatArray:
    """Angle defect over vertex area, ``(2 pi - sum of angles) / A_V``, (V,), in 1/length^2; meaningless on a boundary."""
    corners = mesh.vertices[mesh.faces]
    ahead, behind = np.roll(corners, -1, axis=1) - corners, np.roll(corners, -2, axis=1) - corners
    twice_area = 2 * face_areas(mesh)[:, None]
    angles = np.arctan2(np.broadcast_to(twice_area, mesh.faces.shape), np.einsum("fcx,fcx->fc", ahead, behind))
    total = np.bincount(mesh.faces.ravel(), angles.ravel(), minlength=len(mesh.vertices))
    return (2 * np.pi - total) / vertex_areas(mesh)


def mean_curvature(mesh: TriangleMesh) -> FloatArray:
    """Half the Laplacian of the coordinates along the vertex normal, (V,), in 1/length; meaningless on a boundary."""
    curvature_normal = cotangent_laplacian(mesh) @ mesh.vertices / (2 * vertex_areas(mesh)[:, None])
    return np.einsum("vx,vx->v", curvature_normal, vertex_normals(mesh))


def vertex_normals(mesh: TriangleMesh) -> FloatArray:
    """Unit normals at the vertices: the area-weighted mean of the adjacent faces' normals, (V, 3)."""
    weighted = np.repeat(face_areas(mesh)[:, None] * face_normals(mesh), 3, axis=0)
    normals = np.stack(
        [np.bincount(mesh.faces.ravel(), component, minlength=len(mesh.vertices)) for component in weighted.T], axis=1
    )
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / np.where(lengths > 0, lengths, 1)
