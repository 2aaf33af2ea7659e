"""Correspondences: transfer in both directions, composition, and files."""

import pickle

import numpy as np
import pandas
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

import abfm
from abfm import Correspondence, PointMap, TriangleMesh
from abfm.calculus.operators import vertex_areas
from abfm.errors import AbfmError, FunctionError, ParameterError, ResultError
from abfm.io import FORMAT_VERSION
from abfm.maps.surface_points import SurfacePoints, points_by_area
from abfm.mesh.shapes import even_sphere
from tests.messages import raises
from tests.shapes import ellipsoid, icosphere, square, torus, with_loose_vertex

FINE, COARSE = icosphere(4), even_sphere(300)
TURN = Rotation.from_rotvec([0.3, -0.2, 0.9])


def spheres(a, b, turn=TURN):
    return Correspondence.through_sphere(a, b, turn.apply(a.vertices.copy()), b.vertices)


def linear(mesh, turn=None):
    points = mesh.vertices if turn is None else turn.apply(mesh.vertices.copy())
    return points @ [1.0, -2, 0.5]


@pytest.mark.parametrize(("a", "b"), [(FINE, COARSE), (COARSE, FINE)])
def test_functions_are_transferred_to_corresponding_points(a, b):
    found = spheres(a, b)
    for by in ("point", "area"):
        transferred = found.transfer(linear(a, TURN), by)
        assert np.abs(transferred - linear(b)).max() < 0.1
        assert_allclose(found.transfer(np.ones(len(a.vertices)), by), 1)
        matrix = found.to_matrix(by)
        assert_allclose(matrix.sum(axis=1), 1)
        assert_allclose(matrix @ linear(a, TURN), transferred, atol=1e-12)
        assert matrix.min() >= 0
    assert np.diff(found.to_matrix().indptr).max() == 3
    assert found.transfer(np.ones((len(a.vertices), 2))).shape == (len(b.vertices), 2)


@pytest.mark.parametrize(("a", "b"), [(FINE, COARSE), (COARSE, FINE)])
def test_transfer_by_area_preserves_integrals(a, b):
    """A vertex of A distributes its area over B, so integrals over A and B are equal."""
    found = spheres(a, b)
    shares = found.area_shares()
    assert_allclose(shares.sum(axis=0), vertex_areas(a))
    h = np.random.default_rng(0).normal(size=len(a.vertices))
    transferred = found.transfer(h, "area")
    assert_allclose(shares.sum(axis=1) @ transferred, vertex_areas(a) @ h)


def test_transfer_by_area_reduces_noise():
    found = spheres(FINE, COARSE)
    noise = np.random.default_rng(0).normal(size=len(FINE.vertices))
    assert found.transfer(noise, "area").std() < 0.6 * found.transfer(noise).std()


def test_labels_are_not_averaged():
    found = spheres(FINE, COARSE)
    labels = np.where(linear(FINE, TURN) > 0.1, 1000, -7)
    for by in ("point", "area"):
        transferred = found.transfer_labels(labels, by)
        assert set(transferred) == {1000, -7}
        clear = np.abs(linear(COARSE) - 0.1) > 0.15
        assert_array_equal(transferred[clear], np.where(linear(COARSE) > 0.1, 1000, -7)[clear])
    with raises(FunctionError):
        found.transfer_labels(linear(FINE))


def test_labels_may_be_series_or_masked_arrays():
    found = spheres(FINE, COARSE)
    labels = np.where(linear(FINE, TURN) > 0.1, 1000, -7)
    expected = found.transfer_labels(labels)
    order = np.random.default_rng(0).permutation(len(labels))
    assert_array_equal(found.transfer_labels(pandas.Series(labels[order], index=order)), expected)
    assert_array_equal(found.transfer_labels(np.ma.array(labels)), expected)
    with raises(FunctionError, "float64"):
        found.transfer_labels(np.ma.array(labels, mask=labels < 0))


def test_points_return_after_a_round_trip():
    found = spheres(FINE, COARSE)
    on_b = found.transfer_points(np.arange(40))
    assert_allclose(found.points.at(on_b).positions, FINE.vertices[:40], atol=1e-12)
    assert found.round_trip().p95 < 1e-10
    nearest = found.to_vertices()
    offsets = TURN.apply(FINE.vertices[nearest]) - COARSE.vertices
    assert np.linalg.norm(offsets, axis=1).max() < 0.08


def test_inverse_and_composition_agree_with_transfers():
    found = spheres(FINE, COARSE)
    back = found.inverse()
    assert back.a is COARSE
    assert_allclose(back.points.positions, found.back.positions)
    around = found.compose(back)
    assert_allclose(around.points.positions, FINE.vertices, atol=1e-10)
    third = even_sphere(500)
    twice = found.compose(spheres(COARSE, third, TURN))
    straight = spheres(FINE, third, TURN * TURN)
    assert np.abs(twice.points.positions - straight.points.positions).max() < 1e-10


def test_rotation_has_no_distortion_and_full_coverage():
    large = TriangleMesh(50 * FINE.vertices, FINE.faces)
    found = spheres(large, COARSE)
    distortion = found.distortion()
    assert distortion.log2_area.maximum < 0.2  # both spheres have flat faces
    assert abs(np.average(np.log2(distortion.area), weights=distortion.weights)) < 0.02
    assert distortion.folded == 0
    assert found.coverage() == 1
    images = np.where(FINE.vertices[:, 0] > 0, np.arange(len(FINE.vertices)), 0)
    half = Correspondence(PointMap.of_vertices(FINE, FINE, images))
    assert 0.45 < half.coverage() < 0.75


def test_reflection_has_no_folded_faces():
    directions = FINE.vertices * [-1, 1, 1]
    mirror = Correspondence.through_sphere(FINE, COARSE, directions, COARSE.vertices)
    assert mirror.is_mirrored
    assert mirror.distortion().folded == 0
    assert not spheres(FINE, COARSE).is_mirrored


def test_default_inverse_uses_nearest_images():
    rng = np.random.default_rng(0)
    order = rng.permutation(len(FINE.vertices))
    place = np.argsort(order)
    renumbered = TriangleMesh(FINE.vertices[order], place[FINE.faces])
    found = Correspondence(PointMap.of_vertices(renumbered, FINE, order))
    assert_allclose(found.back.positions, FINE.vertices, atol=1e-12)
    assert_array_equal(found.to_vertices(), order)
    assert found.round_trip().p95 < 1e-10
    assert found.distortion().log2_area.maximum < 1e-9
    errors = found.accuracy(order)
    assert errors.maximum < 1e-9


@pytest.mark.parametrize("method", ["sphere", "nearest", "numbers"])
def test_map_of_spheres_applies_to_their_surfaces(method):
    balls = (FINE, FINE) if method == "numbers" else (FINE, COARSE)
    on_balls = {
        "sphere": spheres,
        "nearest": lambda a, b: Correspondence(PointMap.project(b, a, b.vertices)),
        "numbers": Correspondence.of_same_faces,
    }[method](*balls)
    a, b = (TriangleMesh(ball.vertices * [1, 2, 3], ball.faces) for ball in balls)
    found = on_balls.on_surfaces(a, b)
    assert found.a is a
    assert found.b is b
    assert_allclose(found.points.positions, on_balls.points.positions * [1, 2, 3], atol=1e-12)
    places = np.arange(40), np.full((40, 3), 1 / 3)
    centroids = [SurfacePoints(mesh, *places) for mesh in (a, balls[0])]
    images, expected = found.transfer_points(centroids[0]), on_balls.transfer_points(centroids[1])
    assert_allclose(images.positions, expected.positions * [1, 2, 3], atol=1e-12)
    assert on_balls.on_surfaces(*balls) is on_balls


def test_constant_map_has_no_inverse():
    point = Correspondence(PointMap.of_vertices(FINE, COARSE, np.zeros(len(FINE.vertices), int)))
    with raises(AbfmError):
        _ = point.back


def test_equal_faces_give_a_map_by_vertex_numbers():
    wavy = TriangleMesh(FINE.vertices * (1 + 0.1 * np.sin(5 * FINE.vertices[:, :1])), FINE.faces)
    found = Correspondence.of_same_faces(wavy, FINE)
    assert_array_equal(found.transfer(linear(wavy)), linear(wavy))
    assert found.round_trip().p95 == 0
    with raises(AbfmError):
        Correspondence.of_same_faces(FINE, COARSE)


def test_functions_have_the_vertices_of_the_file():
    loose = with_loose_vertex(FINE)
    found = spheres(loose, COARSE)
    h = np.arange(len(FINE.vertices) + 1.0)
    assert_array_equal(found.transfer(h), found.transfer(np.delete(h, 5)))
    assert_allclose(found.transfer(h, "area"), found.transfer(np.delete(h, 5), "area"))
    with raises(FunctionError):
        found.transfer(h[:-7])
    with raises(FunctionError):
        found.transfer(3.0)
    with raises(AbfmError):
        found.transfer_points(SurfacePoints(COARSE, np.array([0]), np.array([[1.0, 0, 0]])))
    with raises(ParameterError, "point", "area"):
        found.to_matrix("volume")


@pytest.mark.parametrize(
    "found",
    [
        spheres(FINE, COARSE),
        Correspondence.of_same_faces(torus(12, 8), torus(12, 8, r=0.3)),
        spheres(FINE, COARSE).inverse(),
        Correspondence(
            PointMap.of_vertices(COARSE, COARSE),
            PointMap.of_vertices(COARSE, COARSE, np.roll(np.arange(300), 1)),
        ),
        Correspondence(PointMap.project(square(6), square(4), square(6).vertices)),
        Correspondence(
            PointMap(COARSE, COARSE, np.arange(300), np.tile([-1e-10, 0.5, 0.5 + 1e-10], (300, 1)))
        ),
    ],
    ids=["sphere", "same faces", "inverse of a sphere", "other inverse", "points", "rounded"],
)
def test_files_round_trip(found, tmp_path):
    found.save(tmp_path / "c.npz")
    again = abfm.load(tmp_path / "c.npz")
    assert_array_equal(again.points.positions, found.points.positions)
    assert_array_equal(again.back.positions, found.back.positions)
    assert again.round_trip() == found.round_trip()
    points = SurfacePoints(found.a, np.arange(20), np.full((20, 3), 1 / 3))
    images, expected = (each.transfer_points(points).positions for each in (again, found))
    assert_array_equal(images, expected)
    again.save(tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "c.npz").read_bytes()


@pytest.mark.parametrize(
    ("name", "value", "named"),
    [
        ("image_faces", np.full(300, 10**6), 1000000),
        ("image_barycentric", np.full((300, 3), 0.5), ""),
        ("a_faces", np.zeros((4, 3), int), ""),
        ("sphere", np.zeros((300, 3)), ""),
        ("back_faces", np.zeros(7, int), ""),
        ("a_vertices", np.full((2562, 3), np.inf), ""),
    ],
)
def test_damaged_files_are_refused(name, value, named, tmp_path):
    arrays = spheres(FINE, COARSE).arrays() | {name: value, "format_version": FORMAT_VERSION}
    np.savez(tmp_path / "bad.npz", **arrays)
    with raises(ResultError, named):
        abfm.load(tmp_path / "bad.npz")


def test_maps_between_other_surfaces_are_refused():
    points = PointMap.of_vertices(FINE, FINE)
    with raises(AbfmError):
        Correspondence(points, PointMap.of_vertices(COARSE, COARSE))
    with raises(AbfmError):
        points.followed_by(PointMap.of_vertices(COARSE, COARSE))


@pytest.mark.parametrize("kind", ["sphere", "connectivity", "points"])
def test_correspondences_can_be_pickled(kind):
    a, b = icosphere(2), ellipsoid(2, 1.0, 2.0, 1.5)
    found = {
        "sphere": lambda: Correspondence.through_sphere(a, b, a.vertices, a.vertices[:, [1, 2, 0]]),
        "connectivity": lambda: Correspondence.of_same_faces(a, b),
        "points": lambda: Correspondence(PointMap.of_vertices(b, a)),
    }[kind]()
    again = pickle.loads(pickle.dumps(found))
    inside = points_by_area(a, 200)
    for one, other in ((found.points, again.points), (found.back, again.back)):
        assert_array_equal(one.positions, other.positions)
    assert_array_equal(found.back.at(inside).positions, again.back.at(inside).positions)
