"""The choice of a view and the fit of the camera."""

from __future__ import annotations

import numpy as np
import pytest

from abfm import TriangleMesh
from abfm_viewer.scene.camera import FIELD_OF_VIEW, View, best_view, fitted
from tests.shapes import ellipsoid, icosphere, torus


def bump(mesh: TriangleMesh, place: list[float]) -> np.ndarray:
    """A function that is 1 at a place and falls fast away from it."""
    return np.exp(-20 * ((mesh.vertices - place) ** 2).sum(axis=1))


def projected(vertices, camera):
    """Horizontal and vertical place on a picture whose half height is 1, for points (n, 3)."""
    axes = np.stack([np.cross(camera.view.up, camera.view.direction), camera.view.up, camera.view.direction])
    x, y, z = axes @ (vertices - camera.position).T
    return np.stack([x, y]) / -z / np.tan(np.radians(FIELD_OF_VIEW / 2))


def test_a_view_shows_both_functions():
    sphere = icosphere(3)
    for places in ([[1, 0, 0], [0, 0, 1]], [[-1, 0, 0], [0, 0, -1]], [[0, 0, 1], [0, 0, 1]]):
        view = best_view(sphere, *(bump(sphere, place) for place in places))
        assert min(view.direction @ np.array(places).T) > 0.5


def test_a_view_without_functions_shows_the_broad_side():
    view = best_view(ellipsoid(3, 2, 1, 0.3))
    assert abs(view.direction[2]) > 0.95


def test_what_lies_flat_is_seen_from_above():
    standing = torus(24, 12, r=0.2)
    lying = TriangleMesh(standing.vertices[:, [0, 2, 1]], standing.faces[:, [0, 2, 1]])
    functions = [lying.vertices[:, 0], lying.vertices[:, 2]]
    assert best_view(lying, *functions).direction[1] > 0.8
    assert abs(best_view(standing, *functions).direction[1]) < 0.5


@pytest.mark.parametrize("up", ["x", "y", "z"])
def test_up_stays_up(up):
    mesh = ellipsoid(2, 1, 1.2, 0.8)
    view = best_view(mesh, bump(mesh, [0, 0, 0.8]), up=up)
    assert view.up["xyz".index(up)] > 0.85
    assert view.up @ view.direction == pytest.approx(0, abs=1e-12)
    assert np.linalg.norm([view.up, view.direction], axis=1) == pytest.approx(1)


@pytest.mark.parametrize("aspect", [None, 0.4, 3.0])
def test_the_camera_sees_everything_and_wastes_nothing(aspect):
    vertices = ellipsoid(3, 2, 1, 0.3).vertices + np.array([5, -3, 1])
    direction = np.array([0.6, 0, 0.8])
    camera = fitted(vertices, View(direction, np.array([0.0, 1, 0])), aspect, margin=0)
    x, y = np.abs(projected(vertices, camera))
    assert max(x.max() / camera.aspect, y.max()) == pytest.approx(1)
    if aspect is None:
        assert min(x.max() / camera.aspect, y.max()) > 0.8
