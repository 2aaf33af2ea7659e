"""The Helmholtz-Hodge decomposition of a field, in the mixed form of `hodge_gradients`."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.operators import Matrix, field_mass, hodge_gradients
from abfm.calculus.vector_fields import check_field, to_ambient, to_frame
from abfm.errors import ParameterError
from abfm.mesh import TriangleMesh, per_mesh
from abfm.mesh.topology import connected
from abfm.numerics.cholesky import factor
from abfm.types import FloatArray, IntArray

Projection = Callable[[FloatArray], FloatArray]


def helmholtz_hodge(mesh: TriangleMesh, v: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Split a field into a gradient, a rotated gradient and a harmonic field.

    The three are orthogonal in L2 and sum to ``v``, both to rounding. On a boundary the gradient
    takes all flux through it: the other two are tangent to the boundary.

    Parameters
    ----------
    mesh : TriangleMesh
    v : (F, 3) array
        Tangent vectors in space, in any unit; a normal part is dropped.

    Returns
    -------
    curl_free : (F, 3) array
        Gradient, face by face, of an edge (Crouzeix-Raviart) function.
    divergence_free : (F, 3) array
        Gradient of a vertex function that vanishes on the boundary, turned by 90 degrees.
    harmonic : (F, 3) array
        The rest, without divergence and curl. Such fields have as many dimensions as the surface
        has independent loops: none on a sphere or disc, ``2 genus`` on a closed surface.

    Raises
    ------
    ParameterError
        If ``v`` has another shape or values that are not finite.
    """
    field = to_frame(mesh, check_field(mesh, v, "v")).ravel()
    gradient, rotated = (project(field) for project in _projections(mesh))
    parts = (gradient, rotated, field - gradient - rotated)
    if not np.isfinite(parts[2]).all():
        raise ParameterError("the parts of v overflow: scale it down")
    curl_free, divergence_free, harmonic = (to_ambient(mesh, part.reshape(-1, 2)) for part in parts)
    return curl_free, divergence_free, harmonic


@per_mesh
def _projections(mesh: TriangleMesh) -> tuple[Projection, Projection]:
    """Return ``G_F``-orthogonal projections of coefficients (2F,) onto both gradients' ranges."""
    edges, vertices = hodge_gradients(mesh)
    # pinched vertices do not join edges
    pieces = connected(len(mesh.faces), mesh.edge_faces[~mesh.is_boundary_edge])
    first_faces = np.unique(pieces, return_index=True)[1]
    first_vertex = np.arange(1 if mesh.is_closed else 0)
    mass = field_mass(mesh)
    return _onto_range(edges, mass, mesh.face_edges[first_faces, 0]), _onto_range(
        vertices, mass, first_vertex
    )


def _onto_range(gradient: Matrix, mass: Matrix, grounded: IntArray) -> Projection:
    """Return the projection onto a gradient's range; ``grounded`` unknowns fix its kernel."""
    free = np.setdiff1d(np.arange(gradient.shape[1]), grounded)
    basis = Matrix(gradient[:, free])
    solve = factor(Matrix(basis.T @ mass @ basis))

    def project(field: FloatArray) -> FloatArray:
        return np.asarray(basis @ solve(basis.T @ (mass @ field)))

    return project
