"""Tangent vector fields as operators on functions (sections 4 and 6)."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from abfm.mesh import FloatArray, TriangleMesh
from abfm.operators import Matrix, averaging, face_frames, gradient


def to_ambient(mesh: TriangleMesh, coefficients: FloatArray) -> FloatArray:
    """Frame coefficients (..., F, 2) to vectors in space (..., F, 3)."""
    return np.einsum("...fk,fkx->...fx", coefficients, face_frames(mesh))


def to_frame(mesh: TriangleMesh, field: FloatArray) -> FloatArray:
    """Vectors in space (..., F, 3) to frame coefficients (..., F, 2); a normal part is dropped."""
    return np.einsum("...fx,fkx->...fk", field, face_frames(mesh))


def pointwise_inner(field: FloatArray) -> Matrix:
    """``[v]^T``: maps a field to the function ``<v, .>`` on faces, (F, 2F), for ``v`` (F, 2)."""
    count, width = field.shape
    rows = np.repeat(np.arange(count), width)
    return Matrix((field.ravel(), (rows, np.arange(count * width))), shape=(count, count * width))


def directional_derivative(mesh: TriangleMesh, v: FloatArray) -> Matrix:
    """``D_v = I_V^F [v]^T grad`` on vertex functions, (V, V), for frame coefficients ``v`` (F, 2) (section 4)."""
    return Matrix(averaging(mesh) @ pointwise_inner(v) @ gradient(mesh))


def dual_directional_derivative(mesh: TriangleMesh, f: FloatArray) -> Matrix:
    """``D̄_f = I_V^F [grad f]^T`` on fields, (V, 2F), with ``D̄_f v = D_v f``, for ``f`` (V,) (section 4)."""
    return Matrix(averaging(mesh) @ pointwise_inner((gradient(mesh) @ f).reshape(-1, 2)))


def face_directional_derivative(mesh: TriangleMesh, v: FloatArray) -> Matrix:
    """``[v]^T grad I_F^V`` on face functions, (F, F): face values averaged to vertices, then derived (section 6)."""
    return Matrix(pointwise_inner(v) @ gradient(mesh) @ averaging(mesh))


def lie_bracket(mesh: TriangleMesh, v: FloatArray) -> Matrix:
    """``ad_v u = [v, u] = D_v D_u - D_u D_v`` as an operator on fields, (2F, 2F) (Eq. 11).

    Eq. 11 acts on the components of fields in space; here it is read in the face frames, which also drops the normal
    part that the printed (3F, 3F) operator picks up from the turning of the tangent planes.
    """
    components = to_ambient(mesh, v)
    frames = face_frames(mesh)
    derivative = face_directional_derivative(mesh, v)
    spread = [sparse.csr_array(pointwise_inner(np.ascontiguousarray(frames[:, :, x]))) for x in range(3)]
    bracket = sparse.csr_array((2 * len(mesh.faces), 2 * len(mesh.faces)))
    for x in range(3):
        slope = (gradient(mesh) @ (averaging(mesh) @ components[:, x])).reshape(-1, 2)
        bracket = bracket + spread[x].T @ (derivative @ spread[x] - pointwise_inner(slope))
    return Matrix(bracket)
