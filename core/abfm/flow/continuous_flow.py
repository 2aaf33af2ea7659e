"""Where a flow takes points: walks along the field made continuous, a witness for the maps that advection gives.

Points have no dispersion, as advection on vertices has: each follows the continuous field of `smooth_flow` by the
midpoint rule, in steps that are a part of a face long, straight over the edges; from a vertex it begins in the face
that the field leads into, whatever its number. On smooth fields the error falls with the square of the edge length.
"""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.operators import face_areas, face_frames, hat_gradients
from abfm.errors import ParameterError, brief
from abfm.flow.flow_lines import FacePoints, check_start, fields_in_a_row
from abfm.flow.smooth_flow import SmoothFlow, slots_ahead, smooth_flow, vector_at, walk_straight
from abfm.flow.tracing import AT_VERTEX
from abfm.maps.surface_points import SurfacePoints, vertex_points
from abfm.mesh import TriangleMesh
from abfm.numerics.kernels import kernel
from abfm.real_numbers import is_finite_number
from abfm.types import FloatArray, IndexArray, IntArray

STEP = 0.5
"""Of a walk, at most, in square roots of the area of the face where it begins."""
STEP_LIMIT = 100_000
"""Steps of one point along one field; it then stays where it is."""
_MEAN_LIMIT = 10_000  # steps of a point on average over the surface
_STILL = 1e-12  # a part of the face so short is no way
_STRAIGHT = 1 - 1e-9  # part of a way's squared length that is left: less where it slid along the boundary
_INWARD = 1e-10  # of the way to a face's centre: at a vertex rounding would choose the side on which to pass it
_CHUNK = 4096  # points between calls: 0.2 s where they go over a hundred faces each


def flow_map(
    mesh: TriangleMesh,
    velocity: ArrayLike,
    tau: float,
    *,
    backwards: bool = False,
    start: FacePoints | None = None,
    between: Callable[[], None] | None = None,
) -> SurfacePoints:
    """Carry points of the surface along a field, or along N fields in a row, each for ``tau / N``.

    A point that comes to the boundary goes on along it with the part of the field that leads along it; where none does
    it rests.

    Parameters
    ----------
    velocity : (F, 3) or (N, F, 3) array
        Tangent vectors, in the mesh's length unit per unit of time; a normal part is dropped.
    tau : float
        End time, positive or 0.
    backwards : bool
        Undo the flow instead: the fields in reverse order, each against its direction. Of every vertex this is where
        its value came from, so that `surface_points.pull_back` of a function by it is the function carried to ``tau``.
    start : points with ``faces`` (P,) and ``barycentric`` (P, 3), optional
        For example `SurfacePoints`. All V vertices by default.
    between : callable, optional
        Called again and again in this thread; what it raises ends the work.

    Returns
    -------
    SurfacePoints
        P points with distances 0.

    Raises
    ------
    ParameterError
        If an array has another shape or values that are not finite, a start is not in the mesh, ``tau`` is out of
        range, or the fields lead over so many faces that the walks would take very long.
    """
    fields = fields_in_a_row(mesh, velocity)
    given = vertex_points(mesh, np.arange(len(mesh.vertices))) if start is None else start
    faces, barycentric = check_start(mesh, given)
    if not (is_finite_number(tau) and tau >= 0):
        raise ParameterError(f"tau is {brief(tau)}; expected a finite time that is not negative")
    duration = (-tau if backwards else tau) / len(fields)
    if backwards:
        fields = fields[::-1]
    unit = mesh.normalized()
    _check_work(mesh, fields, abs(duration))
    at_vertex = barycentric.max(axis=1) >= AT_VERTEX
    if at_vertex.any():
        vertices = mesh.faces[faces[at_vertex], barycentric[at_vertex].argmax(axis=1)]
        ahead = slots_ahead(unit, math.copysign(1 / mesh.length_scale, duration) * fields[0])[vertices]
        faces[at_vertex], barycentric[at_vertex] = ahead // 3, np.eye(3)[ahead % 3]
    barycentric = (1 - _INWARD) * barycentric + _INWARD / 3
    corners = unit.vertices[unit.faces]
    sides = np.einsum("fcx,fkx->fck", corners[:, 1:] - corners[:, :1], face_frames(unit))
    places = np.einsum("pc,pck->pk", barycentric[:, 1:], sides[faces])
    sizes = np.sqrt(face_areas(unit))
    for field in fields:
        flow = smooth_flow(unit, field / mesh.length_scale)
        for begin in range(0, len(faces), _CHUNK):
            if between is not None:
                between()
            chunk = slice(begin, begin + _CHUNK)
            carry(flow, sizes, duration, faces[chunk], places[chunk])
    return _points(mesh, faces, places)


def _check_work(mesh: TriangleMesh, fields: FloatArray, duration: float) -> None:
    """Refuse fields along which the walks would not end."""
    sizes = np.sqrt(face_areas(mesh)) / mesh.length_scale
    with np.errstate(over="ignore", invalid="ignore"):
        ways = [np.linalg.norm(field / mesh.length_scale * duration, axis=1) for field in fields]
        faces = float(sum(sizes @ way for way in ways))  # of area sizes^2, each size long
    if not faces <= STEP * _MEAN_LIMIT:
        raise ParameterError(
            f"velocity leads points over {faces:.0e} faces on average until tau (at most {STEP * _MEAN_LIMIT:.0e}): "
            "scale it down or shorten tau"
        )


def _points(mesh: TriangleMesh, faces: IntArray, places: FloatArray) -> SurfacePoints:
    """Points by places (P, 2) in the frames of faces (P,), lengths in units of ``length_scale``."""
    barycentric = np.einsum("pck,pk->pc", hat_gradients(mesh.normalized())[faces], places)
    barycentric[:, 0] += 1
    barycentric = np.maximum(barycentric, 0)
    barycentric /= barycentric.sum(axis=1, keepdims=True)
    positions = np.einsum("pc,pcx->px", barycentric, mesh.vertices[mesh.faces[faces]])
    return SurfacePoints(faces, barycentric, positions, np.zeros(len(faces)))


@kernel
def carry(flow: SmoothFlow, sizes: FloatArray, duration: float, faces: IndexArray, places: FloatArray) -> None:
    """Move points, given by faces (P,) and places (P, 2) in their frames, for a time of either sign.

    A step is also short against the time in which the field changes by as much as it is, so that points near its zeros
    do not jump. ``sizes`` (F,) are the square roots of the faces' areas.
    """
    for i in range(faces.size):
        f, x, y = faces[i], places[i, 0], places[i, 1]
        left = duration
        for _ in range(STEP_LIMIT):
            u, v = vector_at(flow, f, x, y)
            speed = math.sqrt(u * u + v * v)
            if speed * abs(left) <= _STILL * sizes[f]:
                break
            slope = 0.0
            for k in range(2):
                slope += flow.vectors[f, 1, k] ** 2 + flow.vectors[f, 2, k] ** 2
            step = math.copysign(min(abs(left), STEP / (speed / sizes[f] + math.sqrt(slope))), left)
            u, v = step * u, step * v
            g, a, b, p, q = walk_straight(flow, f, x, y, u / 2, v / 2, True)
            r, s = vector_at(flow, g, a, b)
            seen, length = 4 * (p * p + q * q), u * u + v * v
            if seen > _STRAIGHT * length:
                cosine, sine = 2 * step * (p * u + q * v) / seen, 2 * step * (p * v - q * u) / seen
                u, v = cosine * r - sine * s, sine * r + cosine * s
            elif seen > 0.0:  # it slid along the boundary: how much faster does it there?
                ratio = max(2 * step * (p * r + q * s) / seen, 0.0)
                u, v = ratio * u, ratio * v
            f, x, y, u, v = walk_straight(flow, f, x, y, u, v, True)
            left -= step
            if left == 0.0:
                break
        faces[i], places[i, 0], places[i, 1] = f, x, y
