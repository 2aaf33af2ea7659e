"""From a torn map between surfaces of genus 0 a homeomorphism: both laid out on one sphere.

Point maps of functional maps tear: they turn some faces over and collapse others. Here A is
embedded in the sphere, and B is unfolded there, as in `sphere_embedding`; from about a hundred
vertices on it is pulled, after every round, to where the torn map has it. Then its image on A is
moved to less distortion. No face of B ever turns over.

On 24 pairs of SHREC'19 people of 5,000 to 7,000 vertices, from maps of 128 eigenfunctions that turn
6% of the faces over and collapse 38%, none is turned over and 0.03% are collapsed; the mean
geodesic error is 0.0252 sqrt(area) after 0.0260, and no more than before for 15 of the pairs.
"""

import numpy as np

from abfm.calculus.smoothing import smoothed
from abfm.maps.image_relaxation import Codomain, Image, push_to_sphere, relax, relocate
from abfm.maps.point_maps import PointMap
from abfm.maps.sphere_embedding import (
    Embedding,
    check_embedded,
    embed,
    filled,
    surface_of,
    sweep,
    unfolding,
)
from abfm.maps.sphere_pull import allocate_moves, average, set_moves, shift
from abfm.maps.spherical import Faces
from abfm.maps.star_moves import allocate_workspace
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray, IntArray
from abfm.workers.control import checkpoint
from abfm.workers.progress import step

_TURNED_VERTICES = 100  # vertices that are turned to where they belong
_LENGTH_MIN = 1e-12  # a direction that is none
# of weighing down those that are farther off, squared
_TURNS = 20
_SQUARED_DISTANCE_SOFTENING = 0.1
# on the sphere: how often moves are averaged, one after the other, how long they are at most, and
# how many times vertices move, few of them more often, with sweeps of less distortion each time
_AVERAGING_ROUNDS = (16, 8, 4, 2, 1)
_MOVE_LENGTH_MAX = 0.5
_PULLS = (2, 10)
_PULLED_VERTICES = 10_000
_SWEEPS = 6
# on A: the same, in sqrt(area)
_AVERAGED_ON_A = (8, 4, 2, 1)
_LONGEST_ON_A = 0.1
_PULLS_ON_A = 3
_SWEEPS_ON_A = 4
_SMOOTHING_LENGTH = 0.02  # sqrt(area), the torn map that its image is pulled to
# distances that cost as much as distortion; last sweeps
_LOOSE_DISTANCE = 0.05
_TIGHT_DISTANCE = 0.02
_LAST_SWEEPS = 10


def continuous_map(points: PointMap) -> tuple[FloatArray, FloatArray]:
    """Lay out both surfaces of a map on one sphere, so that points in the same direction make it
    continuous: unit vectors of the codomain's vertices (V_A, 3) and of the domain's (V_B, 3).

    On a closed surface, the map of equal directions (`abfm.maps.spherical.through_sphere`) is a
    homeomorphism, near the given one in space where that does not contradict itself, and of little
    distortion. It keeps the side: give a map onto the mirror image as one onto a mirrored mesh.

    Raises
    ------
    MeshError
        If a surface has handles or pinched vertices, or its faces are too thin for rounding.
    """
    a, b = points.codomain.normalized(), points.domain.normalized()
    (points_a, faces_a), (points_b, faces_b) = filled(a), filled(b)
    sphere_a = embed(points_a, faces_a)
    directions = points.pull_back(sphere_a[: len(a.vertices)])
    directions /= np.maximum(np.linalg.norm(directions, axis=1), _LENGTH_MIN)[:, None]
    targets = _with_middles(b, directions)
    places = smoothed(b, points.positions / points.codomain.length_scale, _SMOOTHING_LENGTH)
    sphere_b = _pulled(points_b, faces_b, targets)
    with step("moving the map to less distortion", len(points_b)):
        surface = surface_of(faces_a, len(points_a))
        corners, neighbours = surface.faces.reshape(-1, 3), surface.twins.reshape(-1, 3)
        codomain = Codomain(Faces(corners, neighbours, sphere_a, 1.0), points_a)
        state = Embedding(points_b, surface_of(faces_b, len(points_b)), sphere_b)
        _relax(state, codomain, _with_middles(b, places))
    check_embedded(sphere_b, faces_b)
    return sphere_a[: len(a.vertices)], sphere_b[: len(b.vertices)]


def _with_middles(mesh: TriangleMesh, values: FloatArray) -> FloatArray:
    """Add means over boundaries, for the vertices that close them."""
    return np.concatenate(
        [values, *(values[loop].mean(axis=0)[None] for loop in mesh.boundary_loops)]
    )


def _pulled(points: FloatArray, faces: IntArray, targets: FloatArray) -> FloatArray:
    """Unfold a surface on the sphere, pulled to targets (V, 3)."""
    count, turned = len(points), False
    pull, workspace = allocate_moves(count), allocate_workspace(count)
    with step("pulling the map together", count) as done:
        for state, alive in unfolding(points, faces):
            done(len(alive) / count)
            if len(alive) < min(_TURNED_VERTICES, count):
                continue
            if not turned:
                state.sphere[alive] = _turned(state.sphere[alive], targets[alive])
                turned = True
            pulls = int(np.clip(_PULLED_VERTICES // len(alive), *_PULLS))
            for rounds in np.repeat(_AVERAGING_ROUNDS, pulls).tolist():
                checkpoint()
                set_moves(state.sphere, targets, _MOVE_LENGTH_MAX, alive, pull.moves)
                average(state.surface, rounds, alive, pull, workspace.star)
                shift(state, alive, pull, workspace)
                for _ in range(_SWEEPS):
                    sweep(state, alive, workspace)
    return state.sphere


def _turned(sphere: FloatArray, targets: FloatArray) -> FloatArray:
    """Turn the sphere so that vertices (V, 3) are near their targets, most of them."""
    weights = np.ones(len(sphere))
    for _ in range(_TURNS):
        u, _, v = np.linalg.svd((weights[:, None] * sphere).T @ targets)
        turned = sphere @ u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v
        weights = 1 / (((turned - targets) ** 2).sum(axis=1) + _SQUARED_DISTANCE_SOFTENING)
    return np.asarray(turned)


def _relax(state: Embedding, codomain: Codomain, targets: FloatArray) -> None:
    """Move a surface on the sphere so that its image is less distorted and near to targets."""
    count = len(targets)
    alive, pull, workspace = np.arange(count), allocate_moves(count), allocate_workspace(count)
    corners = state.surface.faces.reshape(-1, 3)
    a, b, c = np.moveaxis(state.points[corners], 1, 0)
    sizes = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6
    areas = np.bincount(corners.ravel(), np.repeat(sizes, 3), count)
    faces, weights = np.zeros(count, dtype=np.int64), areas / _LOOSE_DISTANCE**2
    image = Image(state, codomain, faces, np.zeros((count, 3)), targets, weights)
    relocate(image)
    for rounds in np.repeat(_AVERAGED_ON_A, _PULLS_ON_A).tolist():
        checkpoint()
        set_moves(image.places, targets, _LONGEST_ON_A, alive, pull.moves)
        average(state.surface, rounds, alive, pull, workspace.star)
        push_to_sphere(image, pull.moves, workspace)
        shift(state, alive, pull, workspace)
        relocate(image)
        for _ in range(_SWEEPS_ON_A):
            relax(image, workspace)
    weights *= (_LOOSE_DISTANCE / _TIGHT_DISTANCE) ** 2
    for _ in range(_LAST_SWEEPS):
        checkpoint()
        relax(image, workspace)
