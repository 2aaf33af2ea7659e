"""Tangent fields as operators on functions and fields, and their flow (sections 4 and 6)."""

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from abfm.calculus.operators import Matrix, averaging, face_frames, gradient
from abfm.errors import AdvectionError, ParameterError, brief
from abfm.mesh import TriangleMesh
from abfm.numerics import kernels
from abfm.numerics.real_numbers import is_finite_number, real_numbers
from abfm.types import FloatArray

_STEP_NORM = 4.0  # a Taylor step of this norm loses under two digits to cancellation
_NORM_LIMIT = 1e5


def check_field(mesh: TriangleMesh, field: ArrayLike, name: str) -> FloatArray:
    """Return a field (F, 3) as an array.

    Raises
    ------
    ParameterError
        If it has another shape or values that are not finite.
    """
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


def to_ambient(mesh: TriangleMesh, coefficients: FloatArray) -> FloatArray:
    """Turn frame coefficients (..., F, 2) into vectors in space (..., F, 3)."""
    return np.asarray(np.einsum("...fk,fkx->...fx", coefficients, face_frames(mesh)))


def to_frame(mesh: TriangleMesh, field: FloatArray) -> FloatArray:
    """Turn vectors in space (..., F, 3) into coefficients (..., F, 2); a normal part is dropped."""
    return np.asarray(np.einsum("...fx,fkx->...fk", field, face_frames(mesh)))


def pointwise_inner(field: FloatArray) -> Matrix:
    """Return ``[v]^T``, which maps a field to ``<v, .>`` on faces, (F, 2F), for ``v`` (F, 2)."""
    count, width = field.shape
    rows = np.repeat(np.arange(count), width)
    return Matrix((field.ravel(), (rows, np.arange(count * width))), shape=(count, count * width))


def directional_derivative(mesh: TriangleMesh, v: FloatArray) -> Matrix:
    """Return ``D_v = I_V^F [v]^T grad`` on vertex functions, (V, V), for frame coefficients ``v``
    (F, 2) (section 4).

    No boundary condition: where ``v`` crosses the boundary, values flow in and out.
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
    """Return ``ad_v u = [v, u]`` as an operator on fields, (2F, 2F), for frame coefficients ``v``
    (F, 2) (Eq. 11).

    Exactly antisymmetric, ``[v, u] = -[u, v]``; ``D_[v,u] = D_v D_u - D_u D_v`` (Eq. 10) and the
    Jacobi identity hold in the limit of fine meshes. Eq. 11 acts on the components of fields in
    space; here it is read in the face frames, which also drops the normal part that the printed
    (3F, 3F) operator picks up from the turning of the tangent planes. No boundary condition.
    """
    components = to_ambient(mesh, v)
    frames = face_frames(mesh)
    derivative = face_directional_derivative(mesh, v)
    spread = [
        sparse.csr_array(pointwise_inner(np.ascontiguousarray(frames[:, :, x]))) for x in range(3)
    ]
    bracket = sparse.csr_array((2 * len(mesh.faces), 2 * len(mesh.faces)))
    for x in range(3):
        slope = (gradient(mesh) @ (averaging(mesh) @ components[:, x])).reshape(-1, 2)
        bracket = bracket + spread[x].T @ (derivative @ spread[x] - pointwise_inner(slope))
    return Matrix(bracket)


def lie_bracket_of(mesh: TriangleMesh, v: ArrayLike, u: ArrayLike) -> FloatArray:
    """Return the Lie bracket ``[v, u]``, (F, 3): the field whose derivative is ``D_v D_u - D_u
    D_v`` (Eqs. 10 and 11).

    Zero where the two flows commute. On smoothly varying meshes the error falls in proportion to
    the edge length.

    Parameters
    ----------
    mesh : TriangleMesh
    v, u : (F, 3) arrays
        Tangent vectors, in the mesh's length unit per unit of time; a normal part is dropped.

    Raises
    ------
    ParameterError
        If a field has another shape or values that are not finite, or their bracket overflows.
    """
    first, second = (
        to_frame(mesh, check_field(mesh, field, name)) for field, name in ((v, "v"), (u, "u"))
    )
    with np.errstate(over="ignore", invalid="ignore"):
        found = lie_bracket(mesh, first) @ second.ravel()
    if not np.isfinite(found).all():
        raise ParameterError("the bracket overflows: scale the fields down")
    return to_ambient(mesh, found.reshape(-1, 2))


def exponential_action(matrix: Matrix, x: FloatArray, t: float) -> FloatArray:
    """Compute ``exp(t matrix) x`` for a sparse matrix (n, n) and ``x`` (n,), to rounding.

    The result is not finite where the exponential overflows.

    Raises
    ------
    AdvectionError
        If ``t matrix`` is not finite or so large that the sum would not end in reasonable time.
    """
    bound = abs(t) * float(np.min([abs(matrix).sum(axis=axis).max() for axis in (0, 1)]))
    if not bound <= _NORM_LIMIT:
        raise AdvectionError(
            f"the exponential of a matrix of norm {bound:.0e} was asked for (at most "
            f"{_NORM_LIMIT:.0e}): shorten the time or slow the field"
        )
    steps = max(1, int(np.ceil(bound / _STEP_NORM)))
    for _ in range(steps):
        term = x
        order = 0
        while np.abs(term).max() > 1e-16 * np.abs(x).max():
            order += 1
            term = kernels.product(matrix, term) * (t / steps / order)
            x = x + term
    return x


def pushforward(mesh: TriangleMesh, v: ArrayLike, u: ArrayLike, t: float) -> FloatArray:
    """Return the field ``u`` carried along the flow of ``v`` for a time, (F, 3): ``exp(-t ad_v)
    u``.

    Eq. 12 prints ``exp(t ad_v)``. With the bracket of Eq. 10 that is the pullback, which is the
    pushforward for ``-t``: rotating a sphere, for example, must turn a field along, and only the
    minus sign does. On smoothly varying meshes the error falls in proportion to the edge length.

    Parameters
    ----------
    mesh : TriangleMesh
    v, u : (F, 3) arrays
        Tangent vectors, ``v`` in the mesh's length unit per unit of time; a normal part is dropped.
    t : float
        Time of either sign.

    Raises
    ------
    ParameterError
        If a field has another shape or values that are not finite.
    AdvectionError
        If the time is not finite, the flow is too long, or the carried field overflows.
    """
    if not is_finite_number(t):
        raise AdvectionError(f"t is {brief(t)}; expected a finite time: shorten the time")
    velocity, field = (
        to_frame(mesh, check_field(mesh, w, name)) for w, name in ((v, "v"), (u, "u"))
    )
    carried = exponential_action(lie_bracket(mesh, velocity), field.ravel(), -t)
    if not np.isfinite(carried).all():
        raise AdvectionError("the carried field overflows: shorten the time or slow the field")
    return to_ambient(mesh, carried.reshape(-1, 2))
