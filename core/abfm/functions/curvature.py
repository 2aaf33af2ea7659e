"""Gaussian and mean curvature."""

from dataclasses import dataclass
from typing import ClassVar

import igl
import numpy as np

from abfm.calculus.extension import extend
from abfm.calculus.operators import cotangent_laplacian, face_areas, face_normals
from abfm.errors import FunctionError
from abfm.functions.family import Family, choice, parameter
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray


@dataclass(frozen=True, kw_only=True)
class Curvature(Family):
    """Gaussian curvature (1/length^2), or mean curvature (1/length, positive where the surface bulges outward).

    See :func:`gaussian_curvature` and :func:`mean_curvature`. Both formulas hold off the boundary only: a boundary
    vertex gets the mean of its neighbours.

    References
    ----------
    Meyer, Desbrun, Schröder, Barr: Discrete Differential-Geometry Operators for Triangulated 2-Manifolds, 2003.
    """

    family: ClassVar[str] = "curvature"
    positional: ClassVar[str | None] = "kind"
    example: ClassVar[str] = "curvature:mean"
    kind: str = parameter(choice("gaussian", "mean"), "which curvature")

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        inner = ~mesh.is_boundary_vertex
        if not inner.any():
            raise FunctionError("curvature: every vertex lies on the boundary of this mesh, where it is not defined")
        curvature = gaussian_curvature if self.kind == "gaussian" else mean_curvature
        return extend(mesh, curvature(mesh), inner)


def gaussian_curvature(mesh: TriangleMesh) -> FloatArray:
    """Angle defect over mixed area (Meyer et al., equation 9), (V,), in 1/length^2; meaningless on a boundary."""
    return np.asarray(igl.gaussian_curvature(mesh.vertices, mesh.faces) / mixed_areas(mesh))


def mean_curvature(mesh: TriangleMesh) -> FloatArray:
    """Half the Laplacian of the coordinates (Meyer et al., equation 8) along the vertex normal, (V,), in 1/length.

    Positive on a sphere with outward normals; meaningless on a boundary.
    """
    curvature_normal = cotangent_laplacian(mesh) @ mesh.vertices / (2 * mixed_areas(mesh)[:, None])
    return np.asarray(np.einsum("vx,vx->v", curvature_normal, vertex_normals(mesh)))


def mixed_areas(mesh: TriangleMesh) -> FloatArray:
    """Voronoi area of each vertex, or half or a quarter of a face that is obtuse (Meyer et al., section 3.3), (V,).

    With a third of the adjacent faces instead, curvature stays 15% wrong at the 12 odd vertices of an icosphere.
    """
    return np.asarray(igl.massmatrix(mesh.vertices, mesh.faces, igl.MASSMATRIX_TYPE_VORONOI).diagonal())


def vertex_normals(mesh: TriangleMesh) -> FloatArray:
    """Unit normals at the vertices: along the area-weighted sum of the faces' normals, 0 where that is 0, (V, 3)."""
    weighted = np.repeat(face_areas(mesh)[:, None] * face_normals(mesh), 3, axis=0)  # at each corner
    normals = np.stack([np.bincount(mesh.faces.ravel(), w, minlength=len(mesh.vertices)) for w in weighted.T], axis=1)
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(float).tiny))
