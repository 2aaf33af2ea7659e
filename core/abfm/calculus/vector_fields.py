"""Tangent fields: as operators on functions and fields, and their flow (sections 4 and 6); their
parts, in the mixed form of `hodge_gradients`; and which commute.
"""

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
_WEIGHT_MAX = 1e100  # weight of a bracket
_STEP_NORM = 4.0  # a Taylor step of this norm loses under two digits to cancellation
_NORM_LIMIT = 1e5


def check_field(mesh: TriangleMesh, field: ArrayLike, name: str) -> FloatArray:
    """Check a field (F, 3) and return it as an array."""
    array = real_numbers(field, name, ParameterError)
    if array.shape != (len(mesh.faces), 3):
        raise ParameterError(
            f"{name} has shape {array.shape}; expected {(len(mesh.faces), 3)}, a vector per face"
        )
    if not np.isfinite(array).all():
        raise ParameterError(
            f"{name} has values that are not finite: give one finite vector per face"
        )
    return array


def _in_frames(mesh: TriangleMesh, v: ArrayLike, u: ArrayLike) -> Sequence[FloatArray]:
    return [to_frame(mesh, check_field(mesh, w, name)) for w, name in ((v, "v"), (u, "u"))]


def to_ambient(mesh: TriangleMesh, coefficients: FloatArray) -> FloatArray:
    """Turn frame coefficients (..., F, 2) into vectors in space (..., F, 3)."""
    return np.asarray(np.einsum("...fk,fkx->...fx", coefficients, face_frames(mesh)))


def to_frame(mesh: TriangleMesh, field: FloatArray) -> FloatArray:
    """Turn vectors in space (..., F, 3) into coefficients (..., F, 2); a normal part is dropped."""
    return np.asarray(np.einsum("...fx,fkx->...fk", field, face_frames(mesh)))


def pointwise_inner(field: FloatArray) -> Matrix:
    """Return ``[v]^T``, which maps a field to ``<v, .>`` on faces, (F, 2F), for ``v`` (F, 2)."""
    columns = np.arange(field.size)
    entries = field.ravel(), (columns // 2, columns)
    return Matrix(entries, shape=(len(field), field.size))


def directional_derivative(mesh: TriangleMesh, v: FloatArray) -> Matrix:
    """Return ``D_v = I_V^F [v]^T grad`` on vertex functions, (V, V), for frame coefficients ``v``
    (F, 2) (section 4). Where ``v`` crosses the boundary, values flow in and out.
    """
    return Matrix(averaging(mesh) @ pointwise_inner(v) @ gradient(mesh))


def dual_directional_derivative(mesh: TriangleMesh, f: FloatArray) -> Matrix:
    """Return ``D̄_f = I_V^F [grad f]^T`` on fields, (V, 2F), with ``D̄_f v = D_v f``, for ``f``
    (V,) (section 4).
    """
    return Matrix(averaging(mesh) @ pointwise_inner((gradient(mesh) @ f).reshape(-1, 2)))


def face_directional_derivative(mesh: TriangleMesh, v: FloatArray) -> Matrix:
    """Return ``[v]^T grad I_F^V``, (F, F): face values averaged, then derived (section 6)."""
    return Matrix(pointwise_inner(v) @ gradient(mesh) @ averaging(mesh))


def lie_bracket(mesh: TriangleMesh, v: FloatArray) -> Matrix:
    """Return ``ad_v u = [v, u]`` as an operator on fields, (2F, 2F), for ``v`` (F, 2) (Eq. 11).

    Exactly antisymmetric; ``D_[v,u] = D_v D_u - D_u D_v`` (Eq. 10) and the Jacobi identity hold in
    the limit of fine meshes. Eq. 11 acts on the components of fields in space; here it is read in
    the face frames, which also drops the normal part that the printed (3F, 3F) operator picks up.
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
    """Return the Lie bracket ``[v, u]`` of fields (F, 3), whose derivative is ``D_v D_u - D_u D_v``
    (Eqs. 10 and 11), (F, 3). On smoothly varying meshes the error falls as the edge length.
    """
    first, second = _in_frames(mesh, v, u)
    with np.errstate(over="ignore", invalid="ignore"):
        found = lie_bracket(mesh, first) @ second.ravel()
    if not np.isfinite(found).all():
        raise ParameterError("the bracket overflows: scale the fields down")
    return to_ambient(mesh, found.reshape(-1, 2))


def exponential_action(matrix: Matrix, x: FloatArray, t: float) -> FloatArray:
    """Compute ``exp(t matrix) x`` to rounding; not finite where it overflows."""
    bound = abs(t) * float(np.min([abs(matrix).sum(axis=axis).max() for axis in (0, 1)]))
    if not bound <= _NORM_LIMIT:
        raise AdvectionError(
            f"the exponential of a matrix of norm {bound:.0e} was asked for (at most "
            f"{_NORM_LIMIT:.0e}): shorten the time or slow the field"
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
    """Return a field ``u`` (F, 3) carried along the flow of ``v`` (F, 3), in the mesh's length unit
    per unit of time, for a time of either sign: ``exp(-t ad_v) u``.

    Eq. 12 prints ``exp(t ad_v)``. With the bracket of Eq. 10 that is the pullback, which is the
    pushforward for ``-t``: rotating a sphere, for example, must turn a field along.
    """
    if not is_finite_number(t):
        raise AdvectionError(f"t is {brief(t)}; expected a finite time: shorten the time")
    velocity, field = _in_frames(mesh, v, u)
    carried = exponential_action(lie_bracket(mesh, velocity), field.ravel(), -t)
    if not np.isfinite(carried).all():
        raise AdvectionError("the carried field overflows: shorten the time or slow the field")
    return to_ambient(mesh, carried.reshape(-1, 2))


def helmholtz_hodge(mesh: TriangleMesh, v: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Split a field (F, 3) of any unit into a gradient, a rotated gradient and a harmonic field.

    The three are orthogonal in L2 and sum to ``v``, both to rounding; a normal part is dropped. On
    a boundary the gradient takes all flux through it: the other two are tangent to the boundary.
    They are the gradient, face by face, of an edge (Crouzeix-Raviart) function; that of a vertex
    function that vanishes on the boundary, turned by 90 degrees; and the rest, of as many
    dimensions as there are independent loops.
    """
    field = to_frame(mesh, check_field(mesh, v, "v")).ravel()
    gradient, rotated = (project(field) for project in _projections(mesh))
    parts = (gradient, rotated, field - gradient - rotated)
    if not np.isfinite(parts[2]).all():
        raise ParameterError("the parts of v overflow: scale it down")
    first, second, third = (to_ambient(mesh, part.reshape(-1, 2)) for part in parts)
    return first, second, third


@per_mesh
def _projections(mesh: TriangleMesh) -> tuple[Projection, Projection]:
    """Return ``G_F``-orthogonal projections of coefficients (2F,) onto both gradients' ranges."""
    edges, vertices = hodge_gradients(mesh)
    # pinched vertices do not join edges
    first_faces = np.unique(mesh.parts, return_index=True)[1]
    first_edges, first_vertex = mesh.face_edges[first_faces, 0], np.arange(int(mesh.is_closed))
    mass = field_mass(mesh)
    return _onto_range(edges, mass, first_edges), _onto_range(vertices, mass, first_vertex)


def _onto_range(gradient: Matrix, mass: Matrix, grounded: IntArray) -> Projection:
    """Return the projection onto a gradient's range; ``grounded`` unknowns fix its kernel."""
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

    Minimises ``|div u|^2 + |curl u|^2 + weight |[v, u]|^2 / |v|^2`` (norms in L2, ``|v|`` the root
    mean square) over fields of unit norm that are orthogonal in L2 to ``v``, which commutes with
    itself, and to each other; boundary condition of `hodge_laplacian`. Where ``v`` has a first
    integral ``f``, all products of ``v`` with functions of ``f`` commute with it and are found too.
    On a mesh no other field commutes exactly, so a weight takes the place of the constraint; the
    bracket vanishes in proportion to the edge length on smoothly varying meshes.

    Parameters
    ----------
    v : (F, 3) array
        Tangent vectors, in any unit; a normal part is dropped.
    weight : float, optional
        Of the bracket; by default sqrt(area) over the mean edge length, 0 for the smoothest of all.

    Returns
    -------
    (count, F, 3) array
        Each with the root mean square of ``v``, and a positive product with ``v`` turned by 90
        degrees plus ``v`` times its squared speed, unless that vanishes.
    """
    field = to_frame(mesh, check_field(mesh, v, "v"))
    areas = face_areas(mesh)
    area = float(areas.sum())
    with np.errstate(over="ignore"):
        speed = float(np.sqrt(areas @ (field**2).sum(axis=1) / area))
    if not 0 < speed < np.inf:
        raise ParameterError(
            "v is zero, or overflows when squared: every field commutes with none; give a field"
        )
    most = len(areas)
    if not is_integer(count, 1, most):
        raise ParameterError(
            f"{brief(count)} commuting fields asked for; on {most} faces it can be 1 to {most}"
        )
    if weight is None:
        weight = float(np.sqrt(area) / edge_lengths(mesh).mean())
    if not (is_finite_number(weight) and 0 <= float(weight) <= _WEIGHT_MAX):
        raise ParameterError(
            f"weight is {brief(weight)}; expected a number of at least 0 and at most "
            f"{_WEIGHT_MAX:g}"
        )
    field = field / speed
    # in units of it, the L2 norm is that of coefficients
    root = np.sqrt(np.repeat(areas / area, 2))
    times, over = sparse.diags_array(root), sparse.diags_array(1 / root)
    hodge = over @ hodge_laplacian(mesh) @ over  # area * G_F^-1/2 (G_F Delta) G_F^-1/2
    bracket = np.sqrt(area) * Matrix(times @ lie_bracket(mesh, field) @ over)
    operator = Matrix(hodge + float(weight) * (bracket.T @ bracket))
    found = _lowest(operator, root * field.ravel(), int(count))
    fields = (found.T / root).reshape(-1, *field.shape)
    turned = (rotation(mesh) @ field.ravel()).reshape(field.shape)
    usual = turned + field * (field**2).sum(axis=1, keepdims=True)
    fields[np.einsum("f,nfk,fk->n", areas, fields, usual) < 0] *= -1
    return to_ambient(mesh, speed * fields)


def relative_bracket(mesh: TriangleMesh, v: ArrayLike, u: ArrayLike) -> float:
    """Return ``sqrt(area) |[v, u]| / (|v| |u|)``, with root mean squares, of fields (F, 3) with
    speed: without unit, 0 for fields that commute.
    """
    areas = face_areas(mesh)
    of_v, of_u = (float(np.sqrt(areas @ (w**2).sum(axis=1))) for w in _in_frames(mesh, v, u))
    both = float(np.sqrt(areas @ (lie_bracket_of(mesh, v, u) ** 2).sum(axis=1)))
    if of_v * of_u == 0:
        raise ParameterError("v or u is zero, so the bracket has nothing to be relative to")
    return float(areas.sum()) * both / (of_v * of_u)


def _lowest(operator: Matrix, known: FloatArray, count: int) -> FloatArray:
    """Return the lowest eigenvectors orthogonal to ``known``, (n, count), by inverses."""
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
