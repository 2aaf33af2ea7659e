"""Of two maps by landmarks the one that keeps areas and landmarks: another place, another pose."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from abfm.errors import AbfmError
from abfm.experiments.vocabulary import bundled
from abfm.maps import PointMap, map_accuracy
from abfm.mesh import TriangleMesh, shapes
from abfm.mesh.coarsening import coarsened
from abfm.registration.initial import Landmarks, map_from_landmarks
from abfm.registration.initial.landmarks_only import loss
from tests.messages import raises
from tests.shapes import icosphere

BODY = shapes.five_limbs(400)
TIPS = [
    int(np.argmax(BODY.vertices @ direction)) for direction in np.vstack([np.eye(3), -np.eye(3)])
]


def turned(mesh, side=1):
    turn = Rotation.from_rotvec([2, 1, -1])
    return TriangleMesh(4 * side * turn.apply(mesh.vertices.copy()), mesh.faces[:, ::side])


def test_what_only_stands_elsewhere_is_found_by_closest_points():
    """Other triangles: closest points lie inside faces, those by eigenfunctions do not."""
    a = turned(BODY)
    b = coarsened(BODY, 250)
    near = PointMap.project(BODY, b, BODY.vertices).nearest_vertices()[TIPS[:4]]
    points = map_from_landmarks(a, b, Landmarks.of_vertices(a, b, TIPS[:4], near))
    truth = PointMap.project(b, BODY, b.vertices)
    gaps = np.linalg.norm(points.positions - turned_places(truth.positions), axis=1)
    assert gaps.mean() < 0.02 * a.length_scale
    assert np.isin(points.barycentric, [0, 1]).all(axis=1).mean() < 0.5


def turned_places(points):
    return 4 * Rotation.from_rotvec([2, 1, -1]).apply(points.copy())


def test_another_pose_is_found_by_eigenfunctions():
    a, b = bundled("human_A.off"), bundled("human_B.off")
    ends = [int(np.argmax(a.vertices @ d)) for d in ([0, 0, 1], [0, 1, 0], [1, 0, 0], [-1, 0, 0])]
    points = map_from_landmarks(a, b, Landmarks.of_vertices(a, b, ends, ends))
    assert map_accuracy(points, most=150).mean < 0.005


@pytest.mark.parametrize("mesh", [BODY, icosphere(1)])
def test_mirror_images(mesh):
    """Also where there are too few vertices for eigenfunctions."""
    b, marks = turned(mesh, -1), [0, 5, 17, 30]
    points = map_from_landmarks(mesh, b, Landmarks.of_vertices(mesh, b, marks, marks), True)
    assert_allclose(points.positions, mesh.vertices, atol=1e-6)


def test_what_a_map_loses():
    """Nothing; all of the area; and so much for each sqrt(area) that a landmark is off."""
    ball = icosphere(3)
    same = PointMap.of_vertices(ball, ball)
    marks = Landmarks.of_vertices(ball, ball, [1, 2, 3], [1, 2, 3])
    assert loss(same, marks) == pytest.approx(0, abs=1e-12)
    point = PointMap.of_vertices(ball, ball, np.full(len(ball.vertices), 1))
    one = Landmarks.of_vertices(ball, ball, [1], [2])
    assert loss(point, one) == pytest.approx(1)
    away = Landmarks.of_vertices(ball, ball, [2], [2])
    gap = np.linalg.norm(ball.vertices[2] - ball.vertices[1]) / ball.length_scale
    assert loss(point, away) == pytest.approx(1 + 10 * gap)


def test_two_landmarks_are_too_few():
    with raises(AbfmError, 2, 3):
        map_from_landmarks(BODY, BODY, Landmarks.of_vertices(BODY, BODY, [1, 2], [1, 2]))
