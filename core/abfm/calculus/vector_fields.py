"""Tangent fields: operators, flow (sections 4 and 6), Helmholtz-Hodge parts, commuting fields."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.sparse.linalg import LinearOperator

from abfm.calculus.eigenbasis import lanczos
from abfm.calculus.operators import (
    Matrix,
    averaging,
    edge_lengths,
    face_areas,
    face_frames,
    field_mass,
    gradient,
    hodge_gradients,
    hodge_laplacian,
    rotation,
)
from abfm.errors import AdvectionError, MeshError, ParameterError, brief
from abfm.mesh import TriangleMesh, per_mesh
from abfm.numerics import kernels
from abfm.numerics.cholesky import factor
from abfm.numerics.real_numbers import is_finite_number, is_integer, real_numbers
from abfm.types import FloatArray, IntArray

Projection = Callable[[FloatArray], FloatArray]
_WEIGHT_MAX = 1e100  # largest weight of a bracket
_STEP_NORM = 4.0  # a Taylor step of this norm loses less than two digits to cancellation
_NORM_LIMIT = 1e5


def check_field(mesh: TriangleMesh, field: ArrayLike, name: str) -> FloatArray:
    """Check that a field has one finite vector for each face; return it as an array (F, 3)."""
    array = real_numbers(field, name, ParameterError)
    if array.shape != (len(mesh.faces), 3):
        raise ParameterError(
            f"{name} has shape {array.shape}; expected {(len(mesh.faces), 3)}, a vector per face"
        )
    if not np.isfinite(array).all():
        raise ParameterError(
            f"{name} has values that are not finite; expected one finite vector per face"
        )
    return array


def _in_frames(mesh: TriangleMesh, v: ArrayLike, u: ArrayLike) -> Sequence[FloatArray]:
    return [to_frame(mesh, check_field(mesh, w, name)) for w, name in ((v, "v"), (u, "u"))]


def to_ambient(mesh: TriangleMesh, coefficients: FloatArray) -> FloatArray:
    """Convert frame coefficients (..., F, 2) into vectors in space (..., F, 3)."""
    return np.asarray(np.einsum("...fk,fkx->...fx", coefficients, face_frames(mesh)))


def to_frame(mesh: TriangleMesh, field: FloatArray) -> FloatArray:
    """Convert the tangent parts of vectors in space (..., F, 3) into coefficients (..., F, 2)."""
    return np.asarray(np.einsum("...fx,fkx->...fk", field, face_frames(mesh)))


def pointwise_inner(field: FloatArray) -> Matrix:
    """Return ``[v]^T``, which maps a field to ``<v, .>`` on faces, (F, 2F), for ``v`` (F, 2)."""
    columns = np.arange(field.size)
    entries = field.ravel(), (columns // 2, columns)
    return Matrix(entries, shape=(len(field), field.size))


def directional_derivative(mesh: TriangleMesh, v: FloatArray) -> Matrix:
    """Return ``D_v = I_V^F [v]^T grad`` on vertex functions, (V, V) (section 4).

    ``v`` (F, 2) holds frame coefficients. Where ``v`` crosses the boundary, values flow in and out.
    """
    return Matrix(averaging(mesh) @ pointwise_inner(v) @ gradient(mesh))


def dual_directional_derivative(mesh: TriangleMesh, f: FloatArray) -> Matrix:
    """Return ``D̄_f = I_V^F [grad f]^T`` on fields, (V, 2F), for ``f`` (V,) (section 4).

    The operator satisfies ``D̄_f v = D_v f``.
    """
    return Matrix(averaging(mesh) @ pointwise_inner((gradient(mesh) @ f).reshape(-1, 2)))


def face_directional_derivative(mesh: TriangleMesh, v: FloatArray) -> Matrix:
    """Return ``[v]^T grad I_F^V``, the derivative of face values along ``v``, (F, F) (section 6).

    Face values are first averaged at vertices, then differentiated. ``v`` (F, 2) holds frame
    coefficients.
    """
    return Matrix(pointwise_inner(v) @ gradient(mesh) @ averaging(mesh))


def lie_bracket(mesh: TriangleMesh, v: FloatArray) -> Matrix:
    """Return ``ad_v u = [v, u]`` as an operator on fields, (2F, 2F), for ``v`` (F, 2) (Eq. 11).

    The bracket is exactly antisymmetric. ``D_[v,u] = D_v D_u - D_u D_v`` (Eq. 10) and the Jacobi
    identity hold in the limit of fine meshes. Eq. 11 acts on the components of fields in space.
    This implementation reads it in the face frames, which drops the normal part of the printed (3F,
    3F) operator.
    """
    components, frames = to_ambient(mesh, v), face_frames(mesh)
    derivative = face_directional_derivative(mesh, v)
    bracket = Matrix((v.size, v.size))
    for x in range(3):
        spread = pointwise_inner(np.ascontiguousarray(frames[:, :, x]))
        slope = (gradient(mesh) @ (averaging(mesh) @ components[:, x])).reshape(-1, 2)
        bracket = bracket + spread.T @ (derivative @ spread - pointwise_inner(slope))
    return Matrix(bracket)


def lie_bracket_of(mesh: TriangleMesh, v: ArrayLike, u: ArrayLike) -> FloatArray:
    """Return the Lie bracket ``[v, u]``, (F, 3), of two fields (F, 3).

    The derivative along the bracket is ``D_v D_u - D_u D_v`` (Eqs. 10 and 11). On smoothly varying
    meshes the error is proportional to the edge length.
    """
    first, second = _in_frames(mesh, v, u)
    with np.errstate(over="ignore", invalid="ignore"):
        found = lie_bracket(mesh, first) @ second.ravel()
    if not np.isfinite(found).all():
        raise ParameterError("the Lie bracket overflows; scale the fields down")
    return to_ambient(mesh, found.reshape(-1, 2))


def exponential_action(matrix: Matrix, x: FloatArray, t: float) -> FloatArray:
    """Compute ``exp(t matrix) x``, accurate up to rounding; an overflow gives infinities or NaN."""
    bound = abs(t) * float(np.min([abs(matrix).sum(axis=axis).max() for axis in (0, 1)]))
    if not bound <= _NORM_LIMIT:
        raise AdvectionError(
            f"the product of the time and the norm of the matrix is {bound:.0e}; expected at most "
            f"{_NORM_LIMIT:.0e}. Shorten the time or scale the field down"
        )
    steps = max(1, int(np.ceil(bound / _STEP_NORM)))
    for _ in range(steps):
        term, order = x, 0
        while np.abs(term).max() > 1e-16 * np.abs(x).max():
            order += 1
            term = kernels.product(matrix, term) * (t / steps / order)
            x = x + term
    return x


def pushforward(mesh: TriangleMesh, v: ArrayLike, u: ArrayLike, t: float) -> FloatArray:
    """Return a field ``u`` pushed forward along the flow of ``v``: ``exp(-t ad_v) u``, (F, 3).

    Fields are in the mesh's length unit per unit of time; ``t`` may be negative. Eq. 12 prints
    ``exp(t ad_v)``. With the bracket of Eq. 10 that is the pullback, which is the pushforward for
    ``-t``. The sign matters: rotating a sphere, for example, must rotate a field with it.
    """
    if not is_finite_number(t):
        raise AdvectionError(f"t is {brief(t)}; expected a finite time. Shorten the time")
    velocity, field = _in_frames(mesh, v, u)
    pushed = exponential_action(lie_bracket(mesh, velocity), field.ravel(), -t)
    if not np.isfinite(pushed).all():
        raise AdvectionError(
            "the field overflows along the flow; shorten the time or scale the field down"
        )
    return to_ambient(mesh, pushed.reshape(-1, 2))


def helmholtz_hodge(mesh: TriangleMesh, v: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Split a field (F, 3) of any unit into a gradient, a rotated gradient and a harmonic field.

    The parts are orthogonal in L2 and sum to ``v``, both up to rounding; a normal part is dropped.
    All flux of the field through a boundary belongs to the gradient, and the other two parts are
    tangent to the boundary.

    The first part is the gradient, face by face, of an edge (Crouzeix-Raviart) function. The second
    is the gradient of a vertex function that vanishes on the boundary, rotated by 90 degrees. The
    remainder is harmonic. The dimension of the space of harmonic fields is the number of
    independent loops.
    """
    field = to_frame(mesh, check_field(mesh, v, "v")).ravel()
    gradient, rotated = (project(field) for project in _projections(mesh))
    parts = (gradient, rotated, field - gradient - rotated)
    if not np.isfinite(parts[2]).all():
        raise ParameterError("the parts of v overflow; scale it down")
    first, second, third = (to_ambient(mesh, part.reshape(-1, 2)) for part in parts)
    return first, second, third


@per_mesh
def _projections(mesh: TriangleMesh) -> tuple[Projection, Projection]:
    """Return the projections of coefficients (2F,) onto gradients and onto rotated gradients.

    They are orthogonal in the inner product of ``G_F``.
    """
    edges, vertices = hodge_gradients(mesh)
    # one edge of each part is grounded, as a pinched vertex does not connect edges of two parts
    first_faces = np.unique(mesh.parts, return_index=True)[1]
    first_edges, first_vertex = mesh.face_edges[first_faces, 0], np.arange(int(mesh.is_closed))
    mass = field_mass(mesh)
    return _onto_range(edges, mass, first_edges), _onto_range(vertices, mass, first_vertex)


def _onto_range(gradient: Matrix, mass: Matrix, grounded: IntArray) -> Projection:
    """Return the projection onto the range of a gradient matrix, orthogonal in ``mass``.

    The ``grounded`` unknowns (columns) are fixed to 0, which makes the solution unique.
    """
    free = np.setdiff1d(np.arange(gradient.shape[1]), grounded)
    basis = Matrix(gradient[:, free])
    solve = factor(Matrix(basis.T @ mass @ basis))

    def project(field: FloatArray) -> FloatArray:
        return np.asarray(basis @ solve(basis.T @ (mass @ field)))

    return project


def commuting_fields(
    mesh: TriangleMesh, v: ArrayLike, count: int = 1, weight: float | None = None
) -> FloatArray:
    """Find the smoothest fields that commute with ``v``, smoothest first (section 6, Figure 5).

    The fields minimise ``|div u|^2 + |curl u|^2 + weight |[v, u]|^2 / |v|^2`` over fields of unit
    norm. Norms are in L2, and ``|v|`` is the root mean square. The fields are orthogonal in L2 to
    each other and to ``v``, which commutes with itself. The boundary condition is that of
    `hodge_laplacian`. If ``v`` has a first integral ``f``, the products of ``v`` with functions of
    ``f`` commute with it and are also found. On a mesh no other field commutes exactly, so a weight
    replaces the constraint. The bracket vanishes in proportion to the edge length on smoothly
    varying meshes.

    Parameters
    ----------
    v : (F, 3) array
        Tangent vectors, in any unit; a normal part is dropped.
    weight : float, optional
        Weight of the bracket; by default sqrt(area) over the mean edge length. 0 gives the
        smoothest fields of all.

    Returns
    -------
    (count, F, 3) array
        Fields with the root mean square of ``v``. Each field has a positive product with ``v``
        rotated by 90 degrees plus ``v`` times its squared speed, unless that vanishes.
    """
    field = to_frame(mesh, check_field(mesh, v, "v"))
    areas = face_areas(mesh)
    area = float(areas.sum())
    with np.errstate(over="ignore"):
        speed = float(np.sqrt(areas @ (field**2).sum(axis=1) / area))
    if not 0 < speed < np.inf:
        raise ParameterError(
            "v is zero, or its square overflows; expected a field that is not zero"
        )
    most = len(areas)
    if not is_integer(count, 1, most):
        raise ParameterError(
            f"{brief(count)} commuting fields requested; expected 1 to {most} on {most} faces"
        )
    if weight is None:
        weight = float(np.sqrt(area) / edge_lengths(mesh).mean())
    if not (is_finite_number(weight) and 0 <= float(weight) <= _WEIGHT_MAX):
        raise ParameterError(
            f"weight is {brief(weight)}; expected a number from 0 to {_WEIGHT_MAX:g}"
        )
    field = field / speed
    # coefficients times this root have the L2 norm as their Euclidean norm
    root = np.sqrt(np.repeat(areas / area, 2))
    scale, inverse_scale = sparse.diags_array(root), sparse.diags_array(1 / root)
    # area * G_F^-1/2 (G_F Delta) G_F^-1/2
    hodge = inverse_scale @ hodge_laplacian(mesh) @ inverse_scale
    bracket = np.sqrt(area) * Matrix(scale @ lie_bracket(mesh, field) @ inverse_scale)
    operator = Matrix(hodge + float(weight) * (bracket.T @ bracket))
    found = _lowest(operator, root * field.ravel(), int(count))
    fields = (found.T / root).reshape(-1, *field.shape)
    rotated = (rotation(mesh) @ field.ravel()).reshape(field.shape)
    reference = rotated + field * (field**2).sum(axis=1, keepdims=True)
    fields[np.einsum("f,nfk,fk->n", areas, fields, reference) < 0] *= -1
    return to_ambient(mesh, speed * fields)


def relative_bracket(mesh: TriangleMesh, v: ArrayLike, u: ArrayLike) -> float:
    """Return ``sqrt(area) |[v, u]| / (|v| |u|)`` of fields (F, 3), with root mean squares.

    The result has no unit, and is 0 for fields that commute.
    """
    areas = face_areas(mesh)
    of_v, of_u = (float(np.sqrt(areas @ (w**2).sum(axis=1))) for w in _in_frames(mesh, v, u))
    both = float(np.sqrt(areas @ (lie_bracket_of(mesh, v, u) ** 2).sum(axis=1)))
    if of_v * of_u == 0:
        raise ParameterError("v or u is zero, so the relative bracket is not defined")
    return float(areas.sum()) * both / (of_v * of_u)


def _lowest(operator: Matrix, known: FloatArray, count: int) -> FloatArray:
    """Return the lowest eigenvectors (n, count) that are orthogonal to ``known`` (n,)."""
    size = len(known)
    solve = factor(Matrix(operator + sparse.eye_array(size)))
    of_known = solve(known)
    lift = float(known @ of_known)

    def inverse(b: FloatArray) -> FloatArray:
        x = solve(b - known * (known @ b))
        return x - of_known * (float(known @ x) / lift)

    inverses = LinearOperator((size, size), matvec=inverse, dtype=np.float64)
    values, vectors = lanczos(inverses, count, MeshError, "commuting fields", which="LA", tol=1e-9)
    return vectors[:, np.argsort(-values, kind="stable")]
