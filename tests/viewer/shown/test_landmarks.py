"""Landmarks that are hidden by other parts of a surface."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy.spatial.transform import Rotation

from abfm.calculus import face_normals
from abfm_viewer.shown.landmarks import LandmarkPoints
from tests.shapes import icosphere, torus

SPHERE, RING = icosphere(3), torus(60, 30)
FROM_X = np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]])  # axes right, up, and towards the viewer
FROM_Z = np.eye(3)


def are_hidden(mesh, places, normals, axes):
    return LandmarkPoints(mesh, tuple(range(len(places))), places, normals).hidden(axes)


@pytest.mark.parametrize("seed", range(4))
def test_landmarks_on_the_back_of_a_sphere_are_hidden(seed):
    axes = Rotation.random(rng=seed).as_matrix()
    places = SPHERE.vertices
    hidden = are_hidden(SPHERE, places, places, axes)
    assert_array_equal(hidden, places @ axes[2] <= 0)


def test_landmarks_behind_a_ring_are_hidden():
    places, normals = RING.vertices[RING.faces].mean(axis=1), face_normals(RING)
    assert_array_equal(are_hidden(RING, places, normals, FROM_Z), normals[:, 2] <= 0)
    hidden = are_hidden(RING, places, normals, FROM_X)
    x, y, _ = places.T
    faces_viewer = normals[:, 0] > 0.05
    inner = np.hypot(x, y) < np.hypot(*RING.vertices[:, :2].T).mean()
    assert hidden[normals[:, 0] <= 0].all()
    # the inner side of the far half faces the viewer, behind the near half
    behind = faces_viewer & inner & (x < -0.3) & (np.abs(y) < 0.3)
    assert behind.sum() > 10
    assert hidden[behind].all()
    before = faces_viewer & ~inner & (x > 0.3)
    assert before.sum() > 100
    assert not hidden[before].any()
