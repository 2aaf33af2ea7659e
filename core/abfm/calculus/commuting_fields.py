"""The smoothest fields that commute with a given one (section 6, Figure 5)."""

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.sparse.linalg import ArpackError, LinearOperator, eigsh

from abfm.calculus.operators import Matrix, edge_lengths, face_areas, hodge_laplacian, rotation
from abfm.calculus.vector_fields import (
    check_field,
    lie_bracket,
    lie_bracket_of,
    to_ambient,
    to_frame,
)
from abfm.errors import MeshError, ParameterError, brief
from abfm.mesh import TriangleMesh
from abfm.numerics.cholesky import factor
from abfm.numerics.real_numbers import is_finite_number, is_whole_number
from abfm.types import FloatArray

_HEAVIEST = 1e100


def commuting_fields(
    mesh: TriangleMesh, v: ArrayLike, count: int = 1, weight: float | None = None
) -> FloatArray:
    """Find the smoothest fields that commute with ``v``, smoothest first, (count, F, 3).

    Minimises ``|div u|^2 + |curl u|^2 + weight |[v, u]|^2 / |v|^2`` (norms in L2, ``|v|`` the root
    mean square) over fields of unit norm that are orthogonal in L2 to ``v``, which commutes with
    itself, and to each other. Where ``v`` has a first integral ``f`` (its stream function if ``v``
    has no divergence), all products of ``v`` with functions of ``f`` commute with it and are found
    too.

    On a mesh no other field commutes exactly, so a weight takes the place of the constraint. It
    grows as the edges shrink, and the bracket vanishes in the limit: in proportion to the edge
    length on smoothly varying meshes.

    Parameters
    ----------
    mesh : TriangleMesh
        Boundary condition of `abfm.calculus.operators.hodge_laplacian`: fields stay on the surface.
    v : (F, 3) array
        Tangent vectors, in any unit; a normal part is dropped.
    count : int
        How many fields.
    weight : float, optional
        Of the bracket; by default sqrt(area) over the mean edge length. 0 gives the smoothest
        fields of all.

    Returns
    -------
    (count, F, 3) array
        Each with the root mean square of ``v``, and a positive product with ``v`` turned by 90
        degrees plus ``v`` times its squared speed, unless that vanishes.

    Raises
    ------
    ParameterError
        If ``v`` has another shape, values that are not finite or no speed, or a number is out of
        range.
    MeshError
        If the mesh's triangles are too thin to compute with.
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
    if not is_whole_number(count, 1, most):
        raise ParameterError(
            f"{brief(count)} commuting fields asked for; on {most} faces it can be 1 to {most}"
        )
    if weight is None:
        weight = float(np.sqrt(area) / edge_lengths(mesh).mean())
    if not (is_finite_number(weight) and 0 <= float(weight) <= _HEAVIEST):
        raise ParameterError(
            f"weight is {brief(weight)}; expected a number of at least 0 and at most {_HEAVIEST:g}"
        )
    field, weight = field / speed, float(weight)
    # in units of it, the L2 norm is that of coefficients
    root = np.sqrt(np.repeat(areas / area, 2))
    # area * G_F^-1/2 (G_F Delta) G_F^-1/2
    hodge = _scaled(hodge_laplacian(mesh), 1 / root, 1 / root)
    bracket = np.sqrt(area) * _scaled(lie_bracket(mesh, field), root, 1 / root)
    found = _lowest(
        Matrix(hodge + weight * (bracket.T @ bracket)), root * field.ravel(), int(count)
    )
    fields = (found.T / root).reshape(-1, *field.shape)
    usual = (rotation(mesh) @ field.ravel()).reshape(field.shape) + field * (field**2).sum(axis=1)[
        :, None
    ]
    fields[np.einsum("f,nfk,fk->n", areas, fields, usual) < 0] *= -1
    return to_ambient(mesh, speed * fields)


def relative_bracket(mesh: TriangleMesh, v: ArrayLike, u: ArrayLike) -> float:
    """Return ``sqrt(area) |[v, u]| / (|v| |u|)``, with root mean squares: without unit, 0 for
    fields that commute.

    Raises
    ------
    ParameterError
        If a field has another shape, values that are not finite or no speed.
    """
    areas = face_areas(mesh)
    fields = [to_frame(mesh, check_field(mesh, w, name)) for w, name in ((v, "v"), (u, "u"))]
    of_v, of_u = (float(np.sqrt(areas @ (w**2).sum(axis=1))) for w in fields)
    both = float(np.sqrt(areas @ (lie_bracket_of(mesh, v, u) ** 2).sum(axis=1)))
    if of_v * of_u == 0:
        raise ParameterError("v or u is zero, so the bracket has nothing to be relative to")
    return float(areas.sum()) * both / (of_v * of_u)


def _scaled(operator: Matrix, left: FloatArray, right: FloatArray) -> Matrix:
    return Matrix(sparse.diags_array(left) @ operator @ sparse.diags_array(right))


def _lowest(operator: Matrix, known: FloatArray, count: int) -> FloatArray:
    """Return the lowest eigenvectors orthogonal to ``known``, (n, count), by inverses."""
    size = len(known)
    solve = factor(Matrix(operator + sparse.eye_array(size)))
    of_known = solve(known)
    lift = float(known @ of_known)

    def inverse(b: FloatArray) -> FloatArray:
        x = solve(b - known * (known @ b))
        return x - of_known * (float(known @ x) / lift)

    try:
        values, vectors = eigsh(
            LinearOperator((size, size), matvec=inverse, dtype=np.float64),
            k=count,
            which="LA",
            v0=np.sin(np.arange(1.0, size + 1)),
            tol=1e-9,
            rng=0,
        )
    except ArpackError as error:
        raise MeshError(
            f"commuting fields: no convergence on this mesh ({error}); remesh its thin faces"
        ) from error
    return np.asarray(vectors[:, np.argsort(-values, kind="stable")])
