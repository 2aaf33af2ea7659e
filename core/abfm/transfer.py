"""What goes from one mesh of a surface to another: functions and fields, by closest points.

Functions are interpolated from the coarse to the fine mesh and averaged the other way. Fields are made continuous on
the mesh that they come from, read at the closest points, and turned with the surface's normal.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy import sparse

from abfm.flow_maps import SurfacePoints, project_onto_surface
from abfm.mesh import FloatArray, TriangleMesh
from abfm.operators import Matrix, face_frames, face_normals, vertex_areas
from abfm.smooth_flow import smooth_flow
from abfm.vector_fields import to_frame


class Transfer:
    """Between a coarse and a fine mesh of one surface, in the same units.

    Parameters
    ----------
    coarse, fine : TriangleMesh
    """

    def __init__(self, coarse: TriangleMesh, fine: TriangleMesh) -> None:
        self.coarse, self.fine = coarse, fine

    def prepare(self) -> None:
        """Find all closest points now, which else are found when they are first needed."""
        _ = self.interpolation, self._averaging, self._to_fine, self._to_coarse

    @cached_property
    def interpolation(self) -> Matrix:
        """Linear interpolation of coarse vertex functions at the points closest to the fine vertices, (V, V_coarse)."""
        points = project_onto_surface(self.coarse, self.fine.vertices)
        columns = self.coarse.faces[points.faces]
        rows = np.repeat(np.arange(len(columns)), 3)
        shape = (len(columns), len(self.coarse.vertices))
        return Matrix(sparse.csr_array((points.barycentric.ravel(), (rows, columns.ravel())), shape=shape))

    @cached_property
    def _averaging(self) -> Matrix:
        weighted = sparse.csr_array(self.interpolation.T @ sparse.diags_array(vertex_areas(self.fine)))
        totals = np.asarray(weighted.sum(axis=1))
        alone = np.flatnonzero(totals == 0)  # no fine vertex near: take the closest point's value
        if not len(alone):
            return Matrix(sparse.diags_array(1 / totals) @ weighted)
        points = project_onto_surface(self.fine, self.coarse.vertices[alone])
        entries = (points.barycentric.ravel(), (np.repeat(alone, 3), self.fine.faces[points.faces].ravel()))
        scaled = sparse.diags_array(np.where(totals > 0, 1 / np.where(totals > 0, totals, 1), 0)) @ weighted
        return Matrix(scaled + sparse.csr_array(entries, shape=weighted.shape))

    def function_to_coarse(self, f: FloatArray) -> FloatArray:
        """Averages of fine functions (..., V) with the coarse hat functions as weights, (..., V_coarse)."""
        return np.ascontiguousarray((self._averaging @ f.T).T)

    def function_to_fine(self, f: FloatArray) -> FloatArray:
        """Coarse functions (..., V_coarse) interpolated, (..., V)."""
        return np.ascontiguousarray((self.interpolation @ f.T).T)

    @cached_property
    def _to_fine(self) -> SurfacePoints:
        return project_onto_surface(self.coarse, self.fine.vertices[self.fine.faces].mean(axis=1))

    @cached_property
    def _to_coarse(self) -> SurfacePoints:
        return project_onto_surface(self.fine, self.coarse.vertices[self.coarse.faces].mean(axis=1))

    def field_to_fine(self, field: FloatArray) -> FloatArray:
        """A coarse field (F_coarse, 3) on the fine mesh, as frame coefficients (F, 2)."""
        return _read(self.coarse, field, self._to_fine, self.fine)

    def field_to_coarse(self, field: FloatArray) -> FloatArray:
        """A fine field (F, 3) on the coarse mesh, as frame coefficients (F_coarse, 2)."""
        return _read(self.fine, field, self._to_coarse, self.coarse)


def _read(mesh: TriangleMesh, field: FloatArray, points: SurfacePoints, other: TriangleMesh) -> FloatArray:
    """The continuous field at points of a mesh, turned onto the faces of another that belong to them."""
    flow = smooth_flow(mesh, field)
    frames = face_frames(mesh)[points.faces]
    places = np.einsum("px,pkx->pk", points.positions - mesh.vertices[mesh.faces[points.faces, 0]], frames)
    vectors = flow.vectors[points.faces]
    coefficients = vectors[:, 0] + places[:, :1] * vectors[:, 1] + places[:, 1:] * vectors[:, 2]
    found = np.einsum("pk,pkx->px", coefficients, frames)
    first, second = face_normals(mesh)[points.faces], face_normals(other)
    return to_frame(other, _turned(found, first, second))


def _turned(vectors: FloatArray, first: FloatArray, second: FloatArray) -> FloatArray:
    """Vectors (P, 3) rotated as the shortest rotation takes one unit normal to the other."""
    axis = np.cross(first, second)
    along = 1 + (first * second).sum(axis=1)  # zero where the normals are opposite: project there
    spread = np.divide((axis * vectors).sum(axis=1), along, out=np.zeros(len(along)), where=along > 1e-3)
    turned: FloatArray = (along - 1)[:, None] * vectors + np.cross(axis, vectors) + axis * spread[:, None]
    return turned
