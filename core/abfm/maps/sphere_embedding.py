"""Surfaces of genus 0 on the unit sphere, with no face turned over and areas changed little.

The surface is collapsed to a tetrahedron and unfolded again, vertex by vertex [PH03]. Each comes
back at a place from which all sides of its ring are seen from inside; there is one, next to the
vertex that it was collapsed to, as that one's faces fill the ring. Then vertices move to where the
symmetric Dirichlet energy [SS15] of their faces is less, but never past a side of their rings: it
is infinite there.

References
----------
Praun, Hoppe: Spherical Parametrization and Remeshing, ACM TOG 22(3), 2003.
Smith, Schaefer: Bijective Parameterization with Free Boundaries, ACM TOG 34(4), 2015.
"""

from typing import NamedTuple

import numpy as np

from abfm.errors import MeshError
from abfm.maps.collapses import Collapses, Surface, collapse, fill_star, next_slot, unfold
from abfm.maps.surface_points import Vector, cross, scalar
from abfm.mesh import TriangleMesh
from abfm.mesh.topology import edge_slots, edges_of_faces, next_corner
from abfm.numerics.kernels import kernel
from abfm.types import FloatArray, IntArray
from abfm.workers.control import checkpoint
from abfm.workers.progress import step

_SWEEPS, _MOVES = 10, 10_000  # after each round: over all vertices, and moves more of few vertices
# what sides are longer by, as shares of their face's mean and of the mean of all: needles and tiny
# faces need not be such on the sphere
_MOLLIFIED, _LEAST = 0.01, 0.001
_SHORTER, _TRIES = 0.4, 12  # steps that do not go down
_CONVEX = 0.01  # least curvature, as a share of the largest
_CLOSER, _CLOSEST = 0.6, 1e-15  # to the vertex that one was collapsed to, where it comes back
_FLAT = 1e-15  # a face's volume, see `_volume`, that rounding may turn over
_AREA = 4 * np.pi
_TOO_THIN = (
    "some faces are so thin or small that rounding folds them on the sphere; expected a mesh of "
    "even faces: remesh it"
)


def sphere_embedding(mesh: TriangleMesh) -> FloatArray:
    """Embed a surface of genus 0 in the unit sphere: unit vectors (V, 3) of its vertices.

    Every face, as its corners' three planes through the centre cut it out, lies on the left of its
    sides, seen from outside, so that faces overlap nowhere, and those of a closed surface cover the
    sphere. Where there are boundaries, these surround what faces leave uncovered. The result is a
    local minimum, nearly, of the symmetric Dirichlet energy; the turn is arbitrary.

    Raises
    ------
    MeshError
        If the surface has handles or pinched vertices, or its faces are too thin for rounding.
    """
    if pinched := int(mesh.is_pinched_vertex.sum()):
        raise MeshError(
            f"a mesh for the sphere has {pinched} pinched vertices; expected none: split or remove "
            "them"
        )
    if mesh.genus:
        raise MeshError(
            f"a mesh for the sphere has genus {mesh.genus}; expected 0, a surface without handles: "
            "cut them off, or close them"
        )
    points, faces = _filled(mesh)
    surface = _surface(faces, len(points))
    with step("embedding in the sphere", len(points)) as done:
        collapses = collapse(points, surface)
        state = _State(points, surface, _tetrahedron(surface, len(points), collapses))
        ends = collapses.rounds
        for start, end in zip(ends[-2::-1], ends[:0:-1], strict=True):
            _unfold_round(state, collapses, start, end)
            done(1 - start / len(points))
    a, b, c = np.moveaxis(state.sphere[faces], 1, 0)
    if not (np.einsum("fx,fx->f", a, np.cross(b - a, c - a)) > 0).all():
        raise MeshError(_TOO_THIN)
    return state.sphere[: len(mesh.vertices)]


def _filled(mesh: TriangleMesh) -> tuple[FloatArray, IntArray]:
    """Close each hole with a fan of faces around its middle: points (V', 3), faces (F', 3)."""
    loops, count = mesh.boundary_loops, len(mesh.vertices)
    points = [mesh.vertices, *(mesh.vertices[loop].mean(axis=0)[None] for loop in loops)]
    middle = np.zeros(count, dtype=np.int64)
    for number, loop in enumerate(loops):
        middle[loop] = count + number
    starts = next_corner(mesh.edge_slots[mesh.is_boundary_edge, 0])
    first, last = mesh.faces.ravel()[starts], mesh.faces.ravel()[next_corner(starts)]
    fans = np.stack([last, first, middle[first]], axis=1)
    return np.concatenate(points), np.concatenate([mesh.faces, fans])


def _surface(faces: IntArray, count: int) -> Surface:
    edges, face_edges = edges_of_faces(faces, count)
    slots, corners = edge_slots(face_edges, len(edges)), faces.ravel().copy()
    twins, corner_of = np.empty_like(corners), np.empty(count, dtype=np.int64)
    twins[slots] = slots[:, ::-1]
    corner_of[corners] = np.arange(len(corners))
    return Surface(corners, twins, corner_of)


def _tetrahedron(surface: Surface, count: int, collapses: Collapses) -> FloatArray:
    """Place the vertices that are left on a regular tetrahedron, (V, 3), 0 at the others."""
    left = np.setdiff1d(np.arange(count), collapses.vertices)
    corner = surface.corner_of[left[0]]
    face = surface.faces[[corner, next_slot(corner), next_slot(next_slot(corner))]]
    sphere = np.zeros((count, 3))
    sphere[[*face, *np.setdiff1d(left, face)]] = np.array(
        [[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]
    ) / np.sqrt(3)
    return sphere


class _State(NamedTuple):
    points: FloatArray  # (V, 3), in space
    surface: Surface
    sphere: FloatArray  # (V, 3)


class _Room(NamedTuple):
    """Room for what is around a vertex."""

    star: IntArray  # its corners
    shapes: FloatArray  # of their faces, each four numbers, see `_shape`


def _unfold_round(whole: _State, collapses: Collapses, start: int, end: int) -> None:
    points, surface, sphere = whole
    count = len(points)
    room = _Room(np.empty(count, dtype=np.int64), np.empty((count, 4)))
    alive = np.setdiff1d(np.arange(count), collapses.vertices[:end])
    state = _State(points * np.sqrt(_AREA / _area(whole, alive, room)), surface, sphere)
    if not _put_back(state, collapses.vertices[start:end], collapses.slots[start:end], room):
        raise MeshError(_TOO_THIN)
    alive = np.setdiff1d(np.arange(count), collapses.vertices[:start])
    state = _State(points * np.sqrt(_AREA / _area(whole, alive, room)), surface, sphere)
    for _ in range(_SWEEPS + _MOVES // len(alive)):
        checkpoint()
        _sweep(state, alive, room)


@kernel
def _area(state: _State, alive: IntArray, room: _Room) -> float:
    """Return the area in space of the faces at vertices."""
    points, (faces, twins, corner_of), _ = state
    total = 0.0
    for v in alive:
        for corner in room.star[: fill_star(room.star, twins, corner_of[v])]:
            b, c = faces[next_slot(corner)], faces[next_slot(next_slot(corner))]
            if v < b and v < c:
                total += _shape(points[v], points[b], points[c])[3]
    return total


@kernel
def _sweep(state: _State, alive: IntArray, room: _Room) -> None:
    for v in alive:
        _move(state, v, 1, room)


@kernel
def _put_back(state: _State, vertices: IntArray, slots: IntArray, room: _Room) -> bool:
    """Put vertices back, the last first, each with a few steps of itself and of its neighbours;
    return whether there was place for all.
    """
    surface = state.surface
    around = np.empty_like(room.star)
    for i in range(vertices.size - 1, -1, -1):
        v, kept = vertices[i], surface.faces[next_slot(slots[i])]
        size = unfold(surface, v, slots[i], room.star)
        around[:size] = room.star[:size]
        if not _place(state, v, kept, around[:size]):
            return False
        _move(state, v, 3, room)
        for corner in around[:size]:
            _move(state, surface.faces[next_slot(corner)], 1, room)
        _move(state, v, 1, room)
    return True


@kernel
def _place(state: _State, v: int, kept: int, star: IntArray) -> bool:
    """Place a vertex where its faces look outward: in the middle of its neighbours, or near the one
    that it was collapsed to, whose two sides of the ring look in the direction between their
    normals; return whether rounding lets it.
    """
    faces, sphere = state.surface.faces, state.sphere
    place, inward, normal = np.zeros(3), np.zeros(3), np.empty(3)
    for corner in star:
        b, c = faces[next_slot(corner)], faces[next_slot(next_slot(corner))]
        place += sphere[b]
        if kept in (b, c):
            normal[:] = cross(sphere[b], difference(sphere[c], sphere[b]))
            inward += normal / np.sqrt(scalar(normal, normal))
    length = 1.0
    while length > _CLOSEST:
        sphere[v] = place / np.sqrt(scalar(place, place))
        if _is_outward(state, star, sphere[v]):
            return True
        place[:] = sphere[kept] + length * inward
        length *= _CLOSER
    return False


@kernel
def _is_outward(state: _State, star: IntArray, place: FloatArray) -> bool:
    faces, sphere = state.surface.faces, state.sphere
    for corner in star:
        b, c = faces[next_slot(corner)], faces[next_slot(next_slot(corner))]
        if not _volume(place, sphere[b], sphere[c]) > _FLAT:
            return False
    return True


@kernel
def _volume(a: FloatArray, b: FloatArray, c: FloatArray) -> float:
    """Return six times the volume of a tetrahedron with the centre: of a small face, twice its
    area.
    """
    return scalar(a, cross(difference(b, a), difference(c, a)))


@kernel
def _move(state: _State, v: int, steps: int, room: _Room) -> None:
    """Take Newton steps of a vertex toward the least energy of its faces."""
    points, (faces, twins, corner_of), sphere = state
    size = fill_star(room.star, twins, corner_of[v])
    star = room.star[:size]
    for k in range(size):
        b, c = faces[next_slot(star[k])], faces[next_slot(next_slot(star[k]))]
        room.shapes[k] = _shape(points[v], points[b], points[c])
    around = _Room(star, room.shapes[:size])
    place, axes = sphere[v].copy(), np.empty((2, 3))
    for _ in range(steps):
        _tangents(place, axes)
        energy, along, across = _newton(state, place, axes, around)
        for _ in range(_TRIES):
            moved = place + along * axes[0] + across * axes[1]
            moved /= np.sqrt(scalar(moved, moved))
            if _energy(state, moved, around) < energy:
                place[:] = moved
                break
            along *= _SHORTER
            across *= _SHORTER
        else:
            break
    sphere[v] = place


@kernel
def difference(a: FloatArray, b: FloatArray) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@kernel
def _tangents(place: FloatArray, axes: FloatArray) -> None:
    """Compute two unit vectors perpendicular to a third and to each other."""
    least = np.argmin(np.abs(place))
    axes[0] = -place[least] * place
    axes[0, least] += 1.0
    axes[0] /= np.sqrt(scalar(axes[0], axes[0]))
    axes[1] = cross(place, axes[0])


@kernel
def _shape(a: FloatArray, b: FloatArray, c: FloatArray) -> tuple[float, float, float, float]:
    """Return half the cotangents of a face's angles, and its area, its sides somewhat longer."""
    p, q, r = difference(b, c), difference(c, a), difference(a, b)
    first, second, third = np.sqrt(scalar(p, p)), np.sqrt(scalar(q, q)), np.sqrt(scalar(r, r))
    more = _MOLLIFIED * (first + second + third) / 3
    u, v, w = (first + more) ** 2, (second + more) ** 2, (third + more) ** 2
    area = 0.25 * np.sqrt(4 * u * v - (u + v - w) ** 2)
    return (v + w - u) / (8 * area), (w + u - v) / (8 * area), (u + v - w) / (8 * area), area


@kernel
def _energy(state: _State, place: FloatArray, around: _Room) -> float:
    """Return the symmetric Dirichlet energy of the faces at a vertex at some place, ``area (s_1^2 +
    s_2^2 + s_1^-2 + s_2^-2)`` with the stretches of each; infinite if one does not look outward.
    """
    faces, sphere, total = state.surface.faces, state.sphere, 0.0
    for k in range(around.star.size):
        after = next_slot(around.star[k])
        b, c = sphere[faces[after]], sphere[faces[next_slot(after)]]
        volume = _volume(place, b, c)
        if not volume > _FLAT:
            return np.inf
        at_place, at_b, at_c, area = around.shapes[k]
        p, q, r = difference(b, c), difference(c, place), difference(place, b)
        dirichlet = at_place * scalar(p, p) + at_b * scalar(q, q) + at_c * scalar(r, r)
        total += dirichlet * (1 + (2 * area / volume) ** 2)
    return total


@kernel
def _newton(
    state: _State, place: FloatArray, axes: FloatArray, around: _Room
) -> tuple[float, float, float]:
    """Return the energy of `_energy` and the step along two axes to the minimum of its quadratic
    model on the sphere, made convex.
    """
    faces, sphere = state.surface.faces, state.sphere
    energy = first = second = h11 = h12 = h22 = 0.0
    for k in range(around.star.size):
        after = next_slot(around.star[k])
        b, c = sphere[faces[after]], sphere[faces[next_slot(after)]]
        at_place, at_b, at_c, area = around.shapes[k]
        p, q, r = difference(b, c), difference(c, place), difference(place, b)
        dirichlet = at_place * scalar(p, p) + at_b * scalar(q, q) + at_c * scalar(r, r)
        volume, normal = _volume(place, b, c), cross(b, c)
        inverse = (2 * area / volume) ** 2
        energy += dirichlet * (1 + inverse)
        # derivatives of the Dirichlet energy and of the logarithm of the volume
        d1 = 2 * (at_c * scalar(axes[0], r) - at_b * scalar(axes[0], q))
        d2 = 2 * (at_c * scalar(axes[1], r) - at_b * scalar(axes[1], q))
        v1, v2 = scalar(axes[0], normal) / volume, scalar(axes[1], normal) / volume
        first += d1 * (1 + inverse) - 2 * dirichlet * inverse * v1
        second += d2 * (1 + inverse) - 2 * dirichlet * inverse * v2
        outward = 2 * (at_c * scalar(place, r) - at_b * scalar(place, q))
        radial = outward * (1 + inverse) - 2 * dirichlet * inverse
        same = 2 * (at_b + at_c) * (1 + inverse) - radial
        h11 += same - 4 * inverse * d1 * v1 + 6 * dirichlet * inverse * v1 * v1
        h22 += same - 4 * inverse * d2 * v2 + 6 * dirichlet * inverse * v2 * v2
        h12 += -2 * inverse * (d1 * v2 + d2 * v1) + 6 * dirichlet * inverse * v1 * v2
    middle, gap = (h11 + h22) / 2, np.hypot((h11 - h22) / 2, h12)
    more = max(0.0, _CONVEX * (abs(middle) + gap) - (middle - gap))
    h11 += more
    h22 += more
    determinant = h11 * h22 - h12 * h12
    along = (h12 * second - h22 * first) / determinant
    return energy, along, (h12 * first - h11 * second) / determinant
