"""Linear optical flow on a surface by Horn and Schunck, with one vector per face."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from abfm.calculus.channels import channels
from abfm.calculus.operators import Matrix, edge_lengths, face_areas, gradient, vertex_areas
from abfm.calculus.vector_fields import to_ambient
from abfm.errors import ParameterError, brief
from abfm.flow.corner_fit import corners
from abfm.mesh import TriangleMesh, per_mesh
from abfm.numerics.cholesky import factor
from abfm.numerics.real_numbers import is_finite_number
from abfm.types import FloatArray
from abfm.wording import counted

_RIDGE = 1e-6  # weight of the squared field, for uniqueness where frames are constant


def horn_schunck(
    mesh: TriangleMesh, f: ArrayLike, g: ArrayLike, duration: float = 1.0, smoothness: float = 0.1
) -> FloatArray:
    """Return the field that minimises ``int (dF/dt + <v, grad F>)^2 + smoothness int |grad v|^2``.

    F is the function that changes from f to g. The minimised energy is that of [Lefèvre & Baillet,
    IEEE TPAMI 30 (2008), section 3]. The discretisation differs: the field has a tangent vector for
    each face, and the time derivative is evaluated at the face's centroid. Gradients are those of
    the mean of f and g, which makes the linearisation second order.

    The smoothness term is a sum over inner edges (finite volumes), ``sum w_e |P_e v_f - v_f'|^2``.
    ``v_f`` and ``v_f'`` are the vectors of both faces of an edge. ``P_e`` unfolds the first face
    into the plane of the second. The weight ``w_e = 3 l_e^2 / (2 (A_f + A_f'))`` is the length of
    the edge divided by the distance between the centroids.

    For a fixed mean of f and g, the field is linear in g - f. It is accurate if displacements are
    small compared with a wavelength.

    Parameters
    ----------
    mesh : TriangleMesh
    f, g : (V,) or (V, C) arrays
        Values at the vertices at the beginning (f) and at the end (g).
    duration : float
        Time between f and g.
    smoothness : float
        Weight of the smoothness term, independent of units. It applies to the mesh scaled to unit
        area, functions with standard deviation 1, and displacements over the complete duration.

    Returns
    -------
    Tangent vectors (F, 3), in the mesh's length unit per unit of time.

    Raises
    ------
    AbfmError
        If f or g does not fit the mesh, or a number is not positive.
    """
    for name, value in (("duration", duration), ("smoothness", smoothness)):
        if not (is_finite_number(value) and value > 0):
            raise ParameterError(f"{name} is {brief(value)}; expected a positive number")
    unit = mesh.normalized()
    first, last = channels(mesh, f, "f"), channels(mesh, g, "g")
    if first.shape != last.shape:
        raise ParameterError(
            f"f has {counted(len(first), 'channel')} and g has {len(last)}; expected equal numbers"
        )
    areas, vertex_weights = face_areas(unit), vertex_areas(unit)
    rows = np.concatenate([first, last])
    deviations = rows - (rows @ vertex_weights)[:, None]
    size = float(np.sqrt(np.mean(deviations**2 @ vertex_weights))) or 1.0
    blocks, right_side = np.zeros((len(areas), 2, 2)), np.zeros((len(areas), 2))
    for start, end in zip(first / size, last / size, strict=True):
        slopes = (gradient(unit) @ (0.5 * (start + end))).reshape(-1, 2)
        changes = (end - start)[unit.faces].mean(axis=1)
        blocks += np.einsum("f,fa,fb->fab", areas, slopes, slopes)
        right_side -= (areas * changes)[:, None] * slopes
    numbers = np.arange(len(areas))
    data = sparse.bsr_array((blocks, numbers, np.arange(len(areas) + 1)))
    ridge = _RIDGE * sparse.diags_array(np.repeat(areas, 2))
    matrix = Matrix(data + float(smoothness) * _stiffness(unit) + ridge)
    found = factor(matrix)(right_side.ravel())
    return to_ambient(mesh, found.reshape(-1, 2)) * (mesh.length_scale / float(duration))


@per_mesh
def _stiffness(mesh: TriangleMesh) -> Matrix:
    """Return the matrix (2F, 2F) of the smoothness term of `horn_schunck`.

    It acts on the coefficients of vectors in the local frames of the F faces.
    """
    inner = ~mesh.is_boundary_edge
    slots = mesh.edge_slots[inner]  # (E, 2)
    faces, corner = np.divmod(slots, 3)
    places = corners(mesh).places
    along = places[faces, (corner + 2) % 3] - places[faces, (corner + 1) % 3]
    # both faces have the same orientation, so they traverse the edge in opposite directions
    turns = -along[:, 1] / along[:, 0]
    turns /= np.abs(turns)
    areas = face_areas(mesh)
    weights = 1.5 * edge_lengths(mesh)[inner] ** 2 / areas[faces].sum(axis=1)
    count, (one, other) = len(areas), faces.T
    diagonal = np.bincount(faces.ravel(), np.repeat(weights, 2), minlength=count)
    parts = [(-weights * part, (other, one)) for part in (turns.real, turns.imag)]
    real, imaginary = (sparse.csr_array(part, shape=(count, count)) for part in parts)
    transport = sparse.kron(real, np.eye(2)) + sparse.kron(imaginary, [[0.0, -1.0], [1.0, 0.0]])
    return Matrix(sparse.diags_array(np.repeat(diagonal, 2)) + transport + transport.T)
