"""Discrete differential operators (section 4), in the mesh's units, each built once per mesh.

Fields are piecewise constant on faces. They are stored as two coefficients in an orthonormal frame
of each face, so they are tangent by construction. A field is a ``(F, 2)`` array; row ``2 f + k`` of
an operator is component ``k`` in face ``f``. Functions are piecewise linear on vertices (hat
functions ``phi_i``) or on edges. The edge functions are Crouzeix-Raviart functions ``psi_e``, 1 on
their edge and -1 at the opposite corner.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from abfm.mesh import TriangleMesh, per_mesh
from abfm.numerics.kernels import kernel
from abfm.types import BoolArray, FloatArray, IndexArray, IntArray

Matrix = sparse.csr_array

# least height over longest edge; squares of smaller ones are lost in the rounding of a norm
THICKNESS_MIN = 1e-5


class FaceShapes(NamedTuple):
    """Normals, areas, frames and gradients of the faces."""

    normals: FloatArray  # (F, 3), unit normals
    areas: FloatArray  # (F,)
    frames: FloatArray  # (F, 2, 3), the first axis along the first edge
    gradients: FloatArray  # (F, 3, 2), gradients of the hat functions of the corners


class NormShapes(NamedTuple):
    """Areas and gradients of the hat functions, as used in a norm of tangent fields."""

    areas: FloatArray  # (F,)
    edge_areas: FloatArray  # (E,)
    vertex_areas: FloatArray  # (V,)
    gradients: FloatArray  # (F, 3, 2)


@per_mesh
def _shapes(mesh: TriangleMesh) -> FaceShapes:
    count = len(mesh.faces)
    sizes = (count, 3), count, (count, 2, 3), (count, 3, 2)
    found = FaceShapes(*(np.empty(size) for size in sizes))
    shapes(mesh.vertices, mesh.faces, found)
    return found


def face_normals(mesh: TriangleMesh) -> FloatArray:
    """Return unit face normals, (F, 3)."""
    return _shapes(mesh).normals


def face_areas(mesh: TriangleMesh) -> FloatArray:
    """Return face areas ``A_F``, (F,)."""
    return _shapes(mesh).areas


def face_frames(mesh: TriangleMesh) -> FloatArray:
    """Return right-handed orthonormal frames, (F, 2, 3), with the first axis from corner 0 to 1."""
    return _shapes(mesh).frames


def hat_gradients(mesh: TriangleMesh) -> FloatArray:
    """Return the gradients of the three hat functions of each face in its frame, (F, 3, 2)."""
    return _shapes(mesh).gradients


@per_mesh
def vertex_areas(mesh: TriangleMesh) -> FloatArray:
    """Return ``A_V``, the diagonal of ``G_V``: a third of the area of the adjacent faces, (V,)."""
    return _thirds(mesh.faces, face_areas(mesh), len(mesh.vertices))


@per_mesh
def edge_areas(mesh: TriangleMesh) -> FloatArray:
    """Return the exact Crouzeix-Raviart mass of edges: a third of the adjacent face areas, (E,)."""
    return _thirds(mesh.face_edges, face_areas(mesh), len(mesh.edges))


def _thirds(owners: IntArray, areas: FloatArray, count: int) -> FloatArray:
    """Return sums (count,) over faces; each adds a third of its area to its vertices or edges."""
    found = np.bincount(owners.ravel(), np.repeat(areas / 3, 3), minlength=count)
    return np.asarray(found, dtype=np.float64)


@per_mesh
def edge_lengths(mesh: TriangleMesh) -> FloatArray:
    """Return the lengths of the edges, (E,)."""
    first, second = mesh.vertices[mesh.edges.T]
    return np.asarray(np.linalg.norm(first - second, axis=1))


@per_mesh
def adjacency(mesh: TriangleMesh) -> Matrix:
    """Return the adjacency matrix of the vertices, (V, V), with 1 for each edge."""
    i, j = mesh.edges.T
    ends, size = (np.r_[i, j], np.r_[j, i]), len(mesh.vertices)
    return Matrix((np.ones(2 * len(i)), ends), shape=(size, size))


@per_mesh
def edge_graph(mesh: TriangleMesh) -> Matrix:
    """Return a matrix (V, V) with the length of each edge, in one direction only."""
    shape = (len(mesh.vertices),) * 2
    return Matrix((edge_lengths(mesh), tuple(mesh.edges.T)), shape=shape)


@per_mesh
def mollified_shapes(mesh: TriangleMesh) -> NormShapes:
    """Return areas and hat gradients for the norm of fields, with thin faces mollified.

    Faces whose height is less than 1e-5 of their longest edge are stretched to that height, as in
    the mollification of Sharp and Crane [2020]. The matrices of the norm are then definite.
    """
    areas, gradients = face_areas(mesh).copy(), hat_gradients(mesh).copy()
    steepest = (gradients**2).sum(axis=2).max(axis=1)  # inverse square of the height
    thickness = 1 / (2 * areas * steepest)
    thin = np.flatnonzero(thickness < THICKNESS_MIN)
    stretch, of_thin = THICKNESS_MIN / thickness[thin], gradients[thin]
    corner = (of_thin**2).sum(axis=2).argmax(axis=1)
    across = of_thin[np.arange(len(thin)), corner] / np.sqrt(steepest[thin])[:, None]
    components = np.einsum("fck,fk->fc", of_thin, across) * (1 - 1 / stretch)[:, None]
    areas[thin] *= stretch
    gradients[thin] -= components[:, :, None] * across[:, None, :]
    of_edges = _thirds(mesh.face_edges, areas, len(mesh.edges))
    return NormShapes(areas, of_edges, _thirds(mesh.faces, areas, len(mesh.vertices)), gradients)


def _face_operator(mesh: TriangleMesh, values: FloatArray, columns: IntArray, width: int) -> Matrix:
    """Return the matrix (2F, width) with ``values[f, c, k]`` at row ``2 f + k``.

    The column of this entry is ``columns[f, c]``.
    """
    height = 2 * len(mesh.faces)
    rows = np.broadcast_to(np.arange(height).reshape(-1, 1, 2), values.shape)
    entries = (rows.ravel(), np.broadcast_to(columns[..., None], values.shape).ravel())
    return Matrix((values.ravel(), entries), shape=(height, width))


@per_mesh
def gradient(mesh: TriangleMesh) -> Matrix:
    """Return ``grad``, which maps vertex functions to fields, (2F, V); no boundary condition."""
    return _face_operator(mesh, hat_gradients(mesh), mesh.faces, len(mesh.vertices))


@per_mesh
def edge_gradient(mesh: TriangleMesh) -> Matrix:
    """Return the broken gradient of edge (Crouzeix-Raviart) functions, (2F, E).

    The edge functions are ``psi_e = 1 - 2 phi_opposite``. There is no boundary condition.
    """
    return _face_operator(mesh, -2 * hat_gradients(mesh), mesh.face_edges, len(mesh.edges))


@per_mesh
def rotation(mesh: TriangleMesh) -> Matrix:
    """Return ``J``, the rotation of tangent vectors by +90 degrees, (2F, 2F)."""
    quarter_turn = sparse.csr_array(np.array([[0.0, -1.0], [1.0, 0.0]]))
    return Matrix(sparse.kron(sparse.eye_array(len(mesh.faces)), quarter_turn, format="csr"))


@per_mesh
def field_mass(mesh: TriangleMesh) -> Matrix:
    """Return ``G_F`` on field coefficients, (2F, 2F): the diagonal of repeated face areas."""
    return Matrix(sparse.diags_array(np.repeat(face_areas(mesh), 2)))


@per_mesh
def averaging(mesh: TriangleMesh) -> Matrix:
    """Return ``I_V^F``, the average of face values at vertices, (V, F).

    Entry (i, j) is ``A_F(j) / (3 A_V(i))`` if vertex i belongs to face j, and 0 otherwise. The
    average preserves constants and the integral. There is no boundary condition.
    """
    count, corners = len(mesh.faces), mesh.faces.ravel()
    weights = np.repeat(face_areas(mesh) / 3, 3) / vertex_areas(mesh)[corners]
    entries = weights, (corners, np.repeat(np.arange(count), 3))
    return Matrix(entries, shape=(len(mesh.vertices), count))


@per_mesh
def divergence(mesh: TriangleMesh) -> Matrix:
    """Return ``div = -G_V^-1 grad^T G_F``, (V, 2F) [BKP*10, chapter 3].

    The matrix maps fields to vertex functions. The field counts as zero beyond a boundary, so
    outward flux is negative divergence and the total is always zero. The natural condition is ``v .
    n = 0``.
    """
    inverse_mass = sparse.diags_array(1 / vertex_areas(mesh))
    return Matrix(-inverse_mass @ gradient(mesh).T @ field_mass(mesh))


@per_mesh
def curl(mesh: TriangleMesh) -> Matrix:
    """Return ``curl v = div(-J v)``, (V, 2F), which maps fields to vertex functions.

    The field counts as zero beyond a boundary, so circulation along it is curl of the opposite sign
    and the total is always zero. The natural condition is ``v x n = 0``.
    """
    return Matrix(-(divergence(mesh) @ rotation(mesh)))


@per_mesh
def cotangent_laplacian(mesh: TriangleMesh) -> Matrix:
    """Return the stiffness matrix ``grad^T G_F grad`` (cotangent weights), (V, V), semidefinite.

    The matrix is ``-G_V`` times the paper's Laplace-Beltrami operator, with the natural (Neumann)
    boundary condition.
    """
    return stiffness(hat_gradients(mesh), face_areas(mesh), mesh.faces, len(mesh.vertices))


def stiffness(gradients: FloatArray, weights: FloatArray, owners: IntArray, count: int) -> Matrix:
    """Return the matrix (count, count) of the form ``sum_f w_f <grad phi_a, grad phi_b>``.

    ``phi_a`` is the hat function of corner a of a face. ``owners[f, a]`` is the row and column of
    this corner, usually its vertex. If it is the edge opposite the corner, the matrix is a quarter
    of the form on edge functions.
    """
    entries = np.empty((len(owners), 3, 3))
    stiffnesses(gradients, weights, entries)
    small = owners.astype(np.int32)
    rows, columns = np.repeat(small, 3, axis=1), np.tile(small, (1, 3))
    return Matrix((entries.ravel(), (rows.ravel(), columns.ravel())), shape=(count, count))


@per_mesh
def hodge_gradients(mesh: TriangleMesh) -> tuple[Matrix, Matrix]:
    """Return ``(A, B)``, whose ranges are the curl-free and the divergence-free fields.

    ``A`` (2F, E) is the broken gradient of edge functions. ``B`` (2F, V') is the rotated gradient
    of functions on the V' vertices off the boundary. They define the mixed Hodge form, and ``A^T
    G_F B = 0`` up to rounding. The natural space of this form is fields with ``v . n = 0`` on the
    boundary, whose flow stays on the surface.
    """
    inner = ~mesh.is_boundary_vertex
    return edge_gradient(mesh), Matrix((rotation(mesh) @ gradient(mesh))[:, inner])


@per_mesh
def hodge_laplacian(mesh: TriangleMesh) -> Matrix:
    """Return ``G_F Delta_H``, the symmetric positive semidefinite mixed Hodge Laplacian, (2F, 2F).

    The quadratic form is the squared norm of the divergence at edges plus that of the curl at inner
    vertices. If divergence and curl were both at vertices, half of all fields would be in the
    kernel. If they were both at edges, the spectrum would be wrong. The boundary condition is ``v .
    n = 0`` and ``curl v = 0``.
    """
    a, b = hodge_gradients(mesh)
    mass = field_mass(mesh)
    inner = ~mesh.is_boundary_vertex
    div_part = mass @ a @ sparse.diags_array(1 / edge_areas(mesh)) @ a.T @ mass
    curl_part = mass @ b @ sparse.diags_array(1 / vertex_areas(mesh)[inner]) @ b.T @ mass
    return Matrix(div_part + curl_part)


def vector_norm_matrix(mesh: TriangleMesh, alpha: float) -> Matrix:
    """Return ``G_F D_alpha`` with ``D_alpha = id + alpha Delta_H``, (2F, 2F) (section 3).

    The matrix is symmetric positive definite, with the boundary condition of `hodge_laplacian`.
    """
    return Matrix(field_mass(mesh) + alpha * hodge_laplacian(mesh))


def function_norm_matrix(
    mesh: TriangleMesh, beta: float, weight: ArrayLike | None = None
) -> Matrix:
    """Return ``G_V C_beta`` with ``C_beta = id - beta Delta_LB``, (V, V) (section 3).

    The matrix is symmetric positive (semi)definite, with the natural boundary condition. A weight
    ``w`` (V,), not negative, gives the form ``int w (f^2 + beta |grad f|^2)``; a face has the
    smallest weight of its corners.
    """
    areas, face_weight = vertex_areas(mesh), face_areas(mesh)
    if weight is not None:
        w = np.asarray(weight, dtype=np.float64)
        areas, face_weight = areas * w, face_weight * w[mesh.faces].min(axis=1)
    mass = Matrix(sparse.diags_array(areas))
    if beta == 0:
        return mass
    return Matrix(mass + stiffness(hat_gradients(mesh), beta * face_weight, mesh.faces, len(areas)))


def l2_norm(mesh: TriangleMesh, f: FloatArray, mask: FloatArray | BoolArray | None = None) -> float:
    """Return ``||f||`` in L2 on the surface, over all channels of ``f`` (V,) or (V, C).

    The squared values are multiplied by ``mask`` (V,), such as True at the vertices that count.
    """
    areas = vertex_areas(mesh) if mask is None else vertex_areas(mesh) * mask
    return float(np.sqrt((areas * (f.T**2)).sum()))


@kernel
def shapes(vertices: FloatArray, faces: IndexArray, found: FaceShapes) -> None:
    normals, areas, frames, gradients = found
    for f in range(faces.shape[0]):
        a, b, c = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
        x, y, z = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        u, v, w = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        i, j, k = y * w - z * v, z * u - x * w, x * v - y * u
        twice = np.sqrt(i * i + j * j + k * k)
        base = np.sqrt(x * x + y * y + z * z)
        normals[f, 0], normals[f, 1], normals[f, 2] = i / twice, j / twice, k / twice
        areas[f] = 0.5 * twice
        n, e = normals[f], frames[f]
        e[0, 0], e[0, 1], e[0, 2] = x / base, y / base, z / base
        e[1, 0] = n[1] * e[0, 2] - n[2] * e[0, 1]
        e[1, 1] = n[2] * e[0, 0] - n[0] * e[0, 2]
        e[1, 2] = n[0] * e[0, 1] - n[1] * e[0, 0]
        along = u * e[0, 0] + v * e[0, 1] + w * e[0, 2]
        height = u * e[1, 0] + v * e[1, 1] + w * e[1, 2]
        g = gradients[f]
        g[0, 0], g[0, 1] = -height / twice, (along - base) / twice
        g[1, 0], g[1, 1] = height / twice, -along / twice
        g[2, 0], g[2, 1] = 0.0, base / twice


@kernel
def stiffnesses(gradients: FloatArray, weights: FloatArray, out: FloatArray) -> None:
    """Write weighted products of the gradients of each face's hat functions, (F, 3, 3)."""
    for f in range(weights.size):
        g = gradients[f]
        for a in range(3):
            for b in range(3):
                out[f, a, b] = weights[f] * (g[a, 0] * g[b, 0] + g[a, 1] * g[b, 1])
