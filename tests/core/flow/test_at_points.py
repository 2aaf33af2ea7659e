"""A continuous field at points, and straightest geodesics from them, where both are known."""

import numpy as np
import pytest

from abfm.flow import straightest_geodesics, vectors_at
from abfm.maps import SurfacePoints
from abfm.maps.surface_points import points_by_area
from tests.shapes import icosphere, square


def tangential(mesh, vectors):
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return vectors - (vectors * normals).sum(axis=1, keepdims=True) * normals


def error_of_rotation(level):
    mesh = icosphere(level)
    points = points_by_area(mesh, 500)
    field = tangential(mesh, np.cross([0, 0, 1.0], mesh.vertices[mesh.faces].mean(axis=1)))
    found = vectors_at(mesh, field, points)
    return np.abs(found - np.cross([0, 0, 1.0], points.positions)).max()


def test_vectors_of_a_rotation_converge_on_the_sphere():
    errors = [error_of_rotation(level) for level in (2, 3, 4)]
    assert errors[2] < 0.06
    assert errors[0] / errors[1] > 1.7
    assert errors[1] / errors[2] > 1.7


def test_linear_fields_of_the_plane_are_exact_inside():
    mesh = square(12)
    centres = mesh.vertices[mesh.faces].mean(axis=1)
    points = points_by_area(mesh, 400)
    inside = np.abs(points.positions[:, :2] - 0.5).max(axis=1) < 0.3

    def field(places):
        x, y, _ = places.T
        return np.stack([1 + x - 2 * y, 0.5 * x + y, 0 * x], axis=1)

    found = vectors_at(mesh, field(centres), points)
    np.testing.assert_allclose(found[inside], field(points.positions)[inside], atol=0.01)


@pytest.mark.parametrize("scale", [1.0, 1e-4])
def test_geodesics_of_the_plane_are_straight(scale):
    plane = square(9)
    mesh = type(plane)(scale * plane.vertices, plane.faces)
    start = points_by_area(mesh, 300)
    vectors = scale * np.random.default_rng(0).uniform(-0.5, 0.5, (300, 3)) * [1, 1, 0]
    ends, inside = straightest_geodesics(mesh, start, vectors)
    expected = start.positions + vectors
    is_on = (expected[:, :2] > 0).all(axis=1) & (expected[:, :2] < scale).all(axis=1)
    np.testing.assert_array_equal(inside, is_on)
    assert 0.3 < inside.mean() < 0.9
    np.testing.assert_allclose(ends.positions[inside], expected[inside], atol=1e-8 * scale)
    np.testing.assert_allclose(ends.positions[~inside], start.positions[~inside], atol=1e-8 * scale)


def error_of_great_circles(level):
    mesh = icosphere(level)
    start = points_by_area(mesh, 300)
    begin = start.positions / np.linalg.norm(start.positions, axis=1, keepdims=True)
    everywhere = np.zeros((len(mesh.faces), 3))
    everywhere[start.faces] = np.cross(begin, [0.3, 0.5, 0.8])
    directions = tangential(mesh, everywhere)[start.faces]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    ends, inside = straightest_geodesics(mesh, start, 0.7 * directions)
    assert inside.all()
    expected = np.cos(0.7) * begin + np.sin(0.7) * directions
    return np.linalg.norm(ends.positions - expected, axis=1).max()


def test_geodesics_of_the_sphere_converge_to_great_circles():
    errors = [error_of_great_circles(level) for level in (2, 3, 4, 5)]
    assert errors[3] < 0.02
    assert errors[0] / errors[3] > 4


def test_geodesic_of_length_zero_ends_at_its_start():
    mesh = icosphere(1)
    start = SurfacePoints(mesh, np.array([3, 7]), np.array([[1.0, 0, 0], [0.2, 0.3, 0.5]]))
    ends, inside = straightest_geodesics(mesh, start, np.zeros((2, 3)))
    assert inside.all()
    np.testing.assert_allclose(ends.positions, start.positions, atol=1e-9)
