"""Embeddings of surfaces of genus 0 in the unit sphere, without flipped faces.

The surface is collapsed to a tetrahedron and unfolded again, vertex by vertex [PH03]. The ring of a
vertex is the polygon of its neighbours. A vertex is inserted at a position from which all sides of
its ring are visible from inside. There is such a position next to the vertex into which it was
collapsed, because the faces of that vertex fill the ring. Then vertices move to reduce the
symmetric Dirichlet energy [SS15] of their faces, which also limits changes of area. They never
cross a side of their rings, where the energy is infinite.

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

_SWEEPS = 10  # sweeps over all vertices after each round
_MOVES = 10_000  # additional moves of vertices after each round
# steps of an inserted vertex toward the vertex that it was collapsed to
_STEP_FACTOR = 0.6
_STEP_MIN = 1e-15
_AREA = 4 * np.pi
_THIN_FACES_MESSAGE = (
    "some faces are so thin or small that rounding folds them on the sphere; expected a mesh with "
    "faces of similar size. Remesh the surface"
)


def sphere_embedding(mesh: TriangleMesh) -> FloatArray:
    """Embed a surface of genus 0 in the unit sphere and return unit vectors (V, 3).

    The faces become spherical triangles, which do not overlap and have the orientation of the
    surface, seen from outside. The faces of a closed surface cover the sphere. Boundaries surround
    the parts that are not covered. The result is close to a local minimum of the symmetric
    Dirichlet energy; its rotation is arbitrary.

    Raises
    ------
    MeshError
        If the surface has handles or pinched vertices, or if rounding folds thin faces.
    """
    return embed(*close_holes(mesh))[: len(mesh.vertices)]


def embed(points: FloatArray, faces: IntArray) -> FloatArray:
    """Return the `sphere_embedding` of a closed surface of genus 0."""
    with step("embedding in the sphere", len(points)) as done:
        for state, active in unfolding(points, faces):
            done(len(active) / len(points))
            sphere = state.sphere
    check_embedded(sphere, faces)
    return sphere


def check_embedded(sphere: FloatArray, faces: IntArray) -> None:
    a, b, c = np.moveaxis(sphere[faces], 1, 0)
    if not (np.einsum("fx,fx->f", a, np.cross(b - a, c - a)) > 0).all():
        raise MeshError(_THIN_FACES_MESSAGE)


def close_holes(mesh: TriangleMesh) -> tuple[FloatArray, IntArray]:
    """Close each hole of a surface of genus 0 with a fan of faces around a new vertex.

    Return points (V', 3), which begin with the vertices of the mesh, and faces (F', 3). Raises
    MeshError if the surface has handles or pinched vertices.
    """
    if pinched := int(mesh.is_pinched_vertex.sum()):
        raise MeshError(
            f"the mesh has pinched vertices (number: {pinched}), which join parts that share no "
            "edge. Split or remove them to embed the mesh in the sphere"
        )
    if mesh.genus:
        raise MeshError(
            f"the mesh has genus {mesh.genus}; an embedding in the sphere needs genus 0, a surface "
            "without handles. Cut or close the handles"
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


def build_surface(faces: IntArray, count: int) -> Surface:
    edges, face_edges = edges_of_faces(faces, count)
    slots, corners = edge_slots(face_edges, len(edges)), faces.ravel().copy()
    twins, corner_of = np.empty_like(corners), np.empty(count, dtype=np.int64)
    twins[slots] = slots[:, ::-1]
    corner_of[corners] = np.arange(len(corners))
    return Surface(corners, twins, corner_of)


def _tetrahedron(surface: Surface, count: int, collapses: Collapses) -> FloatArray:
    """Return the positions (V, 3) of vertices on the sphere after all collapses.

    The four remaining vertices form a regular tetrahedron; all others are at 0.
    """
    remaining = np.setdiff1d(np.arange(count), collapses.vertices)
    corner = surface.corner_of[remaining[0]]
    face = surface.faces[[corner, next_slot(corner), next_slot(next_slot(corner))]]
    sphere = np.zeros((count, 3))
    sphere[[*face, *np.setdiff1d(remaining, face)]] = np.array(
        [[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]
    ) / np.sqrt(3)
    return sphere


class Embedding(NamedTuple):
    """A surface that is being embedded in the sphere."""

    points: FloatArray  # (V, 3), in space
    surface: Surface
    sphere: FloatArray  # (V, 3), unit vectors


def unfolding(points: FloatArray, faces: IntArray) -> Iterator[tuple[Embedding, IntArray]]:
    """Embed a closed surface of genus 0 with vertices (V, 3); yield the state after every round.

    A state has the `Embedding`, with points scaled to the sphere's area, and the indices of the
    vertices on the sphere so far. The first state is the tetrahedron. All states share their
    arrays. Between rounds the caller may move vertices on the sphere if no face is flipped.
    """
    count, surface = len(points), build_surface(faces, len(points))
    collapses, workspace = collapse(points, surface), allocate_workspace(count)
    full = Embedding(points, surface, _tetrahedron(surface, count, collapses))
    ends = collapses.rounds
    active = np.setdiff1d(np.arange(count), collapses.vertices)
    state = _scaled(full, active, workspace)
    yield state, active
    for start, end in zip(ends[-2::-1], ends[:0:-1], strict=True):
        checkpoint()
        if not _insert_vertices(
            state, collapses.vertices[start:end], collapses.slots[start:end], workspace
        ):
            raise MeshError(_THIN_FACES_MESSAGE)
        active = np.setdiff1d(np.arange(count), collapses.vertices[:start])
        state = _scaled(full, active, workspace)
        for _ in range(_SWEEPS + _MOVES // len(active)):
            checkpoint()
            sweep(state, active, workspace)
        yield state, active


def _scaled(state: Embedding, active: IntArray, workspace: Workspace) -> Embedding:
    return state._replace(points=state.points * np.sqrt(_AREA / _area_at(state, active, workspace)))


@unfused_kernel
def _area_at(state: Embedding, active: IntArray, workspace: Workspace) -> float:
    """Return the area in space of the faces between active vertices."""
    points, (faces, twins, corner_of), _ = state
    total = 0.0
    for v in active:
        for corner in workspace.star[: fill_star(workspace.star, twins, corner_of[v])]:
            b, c = faces[next_slot(corner)], faces[next_slot(next_slot(corner))]
            if v < b and v < c:
                total += shape(points[v], points[b], points[c])[3]
    return total


@unfused_kernel
def sweep(state: Embedding, active: IntArray, workspace: Workspace) -> None:
    for v in active:
        _move(state, v, 1, workspace)


@unfused_kernel
def _insert_vertices(
    state: Embedding, vertices: IntArray, slots: IntArray, workspace: Workspace
) -> bool:
    """Insert vertices in the reverse order of their removal, and move each one and its neighbours.

    Return False if rounding errors exclude all positions of a vertex.
    """
    surface = state.surface
    around = np.empty_like(workspace.star)
    for i in range(vertices.size - 1, -1, -1):
        v, anchor = vertices[i], surface.faces[next_slot(slots[i])]
        size = unfold(surface, v, slots[i], workspace.star)
        around[:size] = workspace.star[:size]
        if not _place_vertex(state, v, anchor, around[:size]):
            return False
        _move(state, v, 3, workspace)
        for corner in around[:size]:
            _move(state, surface.faces[next_slot(corner)], 1, workspace)
        _move(state, v, 1, workspace)
    return True


@unfused_kernel
def _place_vertex(state: Embedding, v: int, anchor: int, star: IntArray) -> bool:
    """Place a vertex at a position where none of its faces is flipped.

    The first candidate is the mean of its neighbours. Other candidates are near ``anchor``, the
    vertex into which it was collapsed. Their direction is the sum of the normals of the anchor's
    two sides of the ring. Return False if rounding errors exclude all candidates.
    """
    faces, sphere = state.surface.faces, state.sphere
    place, inward, normal = np.zeros(3), np.zeros(3), np.empty(3)
    for corner in star:
        b, c = faces[next_slot(corner)], faces[next_slot(next_slot(corner))]
        place += sphere[b]
        if anchor in (b, c):
            normal[:] = cross(sphere[b], difference(sphere[c], sphere[b]))
            inward += normal / np.sqrt(scalar(normal, normal))
    length = 1.0
    while length > _STEP_MIN:
        sphere[v] = place / np.sqrt(scalar(place, place))
        if is_outward(state, star, sphere[v]):
            return True
        place[:] = sphere[anchor] + length * inward
        length *= _STEP_FACTOR
    return False


@unfused_kernel
def is_outward(state: Embedding, star: IntArray, place: FloatArray) -> bool:
    """Return whether no face with a corner in ``star`` flips if its vertex moves to ``place``."""
    faces, sphere = state.surface.faces, state.sphere
    for corner in star:
        b, c = faces[next_slot(corner)], faces[next_slot(next_slot(corner))]
        if not volume(place, sphere[b], sphere[c]) > FLAT_VOLUME:
            return False
    return True


@unfused_kernel
def set_shapes(state: Embedding, v: int, workspace: Workspace) -> int:
    """Write the corners at a vertex, and the shapes of their faces; return the count of corners."""
    points, (faces, twins, corner_of), _ = state
    size = fill_star(workspace.star, twins, corner_of[v])
    for k in range(size):
        b, c = faces[next_slot(workspace.star[k])], faces[next_slot(next_slot(workspace.star[k]))]
        workspace.shapes[k] = shape(points[v], points[b], points[c])
    return size


@unfused_kernel
def _move(state: Embedding, v: int, steps: int, workspace: Workspace) -> None:
    """Move a vertex by up to ``steps`` Newton steps that reduce the energy of its faces."""
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
    """Return the symmetric Dirichlet energy of the faces at a vertex if it moves to ``place``.

    The energy of a face with stretches s_1 and s_2 is ``area (s_1^2 + s_2^2 + s_1^-2 + s_2^-2)``.
    It is infinite for a flipped face.
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
    """Compute the derivatives of the energy of the faces at a vertex along two tangent axes."""
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
        # the curvature of the sphere changes the second derivatives
        outward = 2 * (at_c * scalar(place, r) - at_b * scalar(place, q)) * (1 + inverse)
        bend = (2 * dirichlet * inverse - outward) / (1 + inverse)
        curvature = 2 * (at_b + at_c) + bend
        phi = 1 + inverse, -2 * inverse, 6 * inverse
        add_product(workspace.model, (dirichlet, d1, d2), (curvature, 0.0, curvature), slopes, phi)
