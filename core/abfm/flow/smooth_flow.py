"""A field of one vector per face made continuous, so that lines along it bend instead of having
kinks at edges.

Each vertex gets a vector: the faces around it are unrolled into the plane, with angles scaled to a
full turn as in Knöppel et al., Globally Optimal Direction Fields, SIGGRAPH 2013, so that creases do
not matter, and a linear function is fitted to their vectors at their centres. Inside a face the
vectors of its corners are interpolated.
"""

from typing import NamedTuple, TypeAlias

import numpy as np

from abfm.calculus.operators import face_areas, face_frames, hat_gradients
from abfm.calculus.vector_fields import to_frame
from abfm.flow.tracing import opposite_slots
from abfm.mesh import TriangleMesh
from abfm.numerics.kernels import kernel
from abfm.types import FloatArray, IndexArray, IntArray

_CROSSINGS = 64  # edges that a step may meet before the walk counts as caught at a vertex
_RIDGE = 0.02  # of the fitted slope: for vertices with one or two faces
# part of a way's squared length that is left: less where it slid along the boundary
_STRAIGHT = 1 - 1e-9


Face: TypeAlias = int | np.int64


class FlatFaces(NamedTuple):
    """Faces laid into the plane, each in its own frame."""

    corners: IndexArray  # (F, 3), complex, the first one at zero
    areas: FloatArray  # (F,)
    neighbours: IndexArray  # (F, 3), `opposite_slots`


class SmoothFlow(NamedTuple):
    """A continuous field, made for walks; places are in the faces' frames, from corner 0."""

    # (F, 3, 2): at the first corner, and how they change per unit of x and of y
    vectors: FloatArray
    gradients: FloatArray  # (F, 3, 2), of the hat functions
    # (F, 3, 4), to the frame behind the edge opposite each corner: cosine, sine, and the shift
    unfolding: FloatArray
    # (F, 3), slot 3 f + k on the other side of that edge, -1 on the boundary
    neighbours: IndexArray


class Walker(NamedTuple):
    """A place (x, y) in the frame of a face, -1 behind a boundary, and a way (u, v) seen there."""

    face: Face
    x: float
    y: float
    u: float
    v: float


def smooth_flow(mesh: TriangleMesh, field: FloatArray, unit: float = 1.0) -> SmoothFlow:
    """Make a field (F, 3) continuous; a normal part is dropped, and faces without speed keep none.

    ``unit`` is the unit of lengths in the result; vectors stay as they are.
    """
    flat, gradients = _flat_faces(mesh), hat_gradients(mesh) * unit
    flat = flat._replace(corners=flat.corners / unit)
    vectors = _corner_vectors(mesh, field, flat)
    slopes = np.einsum("fc,fck->fk", vectors, gradients)
    return SmoothFlow(
        _pairs(np.concatenate([vectors[:, :1], slopes], axis=1)),
        gradients,
        _unfolding(flat.corners, flat.neighbours),
        flat.neighbours,
    )


def corner_vectors(mesh: TriangleMesh, field: FloatArray) -> IndexArray:
    """Return the continuous field at corners, as complex numbers in the faces' frames, (F, 3)."""
    return _corner_vectors(mesh, field, _flat_faces(mesh))


def slots_ahead(mesh: TriangleMesh, field: FloatArray) -> IntArray:
    """Return each vertex's slot ``3 f + k`` in the face that the continuous field leads into."""
    corners, vectors = _flat_faces(mesh).corners, corner_vectors(mesh, field)
    first, last = (np.roll(corners, turn, axis=1) - corners for turn in (-1, -2))
    middles = first / np.abs(first) + last / np.abs(last)
    aside = np.where(
        vectors == 0, np.inf, np.abs(np.angle(vectors / middles)) / np.angle(last / first)
    )
    slots = np.argsort(-aside, axis=None, kind="stable")
    ahead = np.empty(len(mesh.vertices), dtype=np.int64)
    ahead[mesh.faces.ravel()[slots]] = slots  # of repeated vertices the last one stays
    return ahead


def _corner_vectors(mesh: TriangleMesh, field: FloatArray, flat: FlatFaces) -> IndexArray:
    vectors = np.empty((len(mesh.faces), 3), dtype=np.complex128)
    most = int(np.bincount(mesh.faces.ravel()).max())
    fit_corners(flat, _complex(to_frame(mesh, field)), most, vectors)
    return vectors


def _flat_faces(mesh: TriangleMesh) -> FlatFaces:
    places = mesh.vertices[mesh.faces]
    corners = np.einsum("fcx,fkx->fck", places - places[:, :1], face_frames(mesh))
    return FlatFaces(_complex(corners), face_areas(mesh), opposite_slots(mesh))


def _unfolding(corners: IndexArray, neighbours: IndexArray) -> FloatArray:
    """Return the rigid motions that lay each face's frame beside that of its neighbour."""
    starts, ends = np.roll(corners, -1, axis=1), np.roll(corners, -2, axis=1)  # of the edges
    turns = (starts.ravel()[neighbours] - ends.ravel()[neighbours]) / (ends - starts)
    turns /= np.abs(turns)
    shifts = ends.ravel()[neighbours] - turns * starts
    return np.concatenate([_pairs(turns), _pairs(shifts)], axis=2)


def _pairs(numbers: IndexArray) -> FloatArray:
    return np.stack([numbers.real, numbers.imag], axis=-1)


def _complex(pairs: FloatArray) -> IndexArray:
    return np.ascontiguousarray(pairs).view(np.complex128)[..., 0]


@kernel
def fit_corners(flat: FlatFaces, field: IndexArray, most: int, vectors: IndexArray) -> None:
    """Fit vectors at corners (F, 3) to those of faces (F,), as complex numbers in the faces'
    frames.

    ``most`` is the largest number of faces around a vertex. A pinched vertex has a vector for each
    of its fans.
    """
    corners = flat.corners
    seen = np.zeros(corners.shape, dtype=np.bool_)
    fan = np.empty(most, dtype=np.int64)
    middles = np.empty(most, dtype=np.complex128)
    turns = np.empty(most)
    centres = np.empty(most, dtype=np.complex128)
    unrolled = np.empty(most, dtype=np.complex128)
    for slot in range(seen.size):
        if seen[slot // 3, slot % 3]:
            continue
        start, closed = clockwise_end(flat.neighbours, slot)
        count, turned, here = 0, 0.0, start
        while here >= 0:
            f, c = here // 3, here % 3
            seen[f, c] = True
            fan[count] = here
            first = corners[f, (c + 1) % 3] - corners[f, c]
            last = corners[f, (c + 2) % 3] - corners[f, c]
            middle = first / abs(first) + last / abs(last)
            angle = np.angle(last / first)
            middles[count] = middle / abs(middle)
            turns[count] = turned + angle / 2
            turned += angle
            count += 1
            here = around(flat.neighbours, here, 1)
            if here == start:
                break
        scale = 2 * np.pi / turned if closed else 1.0
        for i in range(count):
            f, c = fan[i] // 3, fan[i] % 3
            rotation = np.exp(1j * scale * turns[i]) / middles[i]
            centres[i] = (
                (corners[f, 0] + corners[f, 1] + corners[f, 2]) / 3 - corners[f, c]
            ) * rotation
            unrolled[i] = field[f] * rotation
        vector = fitted(fan[:count], centres, unrolled, flat.areas)
        for i in range(count):
            f, c = fan[i] // 3, fan[i] % 3
            vectors[f, c] = (
                vector * middles[i] * np.exp(-1j * scale * turns[i]) if field[f] != 0 else 0.0
            )


@kernel
def around(neighbours: IndexArray, slot: int, turn: int) -> int:
    """Return the slot of the same vertex in the next face around it, counterclockwise for ``turn``
    1 and clockwise for 2; -1 behind a boundary.
    """
    other = neighbours[slot // 3, (slot + turn) % 3]
    return -1 if other < 0 else 3 * (other // 3) + (other + turn) % 3


@kernel
def clockwise_end(neighbours: IndexArray, slot: int) -> tuple[int, bool]:
    """Return the first slot of the fan of faces around a vertex, and whether the fan is closed:
    then any slot is the first.
    """
    here, before = slot, around(neighbours, slot, 2)
    while before >= 0 and before != slot:
        here, before = before, around(neighbours, before, 2)
    return (slot, True) if before == slot else (here, False)


@kernel
def fitted(fan: IndexArray, places: IndexArray, values: IndexArray, areas: FloatArray) -> complex:
    """Evaluate at zero the linear function fitted to complex values, weighted by areas."""
    total, place, value = 0.0, 0j, 0j
    for i in range(fan.size):
        weight = areas[fan[i] // 3]
        total += weight
        place += weight * places[i]
        value += weight * values[i]
    place /= total
    value /= total
    if fan.size == 1:
        return value
    xx, xy, yy, vx, vy = 0.0, 0.0, 0.0, 0j, 0j
    for i in range(fan.size):
        weight = areas[fan[i] // 3]
        away, more = places[i] - place, values[i] - value
        xx += weight * away.real**2
        xy += weight * away.real * away.imag
        yy += weight * away.imag**2
        vx += weight * away.real * more
        vy += weight * away.imag * more
    ridge = _RIDGE * (xx + yy)
    xx, yy = xx + ridge, yy + ridge
    determinant = xx * yy - xy * xy
    if determinant <= 0.0:
        return value
    along_x, along_y = (yy * vx - xy * vy) / determinant, (xx * vy - xy * vx) / determinant
    result: complex = value - along_x * place.real - along_y * place.imag
    return result


@kernel
def vector_at(flow: SmoothFlow, f: Face, x: float, y: float) -> tuple[float, float]:
    """Evaluate the field at a place, in the face's frame."""
    w = flow.vectors
    return (
        w[f, 0, 0] + x * w[f, 1, 0] + y * w[f, 2, 0],
        w[f, 0, 1] + x * w[f, 1, 1] + y * w[f, 2, 1],
    )


@kernel
def midpoint(flow: SmoothFlow, walker: Walker, step: float, slide: bool) -> Walker:
    """Take ``step`` times the field halfway along a walker's way as its way, seen from where it is.

    The midpoint rule, as the way is ``step`` times the field at its start. The two are compared in
    one frame because a walk carries its way over every edge into the next face's plane. Behind a
    boundary halfway, unless the way is to ``slide`` along it, the face is -1 and the way stays.
    """
    f, x, y, u, v = walker
    g, a, b, p, q = walk_straight(flow, Walker(f, x, y, u / 2, v / 2), slide)
    if g < 0:
        return Walker(g, x, y, u, v)
    r, s = vector_at(flow, g, a, b)
    seen, length = 4 * (p * p + q * q), u * u + v * v
    if seen > _STRAIGHT * length:
        cosine, sine = 2 * step * (p * u + q * v) / seen, 2 * step * (p * v - q * u) / seen
        u, v = cosine * r - sine * s, sine * r + cosine * s
    elif seen > 0.0:  # it slid along the boundary: how much faster does it there?
        ratio = max(2 * step * (p * r + q * s) / seen, 0.0)
        u, v = ratio * u, ratio * v
    return Walker(f, x, y, u, v)


@kernel
def walk_straight(flow: SmoothFlow, walker: Walker, slide: bool = False) -> Walker:
    """Go a walker's way, unfolding the faces that it leads over.

    Returns the place, with face -1 at a boundary, and the way as it is seen there; or, to
    ``slide``, goes on along the boundary with the part of the way that leads along it.
    """
    f, x, y, u, v = walker
    gradients, left, entered = flow.gradients, 1.0, -1
    for _ in range(_CROSSINGS):
        leave, used = -1, left
        for i in range(3):
            rate = gradients[f, i, 0] * u + gradients[f, i, 1] * v
            if rate < 0.0 and i != entered:
                weight = gradients[f, i, 0] * x + gradients[f, i, 1] * y + (1.0 if i == 0 else 0.0)
                if weight + rate * used < 0.0:
                    leave, used = i, max(weight, 0.0) / -rate
        x, y = x + used * u, y + used * v
        if leave < 0:
            return Walker(f, x, y, u, v)
        left -= used
        slot = flow.neighbours[f, leave]
        if slot < 0:
            if not slide:
                return Walker(-1, x, y, u, v)
            p, q = gradients[f, leave, 0], gradients[f, leave, 1]
            along = (p * v - q * u) / (p * p + q * q)
            u, v, entered = -q * along, p * along, leave
            continue
        c, s = flow.unfolding[f, leave, 0], flow.unfolding[f, leave, 1]
        x, y = (
            c * x - s * y + flow.unfolding[f, leave, 2],
            s * x + c * y + flow.unfolding[f, leave, 3],
        )
        u, v = c * u - s * v, s * u + c * v
        f, entered = slot // 3, slot % 3
    return Walker(f if slide else -1, x, y, u, v)
