"""Critical points of a field: sources, sinks, spirals and saddles, by their index.

The field is made continuous as for flow lines (`abfm.flow.continuous_flow`), with angles at a
vertex scaled to a full turn. The index of a face is the number of turns of the field around it,
including the holonomy of the face. On a closed surface the indices add up to its Euler
characteristic [Poincaré-Hopf; Crane, Desbrun, Schröder, Trivial Connections, SGP 2010].
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from abfm.calculus.operators import face_areas, hat_gradients
from abfm.calculus.vector_fields import to_frame
from abfm.flow.corner_fit import corner_vectors, corners
from abfm.maps.surface_points import SurfacePoints
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray, IndexArray, IntArray

PointKind = Literal["source", "sink", "spiral", "saddle"]
KINDS: tuple[PointKind, ...] = get_args(PointKind)
_REFERENCE_DIRECTION = 0.36, 0.48, 0.8  # a direction in space, normal to few faces
_SPEED_SHARE_MIN = 1e-9  # corners slower than this share of the RMS speed have no direction


@dataclass(frozen=True, eq=False)
class CriticalPoints:
    """The K zeros of a field.

    Attributes
    ----------
    points : SurfacePoints
    index : (K,) array of int
        Index of each zero: 1 for sources, sinks and spirals, -1 for saddles; rarely larger.
    kinds : tuple of str
        Kind of each zero; "spiral" if the derivative of the field rotates more than it diverges.
    divergence, curl : (K,) array
        Divergence and curl of the continuous field at the zeros, per unit of time. The sign of the
        curl is the direction of a spiral.
    """

    points: SurfacePoints
    index: IntArray
    kinds: tuple[PointKind, ...]
    divergence: FloatArray
    curl: FloatArray

    def __len__(self) -> int:
        return len(self.kinds)


def critical_points(mesh: TriangleMesh, field: FloatArray) -> CriticalPoints:
    """Return the zeros of a tangent field (F, 3)."""
    vectors = corner_vectors(mesh, field)
    index = face_indices(mesh, field, vectors)
    faces = np.flatnonzero(index)
    pairs = np.stack([vectors[faces].real, vectors[faces].imag], axis=-1)  # (K, 3, 2)
    slopes = np.einsum("fck,fcj->fkj", pairs, hat_gradients(mesh)[faces])
    divergence = slopes[:, 0, 0] + slopes[:, 1, 1]
    curl = slopes[:, 1, 0] - slopes[:, 0, 1]
    points = SurfacePoints(mesh, faces, _zeros(pairs))
    # square of the eigenvalues' imaginary part
    turning = np.linalg.det(slopes) - divergence**2 / 4
    kinds = tuple(map(_kind, index[faces], divergence, turning))
    return CriticalPoints(points, index[faces], kinds, divergence, curl)


def _kind(index: int, divergence: float, turning: float) -> PointKind:
    if index < 0:
        return "saddle"
    if turning > divergence**2 / 4:
        return "spiral"
    return "source" if divergence > 0 else "sink"


def _zeros(vectors: FloatArray) -> FloatArray:
    """Return barycentric weights (K, 3) of the points where linear fields on K faces are zero.

    A linear field is given by its vectors at the corners of the face, (K, 3, 2).
    """
    system = np.ones((len(vectors), 3, 3))
    system[:, :2] = vectors.transpose(0, 2, 1)
    scale = np.abs(system[:, :2]).max(axis=(1, 2), initial=0.0, keepdims=True)
    system[:, :2] /= np.where(scale > 0, scale, 1.0)
    target = np.broadcast_to(np.array([0.0, 0.0, 1.0]), (len(vectors), 3))
    found = np.einsum("kij,kj->ki", np.linalg.pinv(system), target).clip(0.0)
    total = found.sum(axis=1, keepdims=True)
    return np.asarray(np.where(total > 0, found / np.where(total > 0, total, 1.0), 1 / 3))


def face_indices(
    mesh: TriangleMesh, field: FloatArray, vectors: IndexArray | None = None
) -> IntArray:
    """Return the index of the continuous field in each face, (F,): its turns around the face.

    It is 0 if the field is almost 0 at all corners.
    """
    if vectors is None:
        vectors = corner_vectors(mesh, field)
    around = corners(mesh)
    half, holonomy = around.scaled / 2, around.scaled.sum(axis=1) - np.pi
    areas = face_areas(mesh)
    squares = (to_frame(mesh, field) ** 2).sum(axis=1)
    mean_speed = float(np.sqrt(areas @ squares / areas.sum()))
    still = np.abs(vectors) <= _SPEED_SHARE_MIN * mean_speed
    # All faces of a vertex share its vector. If it is zero, any direction that replaces it assigns
    # the zero of the field to one of these faces.
    reference = corner_vectors(mesh, np.tile(_REFERENCE_DIRECTION, (len(mesh.faces), 1)))
    turned = np.angle(np.where(still, reference, vectors) / around.middles)
    from_first, from_last = turned + half, turned - half
    changes = np.roll(from_last, -1, axis=1) - np.pi - from_first
    changes = np.pi - (np.pi - changes) % (2 * np.pi)  # changes of angle within (-pi, pi]
    total = (changes.sum(axis=1) + holonomy) / (2 * np.pi)
    return np.where(still.all(axis=1), 0, np.rint(total)).astype(np.int64)
