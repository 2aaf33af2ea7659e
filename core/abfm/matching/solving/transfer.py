"""What goes from one mesh of a surface to another: functions and fields, by closest points.

Functions are interpolated from the coarse to the fine mesh and averaged the other way. Fields are
made continuous on the mesh that they come from, read at the points closest to the vertices, and
turned with the surface's normal onto the faces between them.
"""

from functools import cached_property

import numpy as np

from abfm.calculus.operators import Matrix, face_frames, face_normals, vertex_areas
from abfm.flow.continuous_flow import corner_vectors
from abfm.maps.point_maps import PointMap
from abfm.mesh import TriangleMesh
from abfm.numerics.kernels import kernel
from abfm.types import FloatArray, IndexArray


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
        _ = self.interpolation, self._covered, self._to_coarse

    @cached_property
    def interpolation(self) -> Matrix:
        """Linear interpolation of coarse vertex functions at the points closest to the fine
        vertices, (V, V_coarse).
        """
        return self._to_fine.to_matrix()

    @cached_property
    def _covered(self) -> FloatArray:
        """Area of the fine mesh under the hat function of each coarse vertex."""
        return np.asarray(self.interpolation.T @ vertex_areas(self.fine))

    def function_to_coarse(self, f: FloatArray) -> FloatArray:
        """Averages of fine functions (..., V) with the coarse hat functions as weights, (...,
        V_coarse).
        """
        totals = self.interpolation.T @ (vertex_areas(self.fine) * f).T
        averages = (totals.T / np.where(self._covered > 0, self._covered, 1.0)).copy()
        # no fine vertex near: take the closest point's value
        alone = np.flatnonzero(self._covered == 0)
        if len(alone):
            points = self._to_coarse
            corners = f[..., self.fine.faces[points.faces[alone]]]
            averages[..., alone] = (corners * points.barycentric[alone]).sum(axis=-1)
        return np.asarray(averages)

    def function_to_fine(self, f: FloatArray) -> FloatArray:
        """Coarse functions (..., V_coarse) interpolated, (..., V)."""
        return np.ascontiguousarray((self.interpolation @ f.T).T)

    @cached_property
    def _to_fine(self) -> PointMap:
        return PointMap.project(self.fine, self.coarse, self.fine.vertices)

    @cached_property
    def _to_coarse(self) -> PointMap:
        return PointMap.project(self.coarse, self.fine, self.coarse.vertices)

    def field_to_fine(self, field: FloatArray) -> FloatArray:
        """A coarse field (F_coarse, 3) on the fine mesh, as frame coefficients (F, 2)."""
        return _read(field, self._to_fine)

    def field_to_coarse(self, field: FloatArray) -> FloatArray:
        """A fine field (F, 3) on the coarse mesh, as frame coefficients (F_coarse, 2)."""
        return _read(field, self._to_coarse)


def _read(field: FloatArray, points: PointMap) -> FloatArray:
    """Read the continuous field of the codomain at the images of the domain's vertices, turned onto
    the domain's faces.
    """
    mesh, other = points.codomain, points.domain
    vectors = (corner_vectors(mesh, field)[points.faces] * points.barycentric).sum(axis=1)
    frames = face_frames(mesh)[points.faces]
    found = vectors.real[:, None] * frames[:, 0] + vectors.imag[:, None] * frames[:, 1]
    normals = face_normals(mesh)[points.faces]
    onto = other.faces, face_normals(other), face_frames(other)
    carried: FloatArray = turn_onto_faces(found, normals, *onto)
    return carried


@kernel
def turn_onto_faces(
    vectors: FloatArray,
    normals: FloatArray,
    faces: IndexArray,
    face_normals: FloatArray,
    frames: FloatArray,
) -> FloatArray:
    """Return means of vectors (V, 3) at corners of faces, as coefficients (F, 2) in their frames.

    Each is rotated as the shortest rotation takes the unit normal (V, 3) that belongs to it to that
    of the face.
    """
    out = np.zeros((faces.shape[0], 2))
    for f in range(faces.shape[0]):
        n = face_normals[f]
        for c in range(3):
            v, m = vectors[faces[f, c]], normals[faces[f, c]]
            along = 1.0 + m[0] * n[0] + m[1] * n[1] + m[2] * n[2]
            height = v[0] * n[0] + v[1] * n[1] + v[2] * n[2]
            # where the normals are opposite the vector is projected
            share = height / along if along > 1e-3 else 0.0
            for k in range(2):
                e = frames[f, k]
                for x in range(3):
                    out[f, k] += (v[x] - share * m[x]) * e[x] / 3
    return out
