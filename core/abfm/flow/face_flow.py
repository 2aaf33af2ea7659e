"""A field of one vector per face, prepared for walking along it with `abfm.flow.tracing`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from abfm.calculus.operators import face_areas, face_frames, hat_gradients
from abfm.calculus.vector_fields import to_frame
from abfm.errors import ParameterError
from abfm.mesh import TriangleMesh, per_mesh
from abfm.types import FloatArray, IntArray

_FASTEST = 1e150  # faces per unit of time: products of two still are numbers


class FaceFlow(NamedTuple):
    """A field as the walk needs it.

    Attributes
    ----------
    rates, along : (F, 3) arrays
        How fast each barycentric weight grows, per unit of time; and the vector's part along the edge opposite each
        corner, in edges per unit of time.
    areas : (F,) array
    neighbours : (F, 3) array of int
        The slot on the other side of each edge, -1 on the boundary.
    """

    rates: FloatArray
    along: FloatArray
    areas: FloatArray
    neighbours: IntArray


@per_mesh
def opposite_slots(mesh: TriangleMesh) -> IntArray:
    """For the edge opposite each corner, the slot ``3 f + k`` that it has in the other face, or -1, (F, 3)."""
    first, second = mesh.edge_slots.T
    opposite = np.full(mesh.faces.size, -1)
    opposite[first] = second
    inner = second >= 0
    opposite[second[inner]] = first[inner]
    return opposite.reshape(-1, 3)


def face_flow(mesh: TriangleMesh, field: FloatArray) -> FaceFlow:
    """Prepare a field (F, 3); a normal part is dropped.

    Raises
    ------
    ParameterError
        If the field is so large that the walk would overflow.
    """
    coefficients = to_frame(mesh, field)
    corners = mesh.vertices[mesh.faces]
    edges = np.einsum("fcx,fkx->fck", np.roll(corners, 1, axis=1) - np.roll(corners, -1, axis=1), face_frames(mesh))
    rates = np.einsum("fck,fk->fc", hat_gradients(mesh), coefficients)
    along = np.einsum("fck,fk->fc", edges, coefficients) / (edges**2).sum(axis=2)
    if not (np.abs(rates).max() < _FASTEST and np.abs(along).max() < _FASTEST):
        raise ParameterError(f"velocity crosses a face in less than {1 / _FASTEST} units of time: scale it down")
    return FaceFlow(rates, along, face_areas(mesh), opposite_slots(mesh))
