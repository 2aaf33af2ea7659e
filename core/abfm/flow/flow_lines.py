"""Flow lines of fields that are constant in each face, traced exactly from edge to edge.

Exact flow lines check the discrete advection. A walker is a moving point, given by its face and
barycentric weights ``b``. ``where`` has the face and the corner opposite the edge along which the
walker slides (-1 inside the face). If both faces of an edge push towards it, the walker follows
Filippov's solution: the mean of the two vectors that lies along the edge. From a vertex, the walker
continues along an edge or in a face that leads away, whichever is the fastest.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.operators import face_areas, face_frames, hat_gradients
from abfm.calculus.vector_fields import check_field, to_frame
from abfm.errors import MeshError, ParameterError, brief
from abfm.maps.surface_points import SurfacePoints
from abfm.mesh import TriangleMesh
from abfm.mesh.subdivision import refined, times_subdivided, to_children, to_parents
from abfm.numerics.kernels import kernel
from abfm.numerics.real_numbers import is_finite_number, real_numbers
from abfm.types import FloatArray, IndexArray, IntArray

Ending = Literal["time", "boundary", "stagnation", "step limit"]
STEP_LIMIT = 100_000  # largest number of edges and vertices that a path may cross
AT_VERTEX = 1.0 - 1e-12  # a walker is at a corner if its weight there is at least this
_RATE_MAX = 1e150  # faces per unit of time; the product of two rates is still finite
MOVING_STATE, BOUNDARY_STATE, STAGNATION_STATE = 0, 1, 2
_ENDINGS: tuple[Ending, ...] = ("step limit", "boundary", "stagnation")


@dataclass(frozen=True, eq=False)
class FlowLine:
    """The path of one point: straight at constant speed between K consecutive positions."""

    # (K,), times at the positions, ascending from 0, or descending from 0 against the flow
    times: FloatArray
    positions: FloatArray  # (K, 3), in the mesh's units
    faces: IntArray  # (K,), a face that contains each position
    barycentric: FloatArray  # (K, 3), weights of the corners of that face
    ending: Ending
    """Reason for the end of the path.

    "time": the complete duration. "boundary": the path left the mesh. "stagnation": the field is
    zero or points inwards from all sides. "step limit": too many edges and vertices.
    """

    def at(self, t: float) -> FloatArray:
        """Return the position (3,) at time ``t``, which is clipped to the times of the path."""
        order = slice(None) if self.times[-1] >= 0 else slice(None, None, -1)
        times = self.times[order]
        return np.array([np.interp(t, times, self.positions[order, x]) for x in range(3)])


def flow_lines(
    mesh: TriangleMesh,
    velocity: ArrayLike,
    start: SurfacePoints,
    duration: float,
    tau: float | None = None,
) -> list[FlowLine]:
    """Trace points along a field, or along N consecutive fields, exactly from edge to edge.

    Parameters
    ----------
    velocity : (F, 3) or (N, F, 3) array
        Tangent vectors, in the mesh's length unit per unit of time; a normal part is dropped.
        Arrays (4^k F, 3) or (N, 4^k F, 3) are fields on the mesh subdivided k times.
    duration : float
        Duration of the path. If negative, the path goes against the flow of the first field.
    tau : float, optional
        End time of the N fields, each of which lasts ``tau / N``; the last field continues beyond
        it. Several fields require this argument.
    """
    fields, k = checked_fields(mesh, velocity)
    fine = refined(mesh, k)
    if not is_finite_number(duration):
        raise ParameterError(f"duration is {brief(duration)}; expected a finite time")
    if len(fields) > 1 and tau is None:
        raise ParameterError(
            f"velocity has {len(fields)} fields but tau is missing; give tau, the end time "
            "of the last field"
        )
    if tau is not None and not (is_finite_number(tau) and tau > 0):
        raise ParameterError(f"tau is {brief(tau)}; expected a positive time")
    if duration < 0:
        fields = -fields[:1]
    changes = np.arange(1, len(fields)) * (tau or 0.0) / len(fields)
    ends = [*changes[changes < abs(duration)], abs(float(duration))]
    size, sign = STEP_LIMIT + 1, -1 if duration < 0 else 1
    path = Path(np.empty(size), np.empty(size, dtype=np.int64), np.empty((size, 3)))
    flows = [face_flow(fine, field) for field in fields[: len(ends)]]
    spans = list(zip(flows, [0.0, *ends[:-1]], ends, strict=True))
    lines = []
    for face, barycentric in zip(*to_children(*start_points(mesh, start), k), strict=True):
        count, status = _walked(face, barycentric, spans, path)
        faces, weights = to_parents(path.faces[:count].copy(), path.weights[:count].copy(), k)
        positions = np.einsum("kc,kcx->kx", weights, mesh.vertices[mesh.faces[faces]])
        ending: Ending = "time" if path.times[count - 1] == ends[-1] else _ENDINGS[status]
        lines.append(FlowLine(sign * path.times[:count], positions, faces, weights, ending))
    return lines


class FaceFlow(NamedTuple):
    """A field that is constant in each face, prepared for tracing flow lines."""

    rates: FloatArray  # (F, 3), growth of each barycentric weight per unit of time
    # (F, 3), component along the edge opposite each corner, in edges per unit of time
    along: FloatArray
    areas: FloatArray  # (F,)
    neighbours: IntArray  # (F, 3), the mesh's ``opposite_slots``


class Path(NamedTuple):
    """Memory for the times and positions at which a walker crosses edges and vertices."""

    times: FloatArray  # (K,)
    faces: IndexArray  # (K,)
    weights: FloatArray  # (K, 3)


def _walked(
    face: int, start: FloatArray, spans: list[tuple[FaceFlow, float, float]], path: Path
) -> tuple[int, int]:
    """Trace a walker along consecutive fields; return the number of places and the final state.

    ``spans`` has each field with its begin and end time. Crossed places are written to ``path``.
    """
    where, b = np.array([face, -1]), start.copy()
    count, status = 0, STAGNATION_STATE
    for flow, begin, end in spans:
        if status == STAGNATION_STATE:
            path.times[count], path.faces[count], path.weights[count] = begin, where[0], b
            count += 1
        where[1] = -1
        if b.max() >= AT_VERTEX:
            leave_vertex(flow, where, b, int(b.argmax()))
        count, status = trace(flow, (where, b), (begin, end), path, count)
        if status == BOUNDARY_STATE or count == len(path.times):
            break
    return count, status


def face_flow(mesh: TriangleMesh, field: FloatArray) -> FaceFlow:
    coefficients, corners = to_frame(mesh, field), mesh.vertices[mesh.faces]
    edges = np.roll(corners, 1, axis=1) - np.roll(corners, -1, axis=1)
    edges = np.einsum("fcx,fkx->fck", edges, face_frames(mesh))
    with np.errstate(over="ignore", invalid="ignore"):
        rates = np.einsum("fck,fk->fc", hat_gradients(mesh), coefficients)
        along = np.einsum("fck,fk->fc", edges, coefficients) / (edges**2).sum(axis=2)
    if not (np.abs(rates).max() < _RATE_MAX and np.abs(along).max() < _RATE_MAX):
        raise ParameterError(
            f"velocity crosses a face in less than {1 / _RATE_MAX} units of time; scale it down"
        )
    return FaceFlow(rates, along, face_areas(mesh), mesh.opposite_slots)


@kernel
def sliding_speed(flow: FaceFlow, f: int, c: int) -> float:
    """Return the speed of a walker along an edge to which the fields of both its faces point.

    The edge is opposite corner ``c`` of face ``f``. The speed is in edges per unit of time.
    Positive speeds lead from corner ``c + 1`` to ``c + 2`` of the face.
    """
    slot = flow.neighbours[f, c]
    g, k = slot // 3, slot % 3
    here, there = flow.rates[f, c], flow.rates[g, k] * (flow.areas[g] / flow.areas[f])
    share = there / (here + there)
    speed: float = share * flow.along[f, c] - (1.0 - share) * flow.along[g, k]
    return speed


@kernel
def cross_edge(flow: FaceFlow, where: IndexArray, b: FloatArray, c: int) -> int:
    """Move a walker across the edge opposite corner ``c``; return its state.

    If the field behind the edge points back, the walker slides along the edge instead. At a
    boundary it stops.
    """
    slot = flow.neighbours[where[0], c]
    if slot < 0:
        return BOUNDARY_STATE
    g, k = slot // 3, slot % 3
    if flow.rates[g, k] < 0.0:
        where[1] = c
        return MOVING_STATE
    where[0] = g
    first, last = b[(c + 1) % 3], b[(c + 2) % 3]
    b[k] = 0.0
    b[(k + 1) % 3] = last
    b[(k + 2) % 3] = first
    return MOVING_STATE


@kernel
def leave_vertex(flow: FaceFlow, where: IndexArray, b: FloatArray, corner: int) -> int:
    """Move a walker from a vertex to the face or edge with the fastest motion; return its state.

    Speeds are in edges or face heights per unit of time. If none is positive, the walker stops.
    """
    b[:] = 0.0
    fastest, face, away_from, along = 0.0, where[0], corner, -1
    is_closed = False
    for turn in range(1, 3):
        f, j = where[0], corner
        while not is_closed:
            if (
                flow.rates[f, (j + 1) % 3] >= 0.0
                and flow.rates[f, (j + 2) % 3] >= 0.0
                and -flow.rates[f, j] > fastest
            ):
                fastest, face, away_from, along = -flow.rates[f, j], f, j, -1
            c = (j + 3 - turn) % 3
            slot = flow.neighbours[f, c]
            if slot < 0:
                break
            g, k = slot // 3, slot % 3
            if flow.rates[f, c] < 0.0 and flow.rates[g, k] < 0.0:
                speed = sliding_speed(flow, f, c) * (3 - 2 * turn)
                if speed > fastest:
                    fastest, face, away_from, along = speed, f, j, c
            f, j = g, (k + 3 - turn) % 3
            is_closed = f == where[0]
    where[0], where[1] = face, along
    b[away_from] = 1.0
    if fastest > 0.0:
        return MOVING_STATE
    return STAGNATION_STATE if is_closed else BOUNDARY_STATE


@kernel
def advance(
    flow: FaceFlow, where: IndexArray, b: FloatArray, rates: FloatArray, time: float
) -> tuple[float, int]:
    """Move a walker for a time, but at most to the next edge or vertex.

    ``rates`` (3,) are the changes of its barycentric weights per unit of time. Return the used time
    and the state of the walker.
    """
    leave, used = -1, time
    for i in range(3):
        if rates[i] < 0.0 and b[i] <= -rates[i] * used:
            leave, used = i, b[i] / -rates[i]
    total = 0.0
    for i in range(3):
        b[i] = 0.0 if i == leave else max(b[i] + used * rates[i], 0.0)
        total += b[i]
    for i in range(3):
        b[i] /= total
    if leave < 0:
        return used, MOVING_STATE
    for i in range(3):
        if b[i] >= AT_VERTEX:
            return used, leave_vertex(flow, where, b, i)
    return used, cross_edge(flow, where, b, leave)


@kernel
def trace(
    flow: FaceFlow,
    walker: tuple[IndexArray, FloatArray],
    span: tuple[float, float],
    path: Path,
    count: int,
) -> tuple[int, int]:
    """Trace a walker along a field for a ``span`` from one time to another.

    Each crossing is written to ``path``, which has ``count`` places before. Return the new count
    and the state of the walker.
    """
    (where, b), (now, end) = walker, span
    rates = np.empty(3)
    status = MOVING_STATE
    while status == MOVING_STATE and now < end and count < path.times.size:
        rates[:] = flow.rates[where[0]]
        if where[1] >= 0:
            speed = sliding_speed(flow, where[0], where[1])
            rates[where[1]] = 0.0
            rates[(where[1] + 1) % 3], rates[(where[1] + 2) % 3] = -speed, speed
        if rates[0] == 0.0 and rates[1] == 0.0 and rates[2] == 0.0:
            return count, STAGNATION_STATE
        used, status = advance(flow, where, b, rates, end - now)
        now = end if used >= end - now else now + used
        path.times[count] = now
        path.faces[count] = where[0]
        path.weights[count] = b
        count += 1
    return count, status


def checked_fields(mesh: TriangleMesh, velocity: ArrayLike) -> tuple[FloatArray, int]:
    """Check a field, or N fields, on the mesh subdivided k times; return (N, 4^k F, 3) and k."""
    given = real_numbers(velocity, "velocity", ParameterError)
    array = given[None] if given.ndim == 2 else given
    if array.ndim != 3 or array.shape[2] != 3 or not len(array):
        expected = (len(mesh.faces), 3)
        raise ParameterError(
            f"velocity has shape {given.shape}; expected {expected}, or N such fields"
        )
    try:
        k = times_subdivided(array.shape[1], mesh)
    except MeshError as error:
        raise ParameterError(f"velocity has shape {given.shape}, {error}") from None
    for field in array:
        check_field(refined(mesh, k), field, "velocity")
    return array, k


def start_points(mesh: TriangleMesh, start: SurfacePoints) -> tuple[IntArray, FloatArray]:
    """Check that points belong to a mesh; return their faces (P,) and barycentric weights (P, 3).

    Negative weights become 0, and the sum of weights becomes 1.
    """
    if len(start.mesh.faces) != len(mesh.faces):
        raise ParameterError(
            f"start has points of a mesh with {len(start.mesh.faces)} faces; expected points of "
            f"this mesh with {len(mesh.faces)} faces"
        )
    inside = np.maximum(start.barycentric, 0)
    return start.faces.copy(), inside / inside.sum(axis=1, keepdims=True)
