"""Moves of the image of surface B on surface A that reduce distortion and distances from targets.

Both surfaces are laid out on the same sphere. The image of a vertex of B is the point of A in the
same direction. No face of B is flipped on the sphere. The energy of a face of B has two parts. One
is the symmetric Dirichlet energy of the triangle between the images of its corners in space. The
other is a small multiple of its conformal energy on the sphere, which is infinite for flipped
faces.
"""

from typing import NamedTuple

import numpy as np

from abfm.maps.sphere_embedding import Embedding, is_outward, set_shapes
from abfm.maps.spherical import Faces, side_volumes, walk
from abfm.maps.star_moves import (
    STEP_FACTOR,
    STEP_TRIES,
    Workspace,
    add_product,
    difference,
    normalize,
    set_tangents,
    step_to_minimum,
    volume,
)
from abfm.maps.surface_points import cross, scalar
from abfm.mesh.coarsening import next_slot
from abfm.numerics.kernels import unfused_kernel
from abfm.types import FloatArray, IntArray

_CONFORMAL_WEIGHT = 0.02  # weight of the conformal energy on the sphere
_GUARD = 1e-300  # a small number that prevents division by 0


class Codomain(NamedTuple):
    """The closed surface A: its layout on the sphere, and its vertices in space."""

    layout: Faces
    points: FloatArray  # (V, 3), in space


class Image(NamedTuple):
    """The image of surface B on surface A, and the target positions of its vertices."""

    state: Embedding
    codomain: Codomain
    faces: IntArray  # (V_B,), faces of A with the images of B's vertices
    places: FloatArray  # (V_B, 3), positions of these images in space
    targets: FloatArray  # (V_B, 3), target positions
    weights: FloatArray  # (V_B,), weights of squared distances from the targets


@unfused_kernel
def relocate(image: Image) -> None:
    """Compute the images on A of all vertices of B from their directions on the sphere."""
    for v in range(image.faces.size):
        image.faces[v] = _locate(
            image.codomain, image.state.sphere[v], image.faces[v], image.places[v]
        )


@unfused_kernel
def _locate(codomain: Codomain, direction: FloatArray, face: int, place: FloatArray) -> int:
    """Return the face of A in a direction, and write the point there to ``place`` (3,).

    The search begins at ``face``.
    """
    found, weights = np.array([face]), np.empty((1, 3))
    walk(codomain.layout, direction.reshape(1, 3), found, weights)
    place[:] = 0.0
    for k in range(3):
        place += weights[0, k] * codomain.points[codomain.layout.corners[found[0], k]]
    return int(found[0])


@unfused_kernel
def push_to_sphere(image: Image, moves: FloatArray, workspace: Workspace) -> None:
    """Convert moves (V, 3) of images in space to moves of the vertices of B on the sphere."""
    slopes = np.empty((2, 3))
    for v in range(image.faces.size):
        _set_frame(image, v, workspace.axes, slopes)
        along, across = scalar(moves[v], workspace.axes[0]), scalar(moves[v], workspace.axes[1])
        moves[v] = along * slopes[0] + across * slopes[1]


@unfused_kernel
def _set_frame(image: Image, v: int, axes: FloatArray, slopes: FloatArray) -> None:
    """Compute two ``axes`` in the face of A that contains the image of vertex ``v`` of B.

    Write to ``slopes`` the velocities of the vertex on the sphere if its image moves along them.
    """
    (layout, points), direction = image.codomain, image.state.sphere[v]
    corners = layout.corners[image.faces[v]]
    p, s = points[corners], layout.directions[corners]
    first, second, normal = difference(p[1], p[0]), difference(p[2], p[0]), np.empty(3)
    normal[:] = cross(first, second)
    square = scalar(normal, normal)
    set_tangents(normal / np.sqrt(square), axes)
    weights = np.empty(3)
    side_volumes(layout, direction, image.faces[v], weights)
    weights /= weights.sum()
    chord = weights[0] * s[0] + weights[1] * s[1] + weights[2] * s[2]
    for k in range(2):
        to_second = scalar(cross(axes[k], second), normal) / square
        to_third = scalar(cross(first, axes[k]), normal) / square
        slopes[k] = to_second * (s[1] - s[0]) + to_third * (s[2] - s[0])
        slopes[k] /= np.sqrt(scalar(chord, chord))
        slopes[k] -= scalar(slopes[k], direction) * direction


@unfused_kernel
def relax(image: Image, workspace: Workspace) -> None:
    """Move each vertex of B by a Newton step that reduces the energy of the faces around it."""
    slopes, place = np.empty((2, 3)), np.empty(3)
    for v in range(image.faces.size):
        size = set_shapes(image.state, v, workspace)
        around = Workspace(
            workspace.star[:size], workspace.shapes[:size], workspace.axes, workspace.model
        )
        _set_frame(image, v, workspace.axes, slopes)
        _set_model(image, v, slopes, around)
        along, across = step_to_minimum(workspace.model)
        sphere = image.state.sphere
        energy = _energy(image, v, sphere[v], image.places[v], around)
        for _ in range(STEP_TRIES):
            moved = sphere[v] + along * slopes[0] + across * slopes[1]
            normalize(moved)
            if is_outward(image.state, around.star, moved):
                face = _locate(image.codomain, moved, image.faces[v], place)
                if _energy(image, v, moved, place, around) < energy:
                    sphere[v], image.places[v], image.faces[v] = moved, place, face
                    break
            along *= STEP_FACTOR
            across *= STEP_FACTOR


@unfused_kernel
def _energy(
    image: Image, v: int, direction: FloatArray, place: FloatArray, around: Workspace
) -> float:
    """Return the energy of the faces around a vertex of B if it moves to a given direction.

    ``place`` is the image of the vertex there; its distance from the target adds to the energy.
    """
    (_, surface, sphere), places = image.state, image.places
    total: float = 0.0
    for k in range(around.star.size):
        after = next_slot(around.star[k])
        b, c = surface.faces[after], surface.faces[next_slot(after)]
        _, _, _, area = around.shapes[k]
        dirichlet, normal = _dirichlet(around.shapes[k], place, places[b], places[c])
        total += 0.25 * dirichlet * (1 + (2 * area) ** 2 / (scalar(normal, normal) + _GUARD))
        dirichlet, _ = _dirichlet(around.shapes[k], direction, sphere[b], sphere[c])
        total += _CONFORMAL_WEIGHT * area * dirichlet / volume(direction, sphere[b], sphere[c])
    gap = difference(place, image.targets[v])
    total += image.weights[v] * scalar(gap, gap)
    return total


@unfused_kernel
def _dirichlet(
    shape: FloatArray, a: FloatArray, b: FloatArray, c: FloatArray
) -> tuple[float, tuple[float, float, float]]:
    """Return the Dirichlet energy of a mapped face, and a normal whose length is twice its area.

    The mapped corners are a, b and c; ``shape`` is that of the face before mapping.
    """
    p, q, r = difference(b, c), difference(c, a), difference(a, b)
    total = shape[0] * scalar(p, p) + shape[1] * scalar(q, q) + shape[2] * scalar(r, r)
    return total, cross(q, r)


@unfused_kernel
def _set_model(image: Image, v: int, slopes: FloatArray, around: Workspace) -> None:
    """Write the derivatives of the energy of the faces around vertex ``v`` of B to ``around``.

    The derivatives are along two axes in the face of A that contains the image of the vertex.
    """
    (_, surface, sphere), places, model = image.state, image.places, around.model
    model[:] = 0.0
    metric = (
        scalar(slopes[0], slopes[0]),
        scalar(slopes[0], slopes[1]),
        scalar(slopes[1], slopes[1]),
    )
    for k in range(around.star.size):
        after = next_slot(around.star[k])
        b, c = surface.faces[after], surface.faces[next_slot(after)]
        _, at_b, at_c, area = around.shapes[k]
        size = 2 * (at_b + at_c)
        dirichlet, normal = _dirichlet(around.shapes[k], places[v], places[b], places[c])
        inverse = (2 * area) ** 2 / (scalar(normal, normal) + _GUARD)
        height = cross(normal, difference(places[c], places[b]))
        height_square = scalar(normal, normal) + _GUARD
        add_product(
            model,
            _with_derivatives(
                dirichlet, around.shapes[k], around.axes, (places[v], places[b], places[c])
            ),
            (size, 0.0, size),
            (
                scalar(around.axes[0], height) / height_square,
                scalar(around.axes[1], height) / height_square,
            ),
            (0.25 * (1 + inverse), -0.5 * inverse, 1.5 * inverse),
        )
        dirichlet, _ = _dirichlet(around.shapes[k], sphere[v], sphere[b], sphere[c])
        normal, covered = cross(sphere[b], sphere[c]), volume(sphere[v], sphere[b], sphere[c])
        share = _CONFORMAL_WEIGHT * area / covered
        add_product(
            model,
            _with_derivatives(
                dirichlet, around.shapes[k], slopes, (sphere[v], sphere[b], sphere[c])
            ),
            (size * metric[0], size * metric[1], size * metric[2]),
            (scalar(slopes[0], normal) / covered, scalar(slopes[1], normal) / covered),
            (share, -share, 2 * share),
        )
    gap = difference(places[v], image.targets[v])
    for k in range(2):
        model[k] += 2 * image.weights[v] * scalar(around.axes[k], gap)
        model[2 + 2 * k] += 2 * image.weights[v]


@unfused_kernel
def _with_derivatives(
    dirichlet: float,
    shape: FloatArray,
    axes: FloatArray,
    corners: tuple[FloatArray, FloatArray, FloatArray],
) -> tuple[float, float, float]:
    """Return the Dirichlet energy of a face, and its derivatives as the first corner moves.

    The corner moves along the two ``axes``.
    """
    q, r = difference(corners[2], corners[0]), difference(corners[0], corners[1])
    first = 2 * (shape[2] * scalar(axes[0], r) - shape[1] * scalar(axes[0], q))
    return dirichlet, first, 2 * (shape[2] * scalar(axes[1], r) - shape[1] * scalar(axes[1], q))
