"""Flow lines of the field made continuous, a witness for the maps that advection gives.

Points have no dispersion, as advection on vertices has: each follows the continuous field of
`smooth_flow` by the midpoint rule, in steps that are a part of a face long, straight over the
edges; from a vertex it begins in the face that the field leads into, whatever its number. On smooth
fields the error falls with the square of the edge length.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.operators import face_areas, face_frames, hat_gradients
from abfm.errors import ParameterError, brief
from abfm.flow.flow_lines import fields_in_a_row, walkers
from abfm.flow.smooth_flow import (
    SmoothFlow,
    Walker,
    midpoint,
    slots_ahead,
    smooth_flow,
    vector_at,
    walk_straight,
)
from abfm.flow.tracing import AT_VERTEX
from abfm.maps.surface_points import SurfacePoints, vertex_points
from abfm.mesh import TriangleMesh
from abfm.numerics.kernels import kernel
from abfm.numerics.real_numbers import is_finite_number
from abfm.types import FloatArray, IndexArray, IntArray
from abfm.workers.control import checkpoint

STEP = 0.5
"""Of a walk, at most, in square roots of the area of the face where it begins."""
STEP_LIMIT = 100_000
"""Steps of one point along one field; it then stays where it is."""
_MEAN_LIMIT = 10_000  # steps of a point on average over the surface
_STILL = 1e-12  # a part of the face so short is no way
# of the way to a face's centre: at a vertex rounding would choose the side on which to pass it
_INWARD = 1e-10
_CHUNK = 4096  # points between checkpoints: 0.2 s where they go over a hundred faces each


class ContinuousFlow:
    """The flow of a field made continuous, or of N fields in a row, each for ``tau / N``.

    A point that comes to the boundary goes on along it with the part of the field that leads along
    it; where none does it rests.

    Parameters
    ----------
    mesh : TriangleMesh
    velocity : (F, 3) or (N, F, 3) array
        Tangent vectors, in the mesh's length unit per unit of time; a normal part is dropped.
    tau : float
        End time, positive or 0.

    Raises
    ------
    ParameterError
        If the fields have another shape or values that are not finite, ``tau`` is out of range, or
        the fields lead over so many faces that the walks would take very long.
    """

    def __init__(self, mesh: TriangleMesh, velocity: ArrayLike, tau: float) -> None:
        self.mesh, self.fields = mesh, fields_in_a_row(mesh, velocity)
        if not (is_finite_number(tau) and tau >= 0):
            raise ParameterError(
                f"tau is {brief(tau)}; expected a finite time that is not negative"
            )
        self.step = tau / len(self.fields)
        self._check_work()

    def destinations(self, start: SurfacePoints | None = None) -> SurfacePoints:
        """Carry points along the flow to ``tau``; all vertices by default.

        Raises
        ------
        ParameterError
            If a start is not on the mesh.
        """
        return self._walked(start, self.fields, self.step)

    def origins(self, start: SurfacePoints | None = None) -> SurfacePoints:
        """Carry points back along the flow from ``tau``; all vertices by default.

        Of every vertex this is where its value came from: its `pull_back` of a function is the
        function carried to ``tau``.

        Raises
        ------
        ParameterError
            If a start is not on the mesh.
        """
        return self._walked(start, self.fields[::-1], -self.step)

    def _walked(
        self, start: SurfacePoints | None, fields: FloatArray, duration: float
    ) -> SurfacePoints:
        """Walk along fields (N, F, 3), each for a time of either sign."""
        mesh, unit = self.mesh, self.mesh.normalized()
        faces, barycentric = walkers(mesh, vertex_points(mesh) if start is None else start)
        at_vertex = barycentric.max(axis=1) >= AT_VERTEX
        if at_vertex.any():
            vertices = mesh.faces[faces[at_vertex], barycentric[at_vertex].argmax(axis=1)]
            leading = math.copysign(1 / mesh.length_scale, duration) * fields[0]
            ahead = slots_ahead(unit, leading)[vertices]
            faces[at_vertex], barycentric[at_vertex] = ahead // 3, np.eye(3)[ahead % 3]
        barycentric = (1 - _INWARD) * barycentric + _INWARD / 3
        corners = unit.vertices[unit.faces]
        sides = np.einsum("fcx,fkx->fck", corners[:, 1:] - corners[:, :1], face_frames(unit))
        places = np.einsum("pc,pck->pk", barycentric[:, 1:], sides[faces])
        sizes = np.sqrt(face_areas(unit))
        for field in fields:
            flow = smooth_flow(unit, field / mesh.length_scale)
            for begin in range(0, len(faces), _CHUNK):
                checkpoint()
                chunk = slice(begin, begin + _CHUNK)
                carry(flow, sizes, duration, faces[chunk], places[chunk])
        return _points(mesh, faces, places)

    def _check_work(self) -> None:
        """Refuse fields along which the walks would not end."""
        scale = self.mesh.length_scale
        sizes = np.sqrt(face_areas(self.mesh)) / scale
        with np.errstate(over="ignore", invalid="ignore"):
            ways = [np.linalg.norm(v / scale * self.step, axis=1) for v in self.fields]
            faces = float(sum(sizes @ way for way in ways))  # of area sizes^2, each size long
        if not faces <= STEP * _MEAN_LIMIT:
            raise ParameterError(
                f"velocity leads points over {faces:.0e} faces on average until tau (at most "
                f"{STEP * _MEAN_LIMIT:.0e}): scale it down or shorten tau"
            )


def _points(mesh: TriangleMesh, faces: IntArray, places: FloatArray) -> SurfacePoints:
    """Return points by places (P, 2) in the frames of faces (P,), in units of ``length_scale``."""
    barycentric = np.einsum("pck,pk->pc", hat_gradients(mesh.normalized())[faces], places)
    barycentric[:, 0] += 1
    barycentric = np.maximum(barycentric, 0)
    barycentric /= barycentric.sum(axis=1, keepdims=True)
    return SurfacePoints(mesh, faces, barycentric)


@kernel
def carry(
    flow: SmoothFlow, sizes: FloatArray, duration: float, faces: IndexArray, places: FloatArray
) -> None:
    """Move points, given by faces (P,) and places (P, 2) in their frames, for a time of either
    sign.

    A step is also short against the time in which the field changes by as much as it is, so that
    points near its zeros do not jump. ``sizes`` (F,) are the square roots of the faces' areas.
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
            walker = midpoint(flow, Walker(f, x, y, step * u, step * v), step, True)
            f, x, y, u, v = walk_straight(flow, walker, True)
            left -= step
            if left == 0.0:
                break
        faces[i], places[i, 0], places[i, 1] = f, x, y
