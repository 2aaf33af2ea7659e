"""End points of flow lines of continuous fields, with the exact derivative by the fields.

The flow lines are those of `continuous_flow`, but with equal steps whose number depends on the
speed alone. The end points are smooth functions of the field while points cross the same faces. The
derivative is propagated backward through the recorded steps, and then through the linear fit of
vectors at corners.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy import sparse

from abfm.calculus.operators import hat_gradients
from abfm.errors import AdvectionError
from abfm.flow.continuous_flow import (
    SmoothFlow,
    angular_offsets,
    enter,
    from_corners,
    leave,
    vector_at,
)
from abfm.flow.corner_fit import as_complex, corners, fitted, fitted_adjoint
from abfm.flow.flow_lines import AT_VERTEX
from abfm.maps.surface_points import SurfacePoints
from abfm.numerics.kernels import kernel
from abfm.types import FloatArray, IndexArray, IntArray
from abfm.workers.control import checkpoint

STEPS_PER_FACE = 2.0  # steps in a face of mean size at the largest speed
# smallest and largest number of steps along one field
_STEPS_MIN = 8
_STEPS_MAX = 4096
_CROSSINGS = 64  # edges that a step may cross, as in `continuous_flow`


class Tape(NamedTuple):
    """The record of S steps of L flow lines along one field."""

    faces: IndexArray  # (L, S, 2), faces at the beginning of a step and halfway
    weights: FloatArray  # (L, S, 2, 3), barycentric weights of these places
    # (L, S, 3, 2, 2), derivatives of the end of a step: by its start, and by the field's vectors
    # there and halfway
    jacobians: FloatArray


class Walk(NamedTuple):
    """The end points of L flow lines, and the records of their steps for the derivative."""

    points: SurfacePoints
    tapes: list[Tape]  # one tape for each field


class FlowLineDerivative:
    """Flow lines from L points along N consecutive fields, and derivatives of their end points.

    The mesh has unit area. Fields have coefficients in the local frames of faces, and each lasts
    ``tau / N``.
    """

    def __init__(self, points: SurfacePoints, tau: float) -> None:
        self.mesh, self.points, self.tau = points.mesh, points, tau
        mesh = points.mesh
        self._size = 1 / math.sqrt(len(mesh.faces))
        self._fans = _Fans(points)

    def walk(self, x: FloatArray) -> Walk:
        """Follow the flow lines of fields ``x`` (N, F, 2), and record their steps.

        Raises an AdvectionError if they need too many steps or have no finite end points.
        """
        faces, weights = self.points.faces.copy(), self.points.barycentric.copy()
        tapes: list[Tape] = []
        places = np.empty((len(faces), 2))
        for j, field in enumerate(x):
            vectors, count = fitted(self.mesh, as_complex(field)), self.steps(field, len(x))
            flow = from_corners(self.mesh, vectors)
            if j == 0:
                self._fans.turn_downstream(vectors, faces, weights)
                enter(flow.gradients, faces, weights, places)
            tape = Tape(
                np.empty((len(faces), count, 2), dtype=np.int64),
                np.empty((len(faces), count, 2, 3)),
                np.empty((len(faces), count, 3, 2, 2)),
            )
            follow(flow, self.tau / len(x) / count, faces, places, tape)
            tapes.append(tape)
        leave(hat_gradients(self.mesh), faces, places, weights)
        if not np.isfinite(weights).all():
            raise AdvectionError("flow lines have no finite end points; scale the field down")
        return Walk(SurfacePoints(self.mesh, faces, weights), tapes)

    def gradient(self, walk: Walk, slopes: FloatArray) -> FloatArray:
        """Return the derivative (N, F, 2) of an energy by the fields.

        ``slopes`` (L, 2) are the energy's derivatives by the end points of ``walk``, in the local
        frames of their faces.
        """
        slopes = slopes.copy()
        found = np.empty((len(walk.tapes), len(self.mesh.faces), 2))
        for j in reversed(range(len(walk.tapes))):
            at_corners = np.zeros((len(self.mesh.faces), 3, 2))
            backpropagate(walk.tapes[j], slopes, at_corners)
            of_faces = fitted_adjoint(self.mesh, as_complex(at_corners))
            found[j] = of_faces.view(np.float64).reshape(-1, 2)
        return found

    def steps(self, field: FloatArray, fields: int) -> int:
        """Return the number of steps along one of ``fields`` consecutive fields: a power of two."""
        with np.errstate(over="ignore"):
            fastest = math.sqrt(float((field**2).sum(axis=1).max()))
        over = STEPS_PER_FACE * fastest * self.tau / fields / self._size
        if not over <= _STEPS_MAX:
            raise AdvectionError(
                f"flow lines need {over:.0e} steps; expected at most {_STEPS_MAX:.0e}. Scale the "
                "field down or shorten the time"
            )
        return int(2 ** math.ceil(math.log2(max(over, _STEPS_MIN))))

    def jacobian(self, walk: Walk) -> sparse.csr_array:
        """Return the derivative (2 L, 2 N F) of the end points by the fields.

        End points and fields have coordinates in the local frames of faces.
        """
        rows, zeros = [], np.zeros((len(self.points.faces), 2))
        for row in range(zeros.size):
            checkpoint()
            slopes = zeros.copy()
            slopes[row // 2, row % 2] = 1.0
            rows.append(sparse.csr_array(self.gradient(walk, slopes).reshape(1, -1)))
        return sparse.csr_array(sparse.vstack(rows))


class _Fans:
    """The faces around the points that lie at vertices."""

    def __init__(self, points: SurfacePoints) -> None:
        mesh = points.mesh
        at = np.flatnonzero(points.barycentric.max(axis=1) >= AT_VERTEX)
        vertices = mesh.faces[points.faces[at], points.barycentric[at].argmax(axis=1)]
        order = np.argsort(mesh.faces, axis=None, kind="stable")
        begins, ends = (
            np.searchsorted(mesh.faces.ravel()[order], vertices, side) for side in ("left", "right")
        )
        self._slots = np.concatenate(
            [np.zeros(0, int), *(order[b:e] for b, e in zip(begins, ends, strict=True))]
        )
        self._owners = np.repeat(at, ends - begins)
        around = corners(mesh)
        self._middles = around.middles.ravel()[self._slots]
        self._angles = around.angles.ravel()[self._slots]

    def turn_downstream(self, vectors: IndexArray, faces: IntArray, weights: FloatArray) -> None:
        """Move each point at a vertex into the adjacent face that the field leads into.

        ``vectors`` (F, 3) are complex vectors at corners, see `downstream_slots`. ``faces`` and
        ``weights`` of the points are updated.
        """
        off = angular_offsets(vectors.ravel()[self._slots], self._middles, self._angles)
        order = np.argsort(-off, kind="stable")
        best = np.full(len(faces), -1)
        best[self._owners[order]] = self._slots[order]  # the last assignment to a point wins
        at = np.flatnonzero(best >= 0)
        faces[at], weights[at] = best[at] // 3, np.eye(3)[best[at] % 3]


@kernel
def product(a: FloatArray, b: FloatArray) -> FloatArray:
    out = np.empty((2, b.shape[1]))
    for i in range(2):
        for j in range(b.shape[1]):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j]
    return out


@kernel
def glide(
    flow: SmoothFlow, f: int, place: FloatArray, way: FloatArray, motion: FloatArray
) -> tuple[int, bool, FloatArray]:
    """Move a point straight by a vector across faces, as `walk_straight`, with derivatives.

    The point slides along boundaries. ``place`` and vector ``way`` (2,), in the local frame of face
    ``f``, are updated to those at the end. ``motion`` (2, 2) becomes the rotation from the first
    frame to the last.

    Return the last face, whether the point slid, and a matrix (4, 4). It has the derivatives of
    place (rows 0, 1) and vector (rows 2, 3) at the end by place and vector at the start.
    """
    gradients, left, entered, slid = flow.gradients, 1.0, -1, False
    x, y, u, v = place[0], place[1], way[0], way[1]
    # derivatives of the unfolded start and of the vector, in the present frame
    base, ahead = np.zeros((2, 4)), np.zeros((2, 4))
    base[0, 0] = base[1, 1] = ahead[0, 2] = ahead[1, 3] = 1.0
    motion[0, 0] = motion[1, 1] = 1.0
    motion[0, 1] = motion[1, 0] = 0.0
    for _ in range(_CROSSINGS):
        edge, used = -1, left
        for i in range(3):
            rate = gradients[f, i, 0] * u + gradients[f, i, 1] * v
            if rate < 0.0 and i != entered:
                weight = gradients[f, i, 0] * x + gradients[f, i, 1] * y + (1.0 if i == 0 else 0.0)
                if weight + rate * used < 0.0:
                    edge, used = i, max(weight, 0.0) / -rate
        x, y = x + used * u, y + used * v
        if edge < 0:
            break
        left -= used
        slot = flow.neighbours[f, edge]
        if slot < 0:
            slid = True
            p, q = gradients[f, edge, 0], gradients[f, edge, 1]
            squared, rate, gone = p * p + q * q, p * u + q * v, 1.0 - left
            along = (p * v - q * u) / squared
            for k in range(4):
                hit = -(p * (base[0, k] + gone * ahead[0, k])) / rate
                hit -= (q * (base[1, k] + gone * ahead[1, k])) / rate
                slower = (p * ahead[1, k] - q * ahead[0, k]) / squared
                base[0, k] += gone * (ahead[0, k] + q * slower) + (u + q * along) * hit
                base[1, k] += gone * (ahead[1, k] - p * slower) + (v - p * along) * hit
                ahead[0, k], ahead[1, k] = -q * slower, p * slower
            u, v, entered = -q * along, p * along, edge
            continue
        c, s = flow.unfolding[f, edge, 0], flow.unfolding[f, edge, 1]
        x, y = (
            c * x - s * y + flow.unfolding[f, edge, 2],
            s * x + c * y + flow.unfolding[f, edge, 3],
        )
        u, v = c * u - s * v, s * u + c * v
        turn = np.array([[c, -s], [s, c]])
        base, ahead = product(turn, base), product(turn, ahead)
        motion[:] = product(turn, motion)
        f, entered = slot // 3, slot % 3
    place[0], place[1], way[0], way[1] = x, y, u, v
    derivative = np.empty((4, 4))
    derivative[:2] = base + ahead
    derivative[2:] = ahead
    return f, slid, derivative


@kernel
def weights_at(flow: SmoothFlow, f: int, place: FloatArray, out: FloatArray) -> None:
    """Write to ``out`` (3,) the barycentric weights of a point in face ``f``.

    ``place`` (2,) has its coordinates in the local frame of the face.
    """
    for c in range(3):
        x, y = flow.gradients[f, c, 0], flow.gradients[f, c, 1]
        out[c] = x * place[0] + y * place[1] + (1.0 if c == 0 else 0.0)


@kernel
def slopes_in(flow: SmoothFlow, f: int) -> FloatArray:
    out = np.empty((2, 2))
    for i in range(2):
        for k in range(2):
            out[i, k] = flow.vectors[f, 1 + k, i]
    return out


@kernel
def follow(
    flow: SmoothFlow, step: float, faces: IndexArray, places: FloatArray, tape: Tape
) -> None:
    """Move points along a field by steps of the midpoint rule, and record the steps in ``tape``.

    ``faces`` and the coordinates ``places`` (L, 2) in their local frames are updated. ``step`` is
    the duration of a step.
    """
    turn, ignored = np.empty((2, 2)), np.empty((2, 2))
    by_halfway, by_seen, by_start = np.empty((2, 2)), np.empty((2, 2)), np.empty((2, 2))
    for i in range(faces.size):
        f, place = faces[i], places[i].copy()
        for k in range(tape.faces.shape[1]):
            u, v = vector_at(flow, f, place[0], place[1])
            middle, seen = place.copy(), np.array([step / 2 * u, step / 2 * v])
            g, slid, half = glide(flow, f, middle, seen, turn)
            r, s = vector_at(flow, g, middle[0], middle[1])
            tape.faces[i, k, 0], tape.faces[i, k, 1] = f, g
            weights_at(flow, f, place, tape.weights[i, k, 0])
            weights_at(flow, g, middle, tape.weights[i, k, 1])
            # derivatives of the step by the vector halfway, by the half step in the frame there,
            # and by the vector at the start
            by_seen[:], by_start[:] = 0.0, 0.0
            squared = 4 * (seen[0] ** 2 + seen[1] ** 2)
            if not slid or squared == 0.0:
                by_halfway[:] = step * turn.T
                way = product(by_halfway, np.array([[r], [s]]))[:, 0].copy()
            else:  # the point slid along the boundary; scale by the ratio of the speeds
                inner = 2 * step * (seen[0] * r + seen[1] * s)
                ratio = max(inner / squared, 0.0)
                way = np.array([ratio * step * u, ratio * step * v])
                by_start[0, 0] = by_start[1, 1] = ratio * step
                by_halfway[:] = 0.0
                if ratio > 0.0:
                    for a in range(2):
                        begun = step * (u if a == 0 else v)
                        for b in range(2):
                            other = r if b == 0 else s
                            by_halfway[a, b] = begun * 2 * step * seen[b] / squared
                            bends = 2 * step * other - 8 * ratio * seen[b]
                            by_seen[a, b] = begun * bends / squared
            along = product(by_halfway, slopes_in(flow, g))
            by_place = product(along, half[:2, :2]) + product(by_seen, half[2:, :2])
            by_way = product(along, half[:2, 2:]) + product(by_seen, half[2:, 2:])
            by_start += step / 2 * by_way
            h, _, full = glide(flow, f, place, way, ignored)
            from_place, from_way = full[:2, :2].copy(), full[:2, 2:].copy()
            of_start = product(from_way, by_start)
            tape.jacobians[i, k, 0] = (
                from_place + product(from_way, by_place) + product(of_start, slopes_in(flow, f))
            )
            tape.jacobians[i, k, 1] = of_start
            tape.jacobians[i, k, 2] = product(from_way, by_halfway)
            f = h
        faces[i], places[i] = f, place


@kernel
def backpropagate(tape: Tape, slopes: FloatArray, at_corners: FloatArray) -> None:
    """Propagate the derivative of an energy from the ends of L flow lines back to their starts.

    ``slopes`` (L, 2) has the derivatives by the ends, and receives those by the starts. The
    derivatives by the field's vectors at corners are added to ``at_corners`` (F, 3, 2).
    """
    count = tape.faces.shape[1]
    for i in range(slopes.shape[0]):
        for back in range(count):
            k = count - 1 - back
            a, b = slopes[i]
            for part in range(2):
                by, f = tape.jacobians[i, k, 1 + part], tape.faces[i, k, part]
                first, second = by[0, 0] * a + by[1, 0] * b, by[0, 1] * a + by[1, 1] * b
                for c in range(3):
                    at_corners[f, c, 0] += tape.weights[i, k, part, c] * first
                    at_corners[f, c, 1] += tape.weights[i, k, part, c] * second
            by = tape.jacobians[i, k, 0]
            slopes[i, 0] = by[0, 0] * a + by[1, 0] * b
            slopes[i, 1] = by[0, 1] * a + by[1, 1] * b
