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

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from abfm.errors import MeshError
from abfm.maps.collapses import Collapses, Surface, collapse, unfold
from abfm.maps.star_moves import (
    FLAT_VOLUME,
    STEP_FACTOR,
    STEP_TRIES,
    Workspace,
    add_product,
    allocate_workspace,
    difference,
    normalize,
    set_tangents,
    shape,
    step_to_minimum,
    volume,
)
from abfm.maps.surface_points import cross, scalar
from abfm.mesh import TriangleMesh
from abfm.mesh.coarsening import fill_star, next_slot
from abfm.mesh.topology import edge_slots, edges_of_faces, next_corner
from abfm.numerics.kernels import unfused_kernel
from abfm.types import FloatArray, IntArray
from abfm.workers.control import checkpoint
from abfm.workers.progress import step

# after each round: over all vertices, and moves more of few vertices
_SWEEPS = 10
_MOVES = 10_000
# to the vertex that one was collapsed to, where it comes back
_STEP_FACTOR = 0.6
_STEP_MIN = 1e-15
_AREA = 4 * np.pi
_THIN_FACES_MESSAGE = (
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
    return embed(*filled(mesh))[: len(mesh.vertices)]


def embed(points: FloatArray, faces: IntArray) -> FloatArray:
    """Return the `sphere_embedding` of a closed surface of genus 0."""
    with step("embedding in the sphere", len(points)) as done:
        for state, alive in unfolding(points, faces):
            done(len(alive) / len(points))
            sphere = state.sphere
    check_embedded(sphere, faces)
    return sphere


def check_embedded(sphere: FloatArray, faces: IntArray) -> None:
    """Raise a MeshError if faces do not look outward."""
    a, b, c = np.moveaxis(sphere[faces], 1, 0)
    if not (np.einsum("fx,fx->f", a, np.cross(b - a, c - a)) > 0).all():
        raise MeshError(_THIN_FACES_MESSAGE)


def filled(mesh: TriangleMesh) -> tuple[FloatArray, IntArray]:
    """Close each hole of a surface of genus 0 with a fan of faces around its middle, or raise a
    MeshError: points (V', 3), the first ones the vertices, and faces (F', 3).
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
    loops, count = mesh.boundary_loops, len(mesh.vertices)
    points = [mesh.vertices, *(mesh.vertices[loop].mean(axis=0)[None] for loop in loops)]
    middle = np.zeros(count, dtype=np.int64)
    for number, loop in enumerate(loops):
        middle[loop] = count + number
    starts = next_corner(mesh.edge_slots[mesh.is_boundary_edge, 0])
    first, last = mesh.faces.ravel()[starts], mesh.faces.ravel()[next_corner(starts)]
    fans = np.stack([last, first, middle[first]], axis=1)
    return np.concatenate(points), np.concatenate([mesh.faces, fans])


def surface_of(faces: IntArray, count: int) -> Surface:
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


class Embedding(NamedTuple):
    """A surface on its way to the sphere."""

    points: FloatArray  # (V, 3), in space
    surface: Surface
    sphere: FloatArray  # (V, 3), unit vectors


def unfolding(points: FloatArray, faces: IntArray) -> Iterator[tuple[Embedding, IntArray]]:
    """Embed a closed surface (V, 3) of genus 0: give, from the tetrahedron on, after every round,
    the same arrays as they are then, in space with the sphere's area, and the vertices that are
    there. They may be moved meanwhile, if no face turns over.
    """
    count, surface = len(points), surface_of(faces, len(points))
    collapses, workspace = collapse(points, surface), allocate_workspace(count)
    whole = Embedding(points, surface, _tetrahedron(surface, count, collapses))
    ends = collapses.rounds
    alive = np.setdiff1d(np.arange(count), collapses.vertices)
    state = _scaled(whole, alive, workspace)
    yield state, alive
    for start, end in zip(ends[-2::-1], ends[:0:-1], strict=True):
        checkpoint()
        if not _put_back(
            state, collapses.vertices[start:end], collapses.slots[start:end], workspace
        ):
            raise MeshError(_THIN_FACES_MESSAGE)
        alive = np.setdiff1d(np.arange(count), collapses.vertices[:start])
        state = _scaled(whole, alive, workspace)
        for _ in range(_SWEEPS + _MOVES // len(alive)):
            checkpoint()
            sweep(state, alive, workspace)
        yield state, alive


def _scaled(state: Embedding, alive: IntArray, workspace: Workspace) -> Embedding:
    return state._replace(points=state.points * np.sqrt(_AREA / _area_at(state, alive, workspace)))


@unfused_kernel
def _area_at(state: Embedding, alive: IntArray, workspace: Workspace) -> float:
    """Return the area in space of the faces at vertices."""
    points, (faces, twins, corner_of), _ = state
    total = 0.0
    for v in alive:
        for corner in workspace.star[: fill_star(workspace.star, twins, corner_of[v])]:
            b, c = faces[next_slot(corner)], faces[next_slot(next_slot(corner))]
            if v < b and v < c:
                total += shape(points[v], points[b], points[c])[3]
    return total


@unfused_kernel
def sweep(state: Embedding, alive: IntArray, workspace: Workspace) -> None:
    """Move each of some vertices by one step."""
    for v in alive:
        _move(state, v, 1, workspace)


@unfused_kernel
def _put_back(state: Embedding, vertices: IntArray, slots: IntArray, workspace: Workspace) -> bool:
    """Put vertices back, the last first, each with a few steps of itself and of its neighbours;
    return whether there was place for all.
    """
    surface = state.surface
    around = np.empty_like(workspace.star)
    for i in range(vertices.size - 1, -1, -1):
        v, kept = vertices[i], surface.faces[next_slot(slots[i])]
        size = unfold(surface, v, slots[i], workspace.star)
        around[:size] = workspace.star[:size]
        if not _place(state, v, kept, around[:size]):
            return False
        _move(state, v, 3, workspace)
        for corner in around[:size]:
            _move(state, surface.faces[next_slot(corner)], 1, workspace)
        _move(state, v, 1, workspace)
    return True


@unfused_kernel
def _place(state: Embedding, v: int, kept: int, star: IntArray) -> bool:
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
    while length > _STEP_MIN:
        sphere[v] = place / np.sqrt(scalar(place, place))
        if is_outward(state, star, sphere[v]):
            return True
        place[:] = sphere[kept] + length * inward
        length *= _STEP_FACTOR
    return False


@unfused_kernel
def is_outward(state: Embedding, star: IntArray, place: FloatArray) -> bool:
    faces, sphere = state.surface.faces, state.sphere
    for corner in star:
        b, c = faces[next_slot(corner)], faces[next_slot(next_slot(corner))]
        if not volume(place, sphere[b], sphere[c]) > FLAT_VOLUME:
            return False
    return True


@unfused_kernel
def set_shapes(state: Embedding, v: int, workspace: Workspace) -> int:
    """Find the corners at a vertex and the shapes of their faces; return how many there are."""
    points, (faces, twins, corner_of), _ = state
    size = fill_star(workspace.star, twins, corner_of[v])
    for k in range(size):
        b, c = faces[next_slot(workspace.star[k])], faces[next_slot(next_slot(workspace.star[k]))]
        workspace.shapes[k] = shape(points[v], points[b], points[c])
    return size


@unfused_kernel
def _move(state: Embedding, v: int, steps: int, workspace: Workspace) -> None:
    """Take Newton steps of a vertex toward the least energy of its faces."""
    size, place, axes = set_shapes(state, v, workspace), state.sphere[v].copy(), workspace.axes
    for _ in range(steps):
        set_tangents(place, axes)
        _set_model(state, place, size, workspace)
        along, across = step_to_minimum(workspace.model)
        energy = _energy(state, place, size, workspace)
        for _ in range(STEP_TRIES):
            moved = place + along * axes[0] + across * axes[1]
            normalize(moved)
            if _energy(state, moved, size, workspace) < energy:
                place[:] = moved
                break
            along *= STEP_FACTOR
            across *= STEP_FACTOR
        else:
            break
    state.sphere[v] = place


@unfused_kernel
def _energy(state: Embedding, place: FloatArray, size: int, workspace: Workspace) -> float:
    """Return the symmetric Dirichlet energy of the faces at a vertex at some place, ``area (s_1^2 +
    s_2^2 + s_1^-2 + s_2^-2)`` with the stretches of each; infinite if one does not look outward.
    """
    faces, sphere, total = state.surface.faces, state.sphere, 0.0
    for k in range(size):
        after = next_slot(workspace.star[k])
        b, c = sphere[faces[after]], sphere[faces[next_slot(after)]]
        covered = volume(place, b, c)
        if not covered > FLAT_VOLUME:
            return np.inf
        at_place, at_b, at_c, area = workspace.shapes[k]
        p, q, r = difference(b, c), difference(c, place), difference(place, b)
        dirichlet = at_place * scalar(p, p) + at_b * scalar(q, q) + at_c * scalar(r, r)
        total += dirichlet * (1 + (2 * area / covered) ** 2)
    return total


@unfused_kernel
def _set_model(state: Embedding, place: FloatArray, size: int, workspace: Workspace) -> None:
    """Compute the derivatives of the energy along two axes, on the sphere."""
    faces, sphere, (first, second) = state.surface.faces, state.sphere, workspace.axes
    workspace.model[:] = 0.0
    for k in range(size):
        after = next_slot(workspace.star[k])
        b, c = sphere[faces[after]], sphere[faces[next_slot(after)]]
        at_place, at_b, at_c, area = workspace.shapes[k]
        p, q, r = difference(b, c), difference(c, place), difference(place, b)
        dirichlet = at_place * scalar(p, p) + at_b * scalar(q, q) + at_c * scalar(r, r)
        d1 = 2 * (at_c * scalar(first, r) - at_b * scalar(first, q))
        d2 = 2 * (at_c * scalar(second, r) - at_b * scalar(second, q))
        covered, normal = volume(place, b, c), cross(b, c)
        slopes = scalar(first, normal) / covered, scalar(second, normal) / covered
        inverse = (2 * area / covered) ** 2
        # what the sphere's bend takes from second derivatives
        outward = 2 * (at_c * scalar(place, r) - at_b * scalar(place, q)) * (1 + inverse)
        bend = (2 * dirichlet * inverse - outward) / (1 + inverse)
        curvature = 2 * (at_b + at_c) + bend
        phi = 1 + inverse, -2 * inverse, 6 * inverse
        add_product(workspace.model, (dirichlet, d1, d2), (curvature, 0.0, curvature), slopes, phi)
