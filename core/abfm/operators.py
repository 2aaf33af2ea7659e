"""Discrete differential operators of section 4, each built once per mesh.

Fields are piecewise constant on faces and kept as two coefficients in an orthonormal frame of each face, so they are
tangent by construction: a field is a ``(F, 2)`` array, and row ``2 f + k`` of an operator is component ``k`` in face
``f``. Functions are piecewise linear on vertices (hat functions ``phi_i``), or on edges (Crouzeix-Raviart functions
``psi_e``, 1 on their edge and -1 at the opposite corner). All operators are in the mesh's own units.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from abfm.mesh import BoolArray, FloatArray, IntArray, TriangleMesh, per_mesh

Matrix = sparse.csr_array


@per_mesh
def _face_normals_and_areas(mesh: TriangleMesh) -> tuple[FloatArray, FloatArray]:
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    return normals / lengths[:, None], 0.5 * lengths


def face_normals(mesh: TriangleMesh) -> FloatArray:
    """Unit normals, (F, 3)."""
    return _face_normals_and_areas(mesh)[0]


def face_areas(mesh: TriangleMesh) -> FloatArray:
    """Face areas ``A_F``, (F,)."""
    return _face_normals_and_areas(mesh)[1]


@per_mesh
def vertex_areas(mesh: TriangleMesh) -> FloatArray:
    """Vertex areas ``A_V``: a third of the adjacent faces' area, (V,). The diagonal of ``G_V``."""
    return _gather(mesh.faces, face_areas(mesh) / 3, len(mesh.vertices))


@per_mesh
def edge_areas(mesh: TriangleMesh) -> FloatArray:
    """Edge areas: a third of the adjacent faces' area, (E,). The (exact) Crouzeix-Raviart mass."""
    return _gather(mesh.face_edges, face_areas(mesh) / 3, len(mesh.edges))


def _gather(owners: IntArray, values: FloatArray, count: int) -> FloatArray:
    """Sum a value per face over the three owners (F, 3) of each face, (count,)."""
    return np.asarray(np.bincount(owners.ravel(), np.repeat(values, 3), minlength=count), dtype=np.float64)


@per_mesh
def face_frames(mesh: TriangleMesh) -> FloatArray:
    """Right-handed orthonormal tangent frames, (F, 2, 3): the first axis lies along the edge from corner 0 to 1."""
    first = mesh.vertices[mesh.faces[:, 1]] - mesh.vertices[mesh.faces[:, 0]]
    first /= np.linalg.norm(first, axis=1)[:, None]
    return np.stack([first, np.cross(face_normals(mesh), first)], axis=1)


@per_mesh
def hat_gradients(mesh: TriangleMesh) -> FloatArray:
    """Gradients of the three hat functions of each face in its frame, (F, 3, 2)."""
    corners = mesh.vertices[mesh.faces]
    opposite = np.roll(corners, -2, axis=1) - np.roll(corners, -1, axis=1)
    edge = np.einsum("fce,fke->fck", opposite, face_frames(mesh))
    return np.stack([-edge[..., 1], edge[..., 0]], axis=-1) / (2 * face_areas(mesh)[:, None, None])


def _face_operator(mesh: TriangleMesh, values: FloatArray, columns: IntArray, width: int) -> Matrix:
    """Matrix (2F, width) with ``values[f, c, k]`` at row ``2 f + k`` and column ``columns[f, c]``."""
    rows = np.broadcast_to(2 * np.arange(len(mesh.faces))[:, None, None] + np.arange(2), values.shape)
    entries = (rows.ravel(), np.broadcast_to(columns[..., None], values.shape).ravel())
    return Matrix((values.ravel(), entries), shape=(2 * len(mesh.faces), width))


@per_mesh
def gradient(mesh: TriangleMesh) -> Matrix:
    """``grad``: vertex functions to fields, (2F, V). No boundary condition."""
    return _face_operator(mesh, hat_gradients(mesh), mesh.faces, len(mesh.vertices))


@per_mesh
def edge_gradient(mesh: TriangleMesh) -> Matrix:
    """Broken gradient of edge (Crouzeix-Raviart) functions, ``psi_e = 1 - 2 phi_opposite``, (2F, E).

    No boundary condition.
    """
    return _face_operator(mesh, -2 * hat_gradients(mesh), mesh.face_edges, len(mesh.edges))


@per_mesh
def rotation(mesh: TriangleMesh) -> Matrix:
    """``J``: rotation of every tangent vector by +90 degrees about the face normal, (2F, 2F)."""
    quarter_turn = sparse.csr_array(np.array([[0.0, -1.0], [1.0, 0.0]]))
    return Matrix(sparse.kron(sparse.eye_array(len(mesh.faces)), quarter_turn, format="csr"))


@per_mesh
def field_mass(mesh: TriangleMesh) -> Matrix:
    """``G_F`` on field coefficients: diagonal of repeated face areas, (2F, 2F)."""
    return Matrix(sparse.diags_array(np.repeat(face_areas(mesh), 2)))


@per_mesh
def averaging(mesh: TriangleMesh) -> Matrix:
    """``I_V^F`` from faces to vertices, (V, F): ``A_F(j) / (3 A_V(i))`` where vertex i belongs to face j.

    Keeps constants and the integral. No boundary condition.
    """
    count = len(mesh.faces)
    weights = np.repeat(face_areas(mesh) / 3, 3) / vertex_areas(mesh)[mesh.faces.ravel()]
    return Matrix((weights, (mesh.faces.ravel(), np.repeat(np.arange(count), 3))), shape=(len(mesh.vertices), count))


@per_mesh
def divergence(mesh: TriangleMesh) -> Matrix:
    """``div = -G_V^-1 grad^T G_F``: fields to vertex functions, (V, 2F) [BKP*10, chapter 3].

    On a boundary the field counts as ending there, so that outward flux is negative divergence and the total is always
    zero: natural condition ``v . n = 0``.
    """
    return _weak_divergence(gradient(mesh), vertex_areas(mesh), mesh)


@per_mesh
def curl(mesh: TriangleMesh) -> Matrix:
    """``curl v = div(-J v)``: fields to vertex functions, (V, 2F).

    On a boundary the field counts as ending there, so that circulation along it is curl of the other sign and the total
    is always zero: natural condition ``v x n = 0``.
    """
    return Matrix(-(divergence(mesh) @ rotation(mesh)))


@per_mesh
def edge_divergence(mesh: TriangleMesh) -> Matrix:
    """Divergence as an edge function, (E, 2F): jump of the normal flux; natural condition ``v . n = 0``."""
    return _weak_divergence(edge_gradient(mesh), edge_areas(mesh), mesh)


def _weak_divergence(gradient: Matrix, areas: FloatArray, mesh: TriangleMesh) -> Matrix:
    return Matrix(-sparse.diags_array(1 / areas) @ gradient.T @ field_mass(mesh))


@per_mesh
def cotangent_laplacian(mesh: TriangleMesh) -> Matrix:
    """Stiffness matrix ``grad^T G_F grad`` (cotangent weights), (V, V), positive semidefinite.

    The Laplace-Beltrami operator of the paper is ``-G_V^-1`` times it. Natural (Neumann) boundary condition.
    """
    return Matrix(gradient(mesh).T @ field_mass(mesh) @ gradient(mesh))


@per_mesh
def hodge_gradients(mesh: TriangleMesh) -> tuple[Matrix, Matrix]:
    """``(A, B)``: gradients whose ranges are the curl-free and the divergence-free fields of the mixed Hodge form.

    ``A`` (2F, E) is the broken gradient of edge functions, ``B`` (2F, V') the rotated gradient of the functions on the
    V' vertices off the boundary. Then ``A^T G_F B = 0`` to rounding, and fields with ``v . n = 0`` on the boundary are
    the natural space (the flow stays on the surface).
    """
    inner = ~mesh.is_boundary_vertex
    return edge_gradient(mesh), Matrix((rotation(mesh) @ gradient(mesh))[:, inner])


@per_mesh
def hodge_laplacian(mesh: TriangleMesh) -> Matrix:
    """``G_F Delta_H``: symmetric positive semidefinite mixed Hodge Laplacian, (2F, 2F).

    ``v^T (G_F Delta_H) v`` is the squared norm of the divergence taken at edges plus that of the curl taken at the
    vertices off the boundary. Taking both at vertices leaves half of all fields in the kernel; taking both at edges
    gives a wrong spectrum. Boundary condition: ``v . n = 0`` and ``curl v = 0``.
    """
    a, b = hodge_gradients(mesh)
    mass = field_mass(mesh)
    inner = ~mesh.is_boundary_vertex
    div_part = mass @ a @ sparse.diags_array(1 / edge_areas(mesh)) @ a.T @ mass
    curl_part = mass @ b @ sparse.diags_array(1 / vertex_areas(mesh)[inner]) @ b.T @ mass
    return Matrix(div_part + curl_part)


def vector_norm_matrix(mesh: TriangleMesh, alpha: float) -> Matrix:
    """``G_F D_alpha`` with ``D_alpha = id + alpha Delta_H``, (2F, 2F), symmetric positive definite (section 3).

    Boundary condition of `hodge_laplacian`: ``v . n = 0`` and ``curl v = 0``.
    """
    return Matrix(field_mass(mesh) + alpha * hodge_laplacian(mesh))


def function_norm_matrix(mesh: TriangleMesh, beta: float, weight: ArrayLike | None = None) -> Matrix:
    """``G_V C_beta`` with ``C_beta = id - beta Delta_LB``, (V, V), symmetric positive (semi)definite (section 3).

    Natural (Neumann) boundary condition.

    Parameters
    ----------
    weight : (V,) array, optional
        Non-negative weight ``w`` of the mismatch: ``int w (f^2 + beta |grad f|^2)``. A face has the least weight of its
        corners, so that values where ``w`` is zero do not matter at all.
    """
    areas = vertex_areas(mesh)
    if weight is None:
        return Matrix(sparse.diags_array(areas) + beta * cotangent_laplacian(mesh))
    w = np.asarray(weight, dtype=np.float64)
    face_weight = sparse.diags_array(np.repeat(w[mesh.faces].min(axis=1), 2))
    stiffness = gradient(mesh).T @ face_weight @ field_mass(mesh) @ gradient(mesh)
    return Matrix(sparse.diags_array(areas * w) + beta * stiffness)


def l2_norm(mesh: TriangleMesh, f: FloatArray, mask: FloatArray | BoolArray | None = None) -> float:
    """``||f||`` in L2 on the surface, all channels of ``f`` (V,) or (V, C) together."""
    areas = vertex_areas(mesh) if mask is None else vertex_areas(mesh) * mask
    return float(np.sqrt((areas * (f.T**2)).sum()))
