"""Layouts on the sphere and maps between them."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from abfm.errors import AbfmError
from abfm.maps.spherical import SphereLayout, is_sphere, map_through_sphere, sphere_directions
from abfm.mesh.shapes import even_sphere
from tests.core.surfaces import random_points
from tests.messages import raises
from tests.shapes import ellipsoid, icosphere, square, torus

BALL, EVEN_BALL = icosphere(3), even_sphere(700)


@pytest.mark.parametrize("mirror", [1, -1])
def test_directions_and_points_are_inverse(mirror):
    turned = Rotation.random(rng=3).apply(EVEN_BALL.vertices.copy()) * [mirror, 1, 1]
    layout = SphereLayout(EVEN_BALL, turned)
    assert layout.sign == mirror
    points = random_points(EVEN_BALL)
    found = layout.locate(layout.directions_of(points))
    assert_allclose(found.positions, points.positions, atol=1e-13)
    directions = np.random.default_rng(1).normal(size=(500, 3))
    returned = layout.directions_of(layout.locate(directions))
    assert_allclose(returned, directions / np.linalg.norm(directions, axis=1)[:, None], atol=1e-13)


def test_map_of_two_layouts_has_an_exact_inverse():
    one, other = SphereLayout(BALL, BALL.vertices), SphereLayout(EVEN_BALL, EVEN_BALL.vertices)
    to_other, to_ball = map_through_sphere(one, other), map_through_sphere(other, one)
    points = random_points(BALL)
    assert_allclose(to_ball.at(to_other.at(points)).positions, points.positions, atol=1e-12)
    assert to_other.distortion().folded == 0
    h = BALL.vertices @ [1.0, 2, 3]
    # linear interpolation on two meshes differs by about the squared edge length
    assert np.abs(to_ball.pull_back(h) - EVEN_BALL.vertices @ [1.0, 2, 3]).max() < 0.03


def test_directions_are_those_of_moved_spheres():
    moved = type(BALL)(7 * BALL.vertices + [100, 0, -3], BALL.faces)
    assert_allclose(sphere_directions(moved), BALL.vertices, atol=1e-10)
    sphere_directions(moved)[:] = 0  # the layout itself is unchanged
    assert_allclose(sphere_directions(moved), BALL.vertices, atol=1e-10)


@pytest.mark.parametrize(("mesh"), [(ellipsoid(2, 1, 1, 1.2)), (torus(12, 8)), (square(4))])
def test_other_meshes_are_refused(mesh):
    assert not is_sphere(mesh)
    with raises(AbfmError):
        sphere_directions(mesh)


def test_sphere_with_a_hole_is_a_layout_only():
    cap = BALL.vertices[BALL.faces].mean(axis=1)[:, 2] < 0.8
    open_ball = type(BALL)(BALL.vertices, BALL.faces[cap])
    assert not is_sphere(open_ball)
    layout = SphereLayout(open_ball, open_ball.vertices)
    points = random_points(open_ball)
    found = layout.locate(layout.directions_of(points))
    assert_allclose(found.positions, points.positions, atol=1e-12)
    edge = layout.locate([[0, 0, 1.0], [0.1, 0, 1]])
    assert np.linalg.norm(edge.positions - [0, 0, 1], axis=1).max() < 0.75


@pytest.mark.parametrize("power", [1, 4])
def test_directions_in_a_hole_give_the_nearest_boundary(power):
    """Around the hole, 0.2 wide, faces are small; elsewhere they are large."""
    angles = np.arccos(np.clip(BALL.vertices[:, 2], -1, 1))
    polar = np.pi * (angles / np.pi) ** power
    around = np.arctan2(BALL.vertices[:, 1], BALL.vertices[:, 0])
    stretched = np.stack(
        [np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], axis=1
    )
    remaining = (polar[BALL.faces] > 0.2).all(axis=1)
    open_ball = type(BALL)(stretched, BALL.faces[remaining])
    layout = SphereLayout(open_ball, open_ball.vertices)
    edge = open_ball.vertices[open_ball.is_boundary_vertex]
    directions = np.random.default_rng(0).normal(size=(300, 3)) * [0.03, 0.03, 0] + [0, 0, 1]
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    found = layout.directions_of(layout.locate(directions))
    nearest = np.linalg.norm(directions[:, None] - edge, axis=2).min(axis=1)
    assert (np.linalg.norm(found - directions, axis=1) <= nearest * (1 + 1e-3)).all()


@pytest.mark.parametrize(
    ("directions", "named"),
    [
        (EVEN_BALL.vertices, 642),
        (np.zeros((642, 3)), ""),
        (np.full((642, 3), np.nan), ""),
        (np.random.default_rng(0).normal(size=(642, 3)), ""),
    ],
)
def test_invalid_layouts_are_refused(directions, named):
    with raises(AbfmError, named):
        SphereLayout(BALL, directions)


def test_flipped_faces_are_reported():
    vertex = 5
    ring = np.unique(BALL.faces[(BALL.faces == vertex).any(axis=1)])
    far = 2 * BALL.vertices[ring].mean(axis=0) - 1.0 * BALL.vertices[vertex]
    moved = BALL.vertices.copy()
    moved[vertex] = BALL.vertices[ring[ring != vertex][0]] * 1.5 - 0.5 * far
    layout = SphereLayout(BALL, moved)
    assert 0 < len(layout.folded) < 6
    directions = np.random.default_rng(1).normal(size=(2000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    found = layout.directions_of(layout.locate(directions))
    assert_allclose(found, directions, atol=1e-12)
