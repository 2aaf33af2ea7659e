"""Flows of fields that are made continuous; their flow lines check the discrete advection.

Each vertex gets a vector by `corner_fit`, and inside a face these vectors are interpolated. Flow
lines then bend instead of having kinks at edges. Points follow the field by the midpoint rule,
straight across edges. A point at a vertex starts in the face that the field leads into. On smooth
fields the error falls with the square of the edge length.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.operators import face_areas, face_frames, hat_gradients
from abfm.errors import ParameterError, brief
from abfm.flow.corner_fit import corner_vectors, corners
from abfm.flow.flow_lines import AT_VERTEX, checked_fields, start_points
from abfm.maps.surface_points import SurfacePoints, vertex_points
from abfm.mesh import TriangleMesh, per_mesh
from abfm.mesh.subdivision import refined, to_children, to_parents
from abfm.numerics.kernels import kernel
from abfm.numerics.real_numbers import is_finite_number
from abfm.types import FloatArray, IndexArray, IntArray
from abfm.workers.control import checkpoint

STEP = 0.5  # largest step, in square roots of the area of the face where it begins
STEP_LIMIT = 20_000  # largest number of steps of one point along one field; the point then stops
_MEAN_LIMIT = 10_000  # largest mean number of steps of the points of a surface
_LENGTH_MIN = 1e-12  # shorter steps, relative to the face, are not taken
# Points are moved by this share of the distance to the centre of their face. Otherwise rounding
# would choose the side on which a flow line passes a vertex.
_INWARD_SHARE = 1e-10
_CHUNK = 4096  # points between checks for cancellation: 0.2 s if each crosses a hundred faces
_CROSSINGS = 64  # a step that crosses more edges circles around a vertex, and ends
_CENTRES = np.array([[4, 1, 1], [1, 4, 1], [1, 1, 4], [2, 2, 2]]) / 6  # centres of the child faces
# a step whose squared length fell below this share has slid along the boundary
_STRAIGHT_SHARE_MIN = 1 - 1e-9
Face: TypeAlias = int | np.int64


class ContinuousFlow:
    """The flow of a field made continuous, or of N consecutive fields, each for ``tau / N``.

    A point that meets the boundary moves along it with the tangential part of the field.

    Parameters
    ----------
    velocity : (F, 3) or (N, F, 3) array
        Tangent vectors, in the mesh's length unit per unit of time; a normal part is dropped.
        Arrays (4^k F, 3) or (N, 4^k F, 3) are fields on the mesh subdivided k times. Points always
        refer to the mesh itself.
    tau : float
        End time, positive or 0.
    """

    def __init__(self, mesh: TriangleMesh, velocity: ArrayLike, tau: float) -> None:
        self.mesh = mesh
        self.fields, self._refined = checked_fields(mesh, velocity)
        fine = refined(mesh, self._refined)
        if not (is_finite_number(tau) and tau >= 0):
            raise ParameterError(f"tau is {brief(tau)}; expected a finite time of at least 0")
        self.tau = float(tau)
        sizes = np.sqrt(face_areas(fine)) / mesh.length_scale
        with np.errstate(over="ignore", invalid="ignore"):
            speeds = [np.linalg.norm(v / mesh.length_scale, axis=1) for v in self.fields]
            # mean number of faces that a point crosses per unit of time, by area (sizes^2)
            self._pace = np.array([float(sizes @ speed) for speed in speeds])
        self._cache: tuple[int, IndexArray, SmoothFlow] | None = None
        self._spans(0.0, self.tau)

    def destinations(
        self, start: SurfacePoints | None = None, t: float | None = None
    ) -> SurfacePoints:
        """Move points (default: all vertices) along the flow from 0 to ``t`` (default: `tau`).

        Beyond `tau` the last field continues.
        """
        return self.between(start, 0.0, self.tau if t is None else t)

    def origins(self, start: SurfacePoints | None = None, t: float | None = None) -> SurfacePoints:
        """Move points (default: all vertices) back along the flow from ``t`` (default: `tau`) to 0.

        `pull_back` of a function at the origins gives the function advected to ``t``.
        """
        return self.between(start, self.tau if t is None else t, 0.0)

    def between(self, start: SurfacePoints | None, begin: float, end: float) -> SurfacePoints:
        """Move points (all vertices if None) from time ``begin`` to time ``end``, forward or back.

        Raises
        ------
        ParameterError
            If a time is negative, or points cross too many faces.
        """
        spans = self._spans(min(begin, end), max(begin, end))
        if end < begin:
            spans = [(j, -duration) for j, duration in reversed(spans)]
        return self._walked(start, spans)

    def _spans(self, begin: float, end: float) -> list[tuple[int, float]]:
        """Return pairs (index of a field, duration) for the fields between two ascending times."""
        if not 0 <= begin <= end < math.inf:
            raise ParameterError(
                f"flow lines start at time {begin:g} and end at time {end:g}; expected finite "
                "ascending times of at least 0"
            )
        starts = np.arange(len(self.fields)) * (self.tau / len(self.fields))
        ends = np.append(starts[1:], math.inf)
        lasting = np.maximum(np.minimum(ends, end) - np.maximum(starts, begin), 0)
        with np.errstate(over="ignore", invalid="ignore"):
            faces = float(self._pace @ lasting)
        if not faces <= STEP * _MEAN_LIMIT:
            raise ParameterError(
                f"velocity moves points across {faces:.0e} faces on average; expected at most "
                f"{STEP * _MEAN_LIMIT:.0e}. Scale it down or shorten the time"
            )
        return [(j, duration) for j, duration in enumerate(lasting.tolist()) if duration]

    def _smooth(self, j: int) -> tuple[IndexArray, SmoothFlow]:
        """Return the vectors of field ``j`` at corners (F, 3), and its `SmoothFlow`."""
        cached = self._cache
        if cached is None or cached[0] != j:
            unit = refined(self.mesh, self._refined).normalized()
            vectors = corner_vectors(unit, self.fields[j] / self.mesh.length_scale)
            self._cache = cached = j, vectors, from_corners(unit, vectors)
        return cached[1:]

    def _walked(self, start: SurfacePoints | None, spans: list[tuple[int, float]]) -> SurfacePoints:
        """Move points (all vertices if None) along consecutive fields.

        ``spans`` has indices of fields and durations, which are negative against the flow.
        """
        mesh, k = self.mesh, self._refined
        faces, barycentric = start_points(mesh, vertex_points(mesh) if start is None else start)
        faces, barycentric = to_children(faces, barycentric, k)
        fine = refined(mesh, k)
        unit = fine.normalized()
        at_vertex = barycentric.max(axis=1) >= AT_VERTEX
        if at_vertex.any() and spans:
            first, duration = spans[0]
            vertices = fine.faces[faces[at_vertex], barycentric[at_vertex].argmax(axis=1)]
            leading = math.copysign(1.0, duration) * self._smooth(first)[0]
            ahead = downstream_slots(unit, leading)[vertices]
            faces[at_vertex], barycentric[at_vertex] = ahead // 3, np.eye(3)[ahead % 3]
        gradients, places = hat_gradients(unit), np.empty((len(faces), 2))
        enter(gradients, faces, barycentric, places)
        sizes = np.sqrt(face_areas(unit))
        for j, duration in spans:
            _, flow = self._smooth(j)
            for begin in range(0, len(faces), _CHUNK):
                checkpoint()
                chunk = slice(begin, begin + _CHUNK)
                advect_points(flow, sizes, duration, faces[chunk], places[chunk])
        leave(gradients, faces, places, barycentric)
        return SurfacePoints(mesh, *to_parents(faces, barycentric, k))


class SmoothFlow(NamedTuple):
    """A continuous field, linear in each face, prepared for flow lines.

    Positions and vectors are coordinates in the local frame of a face, whose origin is corner 0.
    """

    vectors: FloatArray  # (F, 3, 2): vector at the first corner, and its derivatives by x and by y
    gradients: FloatArray  # (F, 3, 2), gradients of the hat functions
    # (F, 3, 4), map to the frame behind the edge opposite each corner: cosine, sine, and shift
    unfolding: FloatArray
    # (F, 3), slot 3 f + k (corner k of face f) opposite that edge in the next face; -1 at a
    # boundary
    neighbours: IndexArray


class Walker(NamedTuple):
    """A point (x, y) and a vector (u, v) in the local frame of a face; face -1 is off the mesh."""

    face: Face
    x: float
    y: float
    u: float
    v: float


def smooth_flow(mesh: TriangleMesh, field: FloatArray, unit: float = 1.0) -> SmoothFlow:
    """Make a field (F, 3) continuous, and prepare it for flow lines.

    Faces in which the field is zero keep a zero field. Coordinates of points are in multiples of
    the length ``unit``.
    """
    return from_corners(mesh, corner_vectors(mesh, field), unit)


def from_corners(mesh: TriangleMesh, vectors: IndexArray, unit: float = 1.0) -> SmoothFlow:
    """Prepare a continuous field, given by its `corner_vectors` (F, 3), for flow lines."""
    gradients, unfolding = hat_gradients(mesh), _unfolding(mesh)
    if unit != 1.0:
        gradients, unfolding = gradients * unit, unfolding / [1.0, 1.0, unit, unit]
    slopes = np.einsum("fc,fck->fk", vectors, gradients)
    pairs = _pairs(np.concatenate([vectors[:, :1], slopes], axis=1))
    return SmoothFlow(pairs, gradients, unfolding, mesh.opposite_slots)


@per_mesh
def _unfolding(mesh: TriangleMesh) -> FloatArray:
    places, others = corners(mesh).places, mesh.opposite_slots
    starts, ends = (np.roll(places, turn, axis=1) for turn in (-1, -2))  # ends of the edges
    turns = (starts.ravel()[others] - ends.ravel()[others]) / (ends - starts)
    turns /= np.abs(turns)
    shifts = ends.ravel()[others] - turns * starts
    return np.concatenate([_pairs(turns), _pairs(shifts)], axis=2)


def field_on_children(mesh: TriangleMesh, field: FloatArray) -> FloatArray:
    """Make a field (F, 3) continuous, and evaluate it at the centres of child faces, (4 F, 3)."""
    vectors, corners = smooth_flow(mesh, field).vectors, mesh.vertices[mesh.faces]
    sides = np.einsum("fcx,fkx->fck", corners[:, 1:] - corners[:, :1], face_frames(mesh))
    places = np.einsum("qc,fck->fqk", _CENTRES[:, 1:], sides)
    at_centres = vectors[:, None, 0] + np.einsum("fqj,fjk->fqk", places, vectors[:, 1:])
    return np.asarray(np.einsum("fqk,fkx->fqx", at_centres, face_frames(mesh)).reshape(-1, 3))


def angular_offsets(vectors: IndexArray, middles: IndexArray, angles: FloatArray) -> FloatArray:
    """Return the angles between vectors and corner bisectors, as multiples of the corner angles.

    ``middles`` are the directions of the bisectors. Vectors and directions are complex numbers. The
    offset of a zero vector is infinite.
    """
    return np.where(vectors == 0, np.inf, np.abs(np.angle(vectors / middles)) / angles)


def downstream_slots(mesh: TriangleMesh, vectors: IndexArray) -> IntArray:
    """Return, for each vertex, the slot ``3 f + k`` at which the flow leaves it.

    The field at the vertex, corner k of face f, leads into face f. ``vectors`` (F, 3) are complex
    vectors at corners.
    """
    around = corners(mesh)
    off = angular_offsets(vectors, around.middles, around.angles)
    slots = np.argsort(-off, axis=None, kind="stable")
    ahead = np.empty(len(mesh.vertices), dtype=np.int64)
    ahead[mesh.faces.ravel()[slots]] = slots  # the last assignment to a vertex wins
    return ahead


def _pairs(numbers: IndexArray) -> FloatArray:
    return np.stack([numbers.real, numbers.imag], axis=-1)


@kernel
def vector_at(flow: SmoothFlow, f: Face, x: float, y: float) -> tuple[float, float]:
    w = flow.vectors
    return (
        w[f, 0, 0] + x * w[f, 1, 0] + y * w[f, 2, 0],
        w[f, 0, 1] + x * w[f, 1, 1] + y * w[f, 2, 1],
    )


@kernel
def midpoint(flow: SmoothFlow, walker: Walker, step: float, slide: bool) -> Walker:
    """Replace a walker's vector by ``step`` times the field half a step ahead (midpoint rule).

    The previous vector determines the half step. The new vector is in the local frame of the
    walker's face. If the half step leaves the mesh, the face becomes -1, unless ``slide`` allows
    the walker to slide along the boundary.
    """
    f, x, y, u, v = walker
    g, a, b, p, q = walk_straight(flow, Walker(f, x, y, u / 2, v / 2), slide)
    if g < 0:
        return Walker(g, x, y, u, v)
    r, s = vector_at(flow, g, a, b)
    seen, length = 4 * (p * p + q * q), u * u + v * v
    if seen > _STRAIGHT_SHARE_MIN * length:
        cosine, sine = 2 * step * (p * u + q * v) / seen, 2 * step * (p * v - q * u) / seen
        u, v = cosine * r - sine * s, sine * r + cosine * s
    elif seen > 0.0:  # the walker slid along the boundary; scale by the ratio of the speeds
        ratio = max(2 * step * (p * r + q * s) / seen, 0.0)
        u, v = ratio * u, ratio * v
    return Walker(f, x, y, u, v)


@kernel
def walk_straight(flow: SmoothFlow, walker: Walker, slide: bool = False) -> Walker:
    """Move a walker straight by its vector across faces.

    At a boundary it slides along the boundary if ``slide`` is True; otherwise its face becomes -1.
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
        motion = flow.unfolding[f, leave]
        c, s = motion[0], motion[1]
        x, y = c * x - s * y + motion[2], s * x + c * y + motion[3]
        u, v = c * u - s * v, s * u + c * v
        f, entered = slot // 3, slot % 3
    return Walker(f if slide else -1, x, y, u, v)


@kernel
def enter(
    gradients: FloatArray, faces: IndexArray, barycentric: FloatArray, places: FloatArray
) -> None:
    """Convert barycentric weights (P, 3) of points to coordinates in the local frames of faces.

    The coordinates are written to ``places`` (P, 2). Points are moved slightly inwards.
    """
    for i in range(faces.size):
        (a, b), (c, d) = gradients[faces[i], 1], gradients[faces[i], 2]
        second = (1 - _INWARD_SHARE) * barycentric[i, 1] + _INWARD_SHARE / 3
        third = (1 - _INWARD_SHARE) * barycentric[i, 2] + _INWARD_SHARE / 3
        determinant = a * d - b * c
        places[i, 0] = (d * second - b * third) / determinant
        places[i, 1] = (a * third - c * second) / determinant


@kernel
def leave(
    gradients: FloatArray, faces: IndexArray, places: FloatArray, barycentric: FloatArray
) -> None:
    """Convert coordinates ``places`` (P, 2) in the local frames of faces to barycentric weights.

    The weights, which are not negative, are written to ``barycentric`` (P, 3).
    """
    for i in range(faces.size):
        total = 0.0
        for c in range(3):
            x, y = gradients[faces[i], c]
            weight = x * places[i, 0] + y * places[i, 1] + (1.0 if c == 0 else 0.0)
            barycentric[i, c] = max(weight, 0.0)
            total += barycentric[i, c]
        for c in range(3):
            barycentric[i, c] /= total


@kernel
def advect_points(
    flow: SmoothFlow, sizes: FloatArray, duration: float, faces: IndexArray, places: FloatArray
) -> None:
    """Move P points along a continuous field for a duration of either sign.

    ``faces`` and the coordinates ``places`` (P, 2) in their local frames are updated. ``sizes``
    (F,) are the square roots of the areas of all faces. Steps are short compared with the time in
    which the field changes by its own size. Points near zeros of the field therefore do not jump.
    """
    for i in range(faces.size):
        f, x, y = faces[i], places[i, 0], places[i, 1]
        left = duration
        for _ in range(STEP_LIMIT):
            u, v = vector_at(flow, f, x, y)
            speed = math.sqrt(u * u + v * v)
            if speed * abs(left) <= _LENGTH_MIN * sizes[f]:
                break
            slope = 0.0
            for k in range(2):
                slope += flow.vectors[f, 1, k] ** 2 + flow.vectors[f, 2, k] ** 2
            step = math.copysign(min(abs(left), STEP / (speed / sizes[f] + math.sqrt(slope))), left)
            walker = midpoint(flow, Walker(f, x, y, step * u, step * v), step, True)
            f, x, y, u, v = walk_straight(flow, walker, True)
            left -= step
            if left == 0.0:
                break
        faces[i], places[i, 0], places[i, 1] = f, x, y
