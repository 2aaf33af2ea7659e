"""Linear optical flow on a surface: Horn and Schunck's, on a triangle mesh."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from abfm.calculus.channels import channels
from abfm.calculus.operators import (
    Matrix,
    cotangent_laplacian,
    face_areas,
    face_normals,
    gradient,
    vertex_areas,
)
from abfm.calculus.vector_fields import to_ambient, to_frame
from abfm.errors import ParameterError, brief
from abfm.mesh import TriangleMesh, per_mesh
from abfm.numerics.cholesky import factor
from abfm.numerics.real_numbers import is_finite_number
from abfm.types import FloatArray

_RIDGE = 1e-6
# products of hat functions, over the area of their face
_LOAD = np.full((3, 3), 1 / 12) + np.eye(3) / 12


def horn_schunck(
    mesh: TriangleMesh,
    f: ArrayLike,
    g: ArrayLike,
    duration: float = 1.0,
    smoothness: float = 0.1,
) -> FloatArray:
    """Return the field (F, 3) that minimises
    ``int (dF/dt + <v, grad F>)^2 + smoothness int |grad v|^2``, in the mesh's length unit per unit
    of time, as [Lefèvre & Baillet, IEEE TPAMI 30 (2008), section 3] has it: linear on faces in
    tangent vectors at vertices, whose products across an edge are those in space.

    The derivatives are those halfway between both frames, where they are of second order. It is
    linear in what changes, and holds while that is small against a wavelength.

    Parameters
    ----------
    mesh : TriangleMesh
    f, g : (V,) or (V, C) arrays
        Two frames.
    duration : float
        The time between them.
    smoothness : float
        In the mesh scaled to unit area, of functions whose deviation is 1, for displacements over
        the whole duration: the same for any unit.

    Raises
    ------
    AbfmError
        If the frames or numbers do not fit.
    """
    for name, value in (("duration", duration), ("smoothness", smoothness)):
        if not (is_finite_number(value) and value > 0):
            raise ParameterError(f"{name} is {brief(value)}; expected a positive number")
    unit = mesh.normalized()
    first, last = channels(mesh, f, "f"), channels(mesh, g, "g")
    if first.shape != last.shape:
        raise ParameterError(f"f has {len(first)} and g {len(last)} channels; give as many of each")
    size = float(np.sqrt(np.mean([row.var() for row in (*first, *last)]))) or 1.0
    axes, faces, areas = _axes(unit), unit.faces, face_areas(unit)
    blocks, wanted = np.zeros((len(faces), 3, 2, 3, 2)), np.zeros((len(unit.vertices), 2))
    for start, end in zip(first / size, last / size, strict=True):
        halfway = (gradient(unit) @ (0.5 * (start + end))).reshape(-1, 2)
        slopes = np.einsum("fx,fcax->fca", to_ambient(unit, halfway), axes[faces])
        blocks += np.einsum("f,cd,fca,fdb->fcadb", areas, _LOAD, slopes, slopes)
        changes = (end - start)[faces] @ _LOAD
        np.add.at(wanted, faces, -np.einsum("f,fc,fca->fca", areas, changes, slopes))
    numbers = (2 * faces[:, :, None] + np.arange(2)).reshape(-1, 6)
    rows, columns = np.repeat(numbers, 6, axis=1).ravel(), np.tile(numbers, 6).ravel()
    count = wanted.size
    data = sparse.csr_array((blocks.ravel(), (rows, columns)), shape=(count, count))
    found = factor(Matrix(data + float(smoothness) * _stiffness(unit)))(wanted.ravel())
    at_vertices = np.einsum("vk,vkx->vx", found.reshape(-1, 2), axes)
    field = to_frame(mesh, at_vertices[faces].mean(axis=1))
    return to_ambient(mesh, field) * (mesh.length_scale / float(duration))


@per_mesh
def _axes(mesh: TriangleMesh) -> FloatArray:
    """Return two axes across the normal of each vertex, (V, 2, 3)."""
    normals = np.zeros_like(mesh.vertices)
    for corner in mesh.faces.T:
        np.add.at(normals, corner, face_normals(mesh) * face_areas(mesh)[:, None])
    # needles may cancel; any axes will do there
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.where(lengths > 0, normals / np.where(lengths > 0, lengths, 1.0), [0.0, 0.0, 1.0])
    aside = np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)])
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    return np.stack([aside, np.cross(normals, aside)], axis=1)


@per_mesh
def _stiffness(mesh: TriangleMesh) -> Matrix:
    """Return ``int grad w_i . grad w_j <e_a(i), e_b(j)>``, (2 V, 2 V), and a little of a mass, as
    fields that vary nowhere may have no data.
    """
    plain = (cotangent_laplacian(mesh) + _RIDGE * sparse.diags_array(vertex_areas(mesh))).tocoo()
    i, j = plain.coords
    products = np.einsum("k,kax,kbx->kab", plain.data, _axes(mesh)[i], _axes(mesh)[j])
    rows = np.repeat(2 * i[:, None] + np.arange(2), 2, axis=1)
    columns = np.tile(2 * j[:, None] + np.arange(2), 2)
    size = 2 * len(mesh.vertices)
    return Matrix(
        sparse.csr_array((products.ravel(), (rows.ravel(), columns.ravel())), shape=(size, size))
    )
