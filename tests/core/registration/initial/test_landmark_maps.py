"""Initial maps by three or more landmarks: other positions, poses and shapes."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from abfm.experiments.scripts import bundled
from abfm.maps import PointMap, map_accuracy
from abfm.mesh import TriangleMesh, shapes
from abfm.mesh.coarsening import coarsened
from abfm.registration.initial import Landmarks, initial_map
from abfm.registration.initial.map_input import MapInput
from tests.shapes import icosphere

BODY = shapes.five_limbs(200)
TIPS = [
    int(np.argmax(BODY.vertices @ direction)) for direction in np.vstack([np.eye(3), -np.eye(3)])
]


def moved(mesh, side=1):
    turn = Rotation.from_rotvec([2, 1, -1])
    return TriangleMesh(4 * side * turn.apply(mesh.vertices.copy()), mesh.faces[:, ::side])


def test_moved_body_is_found_by_closest_points():
    a = moved(BODY)
    b = coarsened(BODY, 130)
    nearest = PointMap.project(BODY, b, BODY.vertices).nearest_vertices()[TIPS[:4]]
    landmarks = Landmarks.of_vertices(a, b, TIPS[:4], nearest)
    points = initial_map("landmarks", MapInput(a, b, landmarks=landmarks)).correspondence.points
    truth = PointMap.project(b, BODY, b.vertices)
    turned = Rotation.from_rotvec([2, 1, -1]).apply(truth.positions.copy())
    gaps = np.linalg.norm(points.positions - 4 * turned, axis=1)
    assert gaps.mean() < 0.02 * a.length_scale
    assert np.isin(points.barycentric, [0, 1]).all(axis=1).mean() < 0.5


def test_poses_are_found_by_eigenfunctions():
    fine, other = bundled("human_A.off"), bundled("human_B.off")
    a = coarsened(fine, 400)
    places = PointMap.project(a, fine, a.vertices).pull_back(other.vertices)
    b = TriangleMesh(places, a.faces)
    ends = [int(np.argmax(a.vertices @ d)) for d in ([0, 0, 1], [0, 1, 0], [1, 0, 0], [-1, 0, 0])]
    landmarks = Landmarks.of_vertices(a, b, ends, ends)
    points = initial_map("landmarks", MapInput(a, b, landmarks=landmarks)).correspondence.points
    assert map_accuracy(points, count_max=150).mean < 0.007


@pytest.mark.parametrize("mesh", [BODY, icosphere(1)])
def test_mirror_images_are_found_by_landmarks(mesh):
    b, vertices = moved(mesh, -1), [0, 5, 17, 30]
    given = MapInput(mesh, b, landmarks=Landmarks.of_vertices(mesh, b, vertices, vertices))
    points = initial_map("landmarks:mirror", given).correspondence.points
    assert_allclose(points.positions, mesh.vertices, atol=1e-6)


def test_map_contains_landmarks():
    a, b = BODY, TriangleMesh(BODY.vertices * [1, 1.6, 1], BODY.faces)
    rng = np.random.default_rng(0)
    places = rng.choice(len(b.vertices), 5, replace=False)
    landmarks = Landmarks.of_vertices(a, b, places, places)
    found = initial_map("landmarks", MapInput(a, b, landmarks=landmarks)).correspondence
    gaps = found.points.at(landmarks.b).distances_from(landmarks.a.positions) / a.length_scale
    assert gaps.max() < 0.05
