"""The choice of a view and the fit of the camera."""

from __future__ import annotations

import numpy as np
import pytest

from abfm import TriangleMesh, load_mesh
from abfm.assets import asset_path
from abfm_viewer.computing.defaults import best_front
from abfm_viewer.document.document import Front
from abfm_viewer.scene.camera import fitted
from tests.shapes import ellipsoid, icosphere, torus


def bump(mesh: TriangleMesh, place: list[float]) -> np.ndarray:
    """A function that is 1 at a place and falls fast away from it."""
    return np.exp(-20 * ((mesh.vertices - place) ** 2).sum(axis=1))


def projected(vertices, camera):
    """Horizontal and vertical place on a picture whose half height is 1, for points (n, 3)."""
    x, y, z = camera.front.axes @ (vertices - camera.position).T
    return np.stack([x, y]) / -z / np.tan(np.radians(camera.angle / 2))


def test_a_view_shows_both_functions():
    sphere = icosphere(3)
    for places in ([[1, 0, 0], [0, 0, 1]], [[-1, 0, 0], [0, 0, -1]], [[0, 0, 1], [0, 0, 1]]):
        front = best_front(sphere, *(bump(sphere, place) for place in places))
        assert min(np.array(places) @ front.direction) > 0.5


def test_a_surface_that_is_inside_out_is_seen_like_any_other():
    sphere = icosphere(3)
    functions = [bump(sphere, [1, 0, 0]), bump(sphere, [0, 0, 1])]
    assert best_front(
        TriangleMesh(sphere.vertices, sphere.faces[:, ::-1]), *functions
    ) == best_front(sphere, *functions)


def test_a_view_without_functions_shows_the_broad_side():
    front = best_front(ellipsoid(3, 2, 1, 0.3))
    assert abs(front.direction[2]) > 0.95


def test_a_closed_surface_without_functions_is_seen_from_its_face():
    """As much of it is seen from behind; where right and left show alike, it is always the same
    of them.
    """
    body = load_mesh(asset_path("human_A.off"))
    front = best_front(body)
    assert front.direction[2] > 0.9
    for turned in np.diag([-1.0, 1.0, -1.0]), np.diag([-1.0, 1.0, 1.0]):
        faces = body.faces if np.linalg.det(turned) > 0 else body.faces[:, ::-1]
        assert best_front(TriangleMesh(1e3 * body.vertices @ turned, faces)).direction[2] > 0.9
    shuffled = TriangleMesh(
        1e3 * body.vertices, body.faces[np.random.default_rng(0).permutation(len(body.faces))]
    )
    assert best_front(shuffled) == front


def test_what_lies_flat_is_seen_from_above():
    standing = torus(24, 12, r=0.2)
    lying = TriangleMesh(standing.vertices[:, [0, 2, 1]], standing.faces[:, [0, 2, 1]])
    functions = [lying.vertices[:, 0], lying.vertices[:, 2]]
    assert best_front(lying, *functions).direction[1] > 0.8
    assert abs(best_front(standing, *functions).direction[1]) < 0.5


@pytest.mark.parametrize("up", ["x", "y", "z"])
def test_up_stays_up(up):
    mesh = ellipsoid(2, 1, 1.2, 0.8)
    front = best_front(mesh, bump(mesh, [0, 0, 0.8]), up=up)
    assert front.up["xyz".index(up)] > 0.85
    assert np.dot(front.up, front.direction) == pytest.approx(0, abs=1e-12)
    assert np.linalg.norm([front.up, front.direction], axis=1) == pytest.approx(1)


@pytest.mark.parametrize("aspect", [None, 0.4, 3.0])
def test_the_camera_sees_everything_and_wastes_nothing(aspect):
    vertices = ellipsoid(3, 2, 1, 0.3).vertices + np.array([5, -3, 1])
    camera = fitted(
        vertices, Front((0.6, 0.0, 0.8), (0.0, 1.0, 0.0)), aspect, angle=18.0, margin=0.0
    )
    x, y = np.abs(projected(vertices, camera))
    assert max(x.max() / camera.aspect, y.max()) == pytest.approx(1)
    if aspect is None:
        assert min(x.max() / camera.aspect, y.max()) > 0.8
