"""Vectors at the corners of faces, fitted to the vectors of the faces around each vertex.

The faces around a vertex are unrolled into the plane. If they go all around it, angles are scaled
to a full turn, as in Knöppel et al., Globally Optimal Direction Fields, SIGGRAPH 2013. A linear
function is fitted to the vectors at the centres of the faces, and evaluated at the vertex. Vectors
are complex numbers in the local frames of the faces. The fit is linear in the vectors, and its
weights are computed once per mesh.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from abfm.calculus.operators import face_areas, face_frames
from abfm.calculus.vector_fields import to_frame
from abfm.mesh import TriangleMesh, per_mesh
from abfm.numerics.kernels import kernel
from abfm.types import BoolArray, FloatArray, IndexArray

_RIDGE = 0.02  # relative regularisation of the fitted slope, for vertices with one or two faces


def corner_vectors(mesh: TriangleMesh, field: FloatArray) -> IndexArray:
    """Make a field (F, 3) continuous; return its complex vectors (F, 3) at the corners of faces.

    They are 0 in faces where the field is zero.
    """
    vectors = as_complex(to_frame(mesh, field))
    return np.where(vectors[:, None] == 0, 0.0, fitted(mesh, vectors))


def fitted(mesh: TriangleMesh, vectors: IndexArray) -> IndexArray:
    """Return vectors (F, 3) at corners that are fitted to vectors (F,) of faces."""
    fit = _fit(mesh)
    found = _sums(mesh, fit.weights * vectors[:, None])[mesh.corner_fans]
    return np.asarray(np.conj(fit.rotations) * found)


def fitted_adjoint(mesh: TriangleMesh, vectors: IndexArray) -> IndexArray:
    """Apply the adjoint of `fitted` to vectors (F, 3) at corners; return vectors (F,) of faces."""
    fit = _fit(mesh)
    found = _sums(mesh, fit.rotations * vectors)[mesh.corner_fans]
    return np.asarray((np.conj(fit.weights) * found).sum(axis=1))


class Corners(NamedTuple):
    """The geometry of the corners of each face, in the local frame of the face."""

    places: IndexArray  # (F, 3), positions as complex numbers, the first corner at 0
    middles: IndexArray  # (F, 3), complex, unit directions of the angle bisectors
    angles: FloatArray  # (F, 3), in radians
    scaled: FloatArray  # (F, 3), angles scaled to a full turn around inner vertices


@per_mesh
def corners(mesh: TriangleMesh) -> Corners:
    points = mesh.vertices[mesh.faces]
    sides = points - points[:, :1]
    places = as_complex(np.einsum("fcx,fkx->fck", sides, face_frames(mesh)))
    first, last = (np.roll(places, turn, axis=1) - places for turn in (-1, -2))
    middles = first / np.abs(first) + last / np.abs(last)
    angles = np.angle(last / first)
    totals = np.where(_is_closed(mesh), 2 * np.pi / _sums(mesh, angles), 1.0)
    return Corners(places, middles / np.abs(middles), angles, totals[mesh.corner_fans] * angles)


def as_complex(pairs: FloatArray) -> IndexArray:
    return np.ascontiguousarray(pairs).view(np.complex128)[..., 0]


class _Fit(NamedTuple):
    rotations: IndexArray  # (F, 3), complex, of length 1: from a face's frame to a vertex's plane
    weights: IndexArray  # (F, 3), weight of a face's vector at the vertex, times the rotation


@per_mesh
def _fit(mesh: TriangleMesh) -> _Fit:
    around = corners(mesh)
    turns = np.full(mesh.faces.shape, -1.0)
    unroll(mesh.opposite_slots, around.scaled, turns)
    rotations = np.exp(1j * turns) / around.middles
    places = around.places / mesh.length_scale
    places = (places.mean(axis=1, keepdims=True) - places) * rotations  # centres from corners
    areas = np.repeat(face_areas(mesh)[:, None] / mesh.length_scale**2, 3, axis=1)
    totals, fans = _sums(mesh, areas), mesh.corner_fans
    middles = _sums(mesh, areas * places) / totals
    away = places - middles[fans]
    xx, yy = (_sums(mesh, areas * part**2) for part in (away.real, away.imag))
    xy = _sums(mesh, areas * away.real * away.imag)
    ridge = _RIDGE * (xx + yy)
    xx, yy = xx + ridge, yy + ridge
    determinant = xx * yy - xy * xy
    # a single face has no slope; rounding may give it one
    has_slope = (np.bincount(fans.ravel()) > 1) & (determinant > 0)
    scale = np.where(has_slope, 1 / np.where(has_slope, determinant, 1.0), 0.0)
    x = scale * (yy * middles.real - xy * middles.imag)
    y = scale * (xx * middles.imag - xy * middles.real)
    slopes = x[fans] * away.real + y[fans] * away.imag
    return _Fit(rotations, areas * (1 / totals[fans] - slopes) * rotations)


def _sums(mesh: TriangleMesh, numbers: IndexArray) -> IndexArray:
    """Sum values at corners (F, 3) over each fan of faces (`TriangleMesh.corner_fans`)."""
    fans = mesh.corner_fans.ravel()
    parts = (numbers.real, numbers.imag) if np.iscomplexobj(numbers) else (numbers,)
    sums = [np.bincount(fans, part.ravel()) for part in parts]
    return sums[0] if len(sums) == 1 else sums[0] + 1j * sums[1]


def _is_closed(mesh: TriangleMesh) -> BoolArray:
    fans = mesh.corner_fans
    open_slots = np.flatnonzero(mesh.opposite_slots.ravel() < 0)
    faces, corner = np.divmod(open_slots, 3)
    closed = np.ones(int(fans.max()) + 1, dtype=bool)
    for turn in (1, 2):
        closed[fans[faces, (corner + turn) % 3]] = False
    return closed


@kernel
def unroll(neighbours: IndexArray, angles: FloatArray, turns: FloatArray) -> None:
    """Write to ``turns`` (F, 3) the directions of corner bisectors in the unrolled fans of faces.

    A direction is an angle, 0 where the fan of the corner's vertex begins. ``angles`` (F, 3) are
    the corner angles, and ``neighbours`` the mesh's ``opposite_slots``. Initial values of ``turns``
    are negative.
    """
    for slot in range(angles.size):
        if turns[slot // 3, slot % 3] >= 0.0:
            continue
        start = clockwise_end(neighbours, slot)
        here, turned = start, 0.0
        while here >= 0:
            angle = angles[here // 3, here % 3]
            turns[here // 3, here % 3] = turned + angle / 2
            turned += angle
            here = adjacent_slot(neighbours, here, 1)
            if here == start:
                break


@kernel
def adjacent_slot(neighbours: IndexArray, slot: int, turn: int) -> int:
    """Return the slot of the same vertex in the next face, left (``turn`` 1) or right (``turn`` 2).

    A slot is a corner k of a face f, ``3 f + k``. The result is -1 at a boundary.
    """
    other = neighbours[slot // 3, (slot + turn) % 3]
    return -1 if other < 0 else 3 * (other // 3) + (other + turn) % 3


@kernel
def clockwise_end(neighbours: IndexArray, slot: int) -> int:
    """Return the first slot (corner ``3 f + k``) in the fan of faces around the vertex of ``slot``.

    If the fan goes all around the vertex, the first slot is ``slot`` itself.
    """
    here, before = slot, adjacent_slot(neighbours, slot, 2)
    while before >= 0 and before != slot:
        here, before = before, adjacent_slot(neighbours, before, 2)
    return slot if before == slot else here
