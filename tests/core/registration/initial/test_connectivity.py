"""Initial maps between meshes with the same connectivity."""

import numpy as np
from numpy.testing import assert_allclose

from abfm.errors import AbfmError
from abfm.experiments.scripts import bundled
from abfm.maps import map_accuracy, vertex_points
from abfm.maps.surface_points import SurfacePoints
from abfm.mesh import TriangleMesh
from abfm.registration.initial import same_connectivity
from tests.messages import raises
from tests.shapes import ellipsoid, icosphere, with_loose_vertex


def test_poses_are_mapped_vertex_by_vertex():
    a, b = bundled("human_A.off"), bundled("human_B.off")
    found = same_connectivity(a, b)
    assert (found.domain, found.codomain) == (b, a)
    assert map_accuracy(found, count_max=50).maximum == 0
    assert_allclose(found.pull_back(a.vertices), a.vertices, atol=1e-12)


def test_points_inside_faces_keep_their_weights():
    a, b = ellipsoid(2, 1, 2, 3), icosphere(2)
    weights = np.random.default_rng(0).dirichlet(np.ones(3), len(b.faces))
    points = SurfacePoints(b, np.arange(len(b.faces)), weights)
    expected = SurfacePoints(a, points.faces, weights).positions
    assert_allclose(same_connectivity(a, b).at(points).positions, expected, atol=1e-12)


def test_order_and_orientation_of_faces_may_differ():
    a = ellipsoid(1, 1, 2, 3)
    order = np.random.default_rng(1).permutation(len(a.faces))
    for faces in (np.roll(a.faces[order], 1, axis=1), a.faces[:, ::-1]):
        found = same_connectivity(a, TriangleMesh(a.vertices * [1, 1, 2], faces))
        assert_allclose(found.positions, a.vertices[vertex_points(a).nearest_vertices()])


def test_different_connectivity_is_refused_with_the_reason():
    a = icosphere(1)
    with raises(AbfmError, 42, 162):
        same_connectivity(a, icosphere(2))
    with raises(AbfmError, 80, 79):
        same_connectivity(a, TriangleMesh(a.vertices, a.faces[1:]))
    swapped = np.arange(42)
    swapped[[3, 4]] = 4, 3
    with raises(AbfmError, 80):
        same_connectivity(a, TriangleMesh(a.vertices, swapped[a.faces]))


def test_unused_vertices_are_ignored():
    a = icosphere(1)
    assert_allclose(same_connectivity(with_loose_vertex(a), a).positions, a.vertices)
