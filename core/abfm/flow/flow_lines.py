"""Flow lines: paths of points along piecewise constant fields, a witness for advection."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.vector_fields import check_field
from abfm.errors import ParameterError, brief
from abfm.flow import tracing
from abfm.flow.tracing import FaceFlow, Path, Position, face_flow
from abfm.maps.surface_points import SurfacePoints
from abfm.mesh import TriangleMesh
from abfm.numerics.real_numbers import is_finite_number, real_numbers
from abfm.types import FloatArray, IntArray

Ending = Literal["time", "boundary", "stagnation", "step limit"]
STEP_LIMIT = 100_000
"""Edges and vertices that a path may meet."""
_ENDINGS: dict[int, Ending] = {
    tracing.GOING: "step limit",
    tracing.BOUNDARY: "boundary",
    tracing.STAGNATION: "stagnation",
}


@dataclass(frozen=True, eq=False)
class FlowLine:
    """The path of one point: straight from each of K places to the next, at constant speed."""

    # (K,), when each place is reached: from 0 up, or from 0 down against the flow
    times: FloatArray
    positions: FloatArray  # (K, 3), in the mesh's units
    faces: IntArray  # (K,), a face that holds each place
    barycentric: FloatArray  # (K, 3), the weights of its corners
    ended: Ending
    """Why the path ends: "time" where the whole duration was walked; "boundary" where it left the
    mesh; "stagnation" where the field is zero or pushes in from all sides, so that the point rests
    there; "step limit"."""

    def at(self, t: float) -> FloatArray:
        """Return the position (3,) at a time, clipped to those of the path."""
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
    """Walk points along a field, or along N fields in a row, exactly from edge to edge.

    Parameters
    ----------
    velocity : (F, 3) or (N, F, 3) array
        Tangent vectors, in the mesh's length unit per unit of time; a normal part is dropped.
    start : SurfacePoints
    duration : float
        How long to walk. Negative: against the flow of the first field.
    tau : float, optional
        End time of the N fields, each of which lasts ``tau / N``; the last one goes on. Needed for
        several fields.

    Raises
    ------
    ParameterError
        If an array has another shape or values that are not finite, a start is not on the mesh, or
        ``duration`` or
        ``tau`` is out of range.
    """
    fields = fields_in_a_row(mesh, velocity)
    if not is_finite_number(duration):
        raise ParameterError(f"duration is {brief(duration)}; expected a finite time")
    if len(fields) > 1 and tau is None:
        raise ParameterError(
            f"velocity has {len(fields)} fields but tau is missing: say when the last one ends"
        )
    if tau is not None and not (is_finite_number(tau) and tau > 0):
        raise ParameterError(f"tau is {brief(tau)}; expected a positive time")
    if duration < 0:
        fields = -fields[:1]
    changes = np.arange(1, len(fields)) * (tau or 0.0) / len(fields)
    ends = [*changes[changes < abs(duration)], abs(float(duration))]
    flows = [face_flow(mesh, field) for field in fields[: len(ends)]]
    walk = _Walk(mesh, flows, ends, -1 if duration < 0 else 1)
    return [walk.line(f, b) for f, b in zip(*walkers(mesh, start), strict=True)]


class _Walk:
    """Fields, the times at which each ends, and memory for one path."""

    def __init__(
        self, mesh: TriangleMesh, flows: list[FaceFlow], ends: list[float], sign: int
    ) -> None:
        self.mesh, self.flows, self.ends, self.sign = mesh, flows, ends, sign
        size = STEP_LIMIT + 1
        self._path = Path(np.empty(size), np.empty(size, dtype=np.int64), np.empty((size, 3)))

    def line(self, face: int, barycentric: FloatArray) -> FlowLine:
        where, b = np.array([face, -1]), barycentric.copy()
        path, count, status = self._path, 0, tracing.STAGNATION
        for flow, begin, end in zip(self.flows, [0.0, *self.ends], self.ends, strict=False):
            if status == tracing.STAGNATION:
                path.times[count], path.faces[count], path.weights[count] = begin, where[0], b
                count += 1
            where[1] = -1
            if b.max() >= tracing.AT_VERTEX:
                tracing.leave_vertex(flow, where, b, int(b.argmax()))
            count, status = tracing.trace(flow, Position(where, b), (begin, end), path, count)
            if status == tracing.BOUNDARY or count == len(path.times):
                break
        faces, weights = path.faces[:count].copy(), path.weights[:count].copy()
        positions = np.einsum("kc,kcx->kx", weights, self.mesh.vertices[self.mesh.faces[faces]])
        ended: Ending = "time" if path.times[count - 1] == self.ends[-1] else _ENDINGS[status]
        return FlowLine(self.sign * path.times[:count], positions, faces, weights, ended)


def fields_in_a_row(mesh: TriangleMesh, velocity: ArrayLike) -> FloatArray:
    """Return N fields (F, 3), given as (F, 3) or (N, F, 3).

    Raises
    ------
    ParameterError
        If they have another shape or values that are not finite.
    """
    given = real_numbers(velocity, "velocity", ParameterError)
    array = given[None] if given.ndim == 2 else given
    if array.ndim != 3 or not len(array):
        expected = (len(mesh.faces), 3)
        raise ParameterError(
            f"velocity has shape {given.shape}; expected {expected}, or N of these in a row"
        )
    for field in array:
        check_field(mesh, field, "velocity")
    return array


def walkers(mesh: TriangleMesh, start: SurfacePoints) -> tuple[IntArray, FloatArray]:
    """Return faces (P,) and barycentric weights (P, 3), none negative, of points of the mesh.

    Raises
    ------
    ParameterError
        If they are points of a mesh of other faces.
    """
    if len(start.mesh.faces) != len(mesh.faces):
        raise ParameterError(
            f"start has points of a mesh of {len(start.mesh.faces)} faces; expected points of the "
            f"mesh itself, of {len(mesh.faces)}"
        )
    inside = np.maximum(start.barycentric, 0)
    return start.faces.copy(), inside / inside.sum(axis=1, keepdims=True)
