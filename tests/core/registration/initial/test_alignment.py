"""Alignment of moved, mirrored, remeshed and landmarked copies, and Umeyama's formula."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from abfm.errors import ParameterError
from abfm.experiments.scripts import bundled
from abfm.maps.surface_points import SurfacePoints, points_by_area, project_onto_surface
from abfm.mesh import TriangleMesh, shapes
from abfm.mesh.coarsening import coarsened
from abfm.registration.initial import Landmarks, align, closest_after_alignment
from abfm.registration.initial.alignment import best_motion
from tests.core.surfaces import renumbered
from tests.messages import raises
from tests.shapes import icosphere

BODY = shapes.five_limbs(400)
POSES = bundled("human_A.off"), bundled("human_B.off")


def moved(mesh, rotation, scale=1.0, side=1):
    """Return a copy after rotation, scaling, translation and, for side -1, reflection."""
    rotated = Rotation.from_rotvec(rotation).apply(mesh.vertices.copy())
    vertices = scale * side * rotated + [3, -1, 2]
    return TriangleMesh(vertices, mesh.faces[:, ::side])


@settings(max_examples=8, derandomize=True)
@given(
    turn=st.tuples(*[st.floats(-3, 3)] * 3),
    scale=st.floats(1e-3, 1e3),
    kind=st.sampled_from(["similarity", "mirror"]),
    seed=st.integers(0, 99),
)
def test_moved_and_renumbered_copies_are_aligned_exactly(turn, scale, kind, seed):
    side = -1 if kind == "mirror" else 1
    b, order, _ = renumbered(moved(BODY, turn, scale, side), seed)
    points, found = closest_after_alignment(BODY, b, kind)
    assert found.scale == pytest.approx(1 / scale)
    assert np.linalg.det(found.rotation) == pytest.approx(side)
    assert found.rms < 1e-9
    assert_allclose(points.positions, BODY.vertices[order], atol=1e-7)
    assert_allclose(found(b.vertices), BODY.vertices[order], atol=1e-7)


def test_rigid_motions_have_scale_1():
    """A rigid motion never scales, so a difference in size remains in the RMS distance."""
    found = align(BODY, moved(BODY, [1, 2, 0.5]), "rigid")
    assert (found.scale, found.rms < 1e-9) == (1, True)
    found = align(icosphere(3), icosphere(3, radius=1.2), "rigid")
    assert found.scale == 1
    assert found.rms == pytest.approx(0.2 / np.sqrt(4 * np.pi), rel=0.02)


def test_triangulation_has_little_influence():
    coarse = coarsened(POSES[0], 700)
    crowded = TriangleMesh(*uneven(POSES[0]))
    for other in (coarse, crowded):
        points, found = closest_after_alignment(POSES[0], moved(other, [0.3, 2, -1], 5))
        turn = Rotation.from_matrix(found.rotation) * Rotation.from_rotvec([0.3, 2, -1])
        assert turn.magnitude() < 0.02
        assert found.scale == pytest.approx(0.2, rel=0.01)
        off = np.linalg.norm(points.positions - other.vertices, axis=1) / POSES[0].length_scale
        assert np.sqrt(np.mean(off**2)) < 0.01


def uneven(mesh):
    """Return the surface with the faces on one side divided, so most vertices are there."""
    centres = mesh.vertices[mesh.faces].mean(axis=1)
    cut = centres[:, 0] > np.median(centres[:, 0])
    middle = len(mesh.vertices) + np.arange(cut.sum())
    a, b, c = mesh.faces[cut].T
    parts = [np.stack(corners, axis=1) for corners in ((a, b, middle), (b, c, middle))]
    parts.append(np.stack([c, a, middle], axis=1))
    return np.concatenate([mesh.vertices, centres[cut]]), np.concatenate([mesh.faces[~cut], *parts])


def test_landmarks_determine_the_rotation_of_a_sphere():
    a = icosphere(3)
    turn = Rotation.from_rotvec([0.4, -1.2, 2])
    b = TriangleMesh(2 * turn.apply(a.vertices.copy()), a.faces)
    landmarks = Landmarks.of_vertices(a, b, [5, 77, 200, 431], [5, 77, 200, 431])
    points, found = closest_after_alignment(a, b, "similarity", landmarks)
    assert_allclose(found.rotation, turn.inv().as_matrix(), atol=1e-9)
    assert_allclose(points.positions, a.vertices, atol=1e-9)


def test_one_landmark_chooses_between_equal_rotations():
    """A body with two arms is unchanged by half a turn; a landmark on one arm decides."""
    a = shapes.two_armed(2)
    tip = int(a.vertices[:, 0].argmax())
    other = int(a.vertices[:, 0].argmin())
    for end in (tip, other):
        landmarks = Landmarks.of_vertices(a, a, [end], [tip])
        points, found = closest_after_alignment(a, a, "similarity", landmarks)
        assert found.rms < 1e-6
        assert_allclose(points.positions[tip], a.vertices[end], atol=1e-6)


def test_interior_map_uses_closest_points():
    a = icosphere(4)
    points, found = closest_after_alignment(a, icosphere(2))
    centroids = SurfacePoints(points.domain, np.arange(320), np.full((320, 3), 1 / 3))
    images = points.at(centroids).positions
    aligned = found(centroids.positions)
    expected = aligned / np.linalg.norm(aligned, axis=1)[:, None]
    assert_allclose(images, expected, atol=0.01)
    assert points.distances.max() < 0.02


def test_identity_is_preferred_for_a_sphere():
    ball = icosphere(3)
    points, _ = closest_after_alignment(ball, TriangleMesh(3 * ball.vertices, ball.faces))
    assert_allclose(points.positions, ball.vertices, atol=1e-9)


def test_given_positions_are_preferred():
    """Given positions are kept if a rotated pose has an only slightly smaller RMS distance."""
    found = align(*POSES)
    assert Rotation.from_matrix(found.rotation).magnitude() < 0.6  # without half a turn
    assert found.rms < np.sqrt(np.mean(two_way_distances(*POSES) ** 2))


def two_way_distances(a, b):
    """Return distances between the surfaces in both directions, in sqrt(area) of A."""
    some = [points_by_area(mesh, 500).positions for mesh in (a, b)]
    gaps = [
        project_onto_surface(mesh, points).distances_from(points)
        for mesh, points in zip((b, a), some, strict=True)
    ]
    return np.concatenate(gaps) / a.length_scale


@pytest.mark.parametrize("kind", ["similarity", "rigid", "mirror"])
def test_best_motion_recovers_a_motion(kind):
    rng = np.random.default_rng(2)
    b, weights = rng.normal(size=(20, 3)), rng.uniform(0.1, 1, 20)
    turn = Rotation.from_rotvec([1, -2, 0.5]).as_matrix() * (-1 if kind == "mirror" else 1)
    scale = 1.0 if kind == "rigid" else 1.7
    found = best_motion(b, scale * b @ turn.T + [1, 2, 3], weights, kind)
    for part, expected in zip(found, (turn, scale, [1, 2, 3]), strict=True):
        assert_allclose(part, expected, atol=1e-12)


def test_best_motion_is_least_squares():
    rng = np.random.default_rng(3)
    b, a, weights = rng.normal(size=(9, 3)), rng.normal(size=(9, 3)), rng.uniform(0.1, 1, 9)

    def squares(rotation, scale, shift):
        return weights @ ((scale * b @ rotation.T + shift - a) ** 2).sum(axis=1)

    found = best_motion(b, a, weights, "similarity")
    if found[1] > 0.1:
        least = squares(*found)
        for _ in range(50):
            nudge = Rotation.from_rotvec(0.05 * rng.normal(size=3)).as_matrix()
            other = squares(
                nudge @ found[0],
                found[1] * (1 + 0.05 * rng.normal()),
                found[2] + 0.05 * rng.normal(size=3),
            )
            assert other > least


def test_unknown_kinds_are_refused():
    with raises(ParameterError, "affine", "similarity", "rigid", "mirror"):
        align(BODY, BODY, "affine")
