"""Accuracy of point maps, against distances in the plane, on the sphere, and exact ones."""

import igl
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from abfm.assets import asset_path
from abfm.errors import AbfmError
from abfm.maps.point_maps import PointMap
from abfm.maps.quality import MapAccuracy, map_accuracy
from abfm.mesh import load_mesh
from tests.shapes import icosphere, square, torus


def test_the_true_map_has_no_error():
    mesh = torus(12, 8)
    assert_array_equal(map_accuracy(PointMap.of_vertices(mesh, mesh)).errors, 0)


def test_distances_in_the_plane_are_straight():
    mesh = square(8)
    target = np.random.default_rng(0).permutation(len(mesh.vertices))
    expected = np.linalg.norm(mesh.vertices[target] - mesh.vertices, axis=1)
    assert_allclose(
        map_accuracy(PointMap.of_vertices(mesh, mesh, target)).errors, expected, atol=1e-12
    )


def test_points_inside_faces_are_measured_to_a_share_of_an_edge():
    mesh = square(8)
    points = PointMap.project(
        mesh, mesh, np.random.default_rng(1).uniform(0, 1, (len(mesh.vertices), 3)) * [1, 1, 0]
    )
    expected = np.linalg.norm(points.positions - mesh.vertices, axis=1)
    errors = map_accuracy(points).errors
    assert (errors >= expected - 1e-12).all()
    assert (errors - expected).max() < 0.2 / 8
    assert (errors - expected).mean() < 0.03 / 8


def test_a_turned_sphere_is_off_by_the_arc():
    sphere, angle = icosphere(4), 0.5
    x, y, z = sphere.vertices.T
    turned = np.stack(
        [np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y, z], axis=1
    )
    found = map_accuracy(PointMap.project(sphere, sphere, turned), most=200)
    arcs = np.arccos((turned * sphere.vertices).sum(axis=1).clip(-1, 1))[found.vertices]
    assert_allclose(found.errors, arcs / np.sqrt(4 * np.pi), atol=0.003)


def test_distances_on_an_uneven_mesh_against_exact_ones():
    human = load_mesh(asset_path("human_A.off")).normalized()
    count = len(human.vertices)
    none = np.array([], dtype=np.int64)
    exact = igl.exact_geodesic(
        human.vertices, human.faces, np.array([100]), none, np.arange(count), none
    )
    near = np.flatnonzero(exact < 0.3)
    everywhere = PointMap.of_vertices(human, human)
    found = map_accuracy(everywhere, np.full(count, 100), most=count).errors[near]
    assert (found >= exact[near] - 1e-9).all()
    assert (found - exact[near]).max() < 0.02
    assert (found - exact[near]).mean() < 0.002


def test_truth_may_be_any_map():
    mesh = torus(12, 8)
    target = np.random.default_rng(2).permutation(len(mesh.vertices))
    assert_array_equal(map_accuracy(PointMap.of_vertices(mesh, mesh, target), target).errors, 0)


def test_of_many_vertices_the_same_ones_are_measured():
    mesh = torus(20, 10)
    identity = PointMap.of_vertices(mesh, mesh)
    first, again = (map_accuracy(identity, most=30).vertices for _ in range(2))
    assert_array_equal(first, again)
    assert len(np.unique(first)) == 30


@given(
    st.lists(st.floats(0, 2), min_size=1, max_size=30),
    st.lists(st.floats(-1, 3), min_size=1, max_size=9),
)
def test_share_under_a_bound_counts(errors, bounds):
    accuracy = MapAccuracy(np.arange(len(errors)), np.array(errors))
    expected = [np.mean(np.array(errors) <= bound) for bound in bounds]
    assert_array_equal(accuracy.share_under(bounds), expected)
    assert accuracy.share_under(accuracy.maximum) == 1
    assert accuracy.median <= accuracy.maximum


def test_report_has_the_numbers():
    report = MapAccuracy(np.arange(4), np.array([0.0, 0.01, 0.06, 0.3])).report()
    assert report == (
        "geodesic error: mean 0.0925, median 0.0350, largest 0.3000; "
        "50.0 % under 0.05, 75.0 % under 0.1, 75.0 % under 0.25"
    )


def test_what_does_not_fit_is_refused():
    mesh = torus(8, 6)
    identity = PointMap.of_vertices(mesh, mesh)
    with pytest.raises(AbfmError, match="truth has shape"):
        map_accuracy(identity, np.arange(3))
    with pytest.raises(AbfmError, match="expected 0 to"):
        map_accuracy(identity, np.arange(len(mesh.vertices)) + 1)
    with pytest.raises(AbfmError, match="at least 1"):
        map_accuracy(identity, most=0)
