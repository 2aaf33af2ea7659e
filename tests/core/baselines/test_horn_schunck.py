"""Linear optical flow: orders of convergence, exact cases, invariances and limits."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from abfm import AbfmError, TriangleMesh
from abfm.baselines import horn_schunck
from tests.core.sequences.known_motions import (
    SPHERE,
    coordinates,
    relative_field_error,
    rotating_pattern,
)
from tests.core.surfaces import last_order
from tests.messages import raises
from tests.shapes import icosphere, square


@pytest.mark.parametrize(
    ("wave", "smoothness", "order", "largest"),
    [(coordinates, 1e-4, 0.95, 0.003), (None, 1e-2, 0.65, 0.1)],
)
def test_errors_of_a_rotation_converge(wave, smoothness, order, largest):
    """The error converges; with one channel, smoothness alone fixes the part along contours."""
    errors = []
    for level in (2, 3, 4):
        mesh = icosphere(level)
        frames, expected = rotating_pattern(mesh, 0.01, 2, wave)
        field = horn_schunck(mesh, *frames, smoothness=smoothness)
        errors.append(relative_field_error(mesh, field, expected, frames[0]))
    assert last_order(errors) > order
    assert errors[2] < largest


def test_constant_field_on_a_flat_patch_is_exact():
    mesh = square(8)
    field = np.array([0.02, -0.03, 0.0])
    f = mesh.vertices[:, :2]
    g = f - field[:2]
    found = horn_schunck(mesh, f, g, smoothness=1.0)
    assert_allclose(found, np.tile(field, (len(mesh.faces), 1)), rtol=1e-5, atol=1e-8)


def test_smooth_fields_cross_an_edge_of_a_fold():
    """A fold does not change the field along the sheet, because transport unfolds faces."""
    x, y = np.mgrid[:9, :9].reshape(2, -1) / 8
    f = np.stack([x, y], axis=1)
    g = f - [0.02, -0.03]
    right = np.maximum(x - 0.5, 0.0)
    folded = TriangleMesh(np.stack([np.minimum(x, 0.5), y, right], axis=1), square(8).faces)
    found = horn_schunck(folded, f, g, smoothness=1.0)
    is_right = folded.vertices[folded.faces].mean(axis=1)[:, 2] > 0
    expected = np.where(is_right[:, None], [0.0, -0.03, 0.02], [0.02, -0.03, 0.0])
    assert_allclose(found, expected, rtol=1e-5, atol=1e-8)


def test_rotating_the_surface_rotates_the_field():
    frames, _ = rotating_pattern(SPHERE, 0.02, 2)
    turn = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    turned = TriangleMesh(SPHERE.vertices @ turn.T + 3, SPHERE.faces)
    expected = horn_schunck(SPHERE, *frames) @ turn.T
    assert_allclose(horn_schunck(turned, *frames), expected, rtol=1e-6, atol=1e-9)


def test_renumbering_vertices_changes_nothing():
    frames, _ = rotating_pattern(SPHERE, 0.02, 2)
    order = np.random.default_rng(1).permutation(len(SPHERE.vertices))
    other = TriangleMesh(SPHERE.vertices[order], np.argsort(order)[SPHERE.faces])
    found = horn_schunck(other, *frames[:, order])
    assert_allclose(found, horn_schunck(SPHERE, *frames), rtol=1e-6, atol=1e-9)


def test_large_rotations_are_not_found():
    errors = []
    for angle in (0.05, 1.2):
        frames, expected = rotating_pattern(SPHERE, angle, 2, coordinates)
        field = horn_schunck(SPHERE, *frames, smoothness=1e-6)
        errors.append(relative_field_error(SPHERE, field, expected, frames[0]))
    small, large = errors
    assert large > 2 * small


def test_units_and_constants_have_no_influence():
    frames, _ = rotating_pattern(SPHERE, 0.02, 2)
    usual = horn_schunck(SPHERE, *frames)
    large = TriangleMesh(50 * SPHERE.vertices, SPHERE.faces)
    assert_allclose(horn_schunck(large, *frames), 50 * usual, rtol=1e-6, atol=1e-9)
    assert_allclose(horn_schunck(SPHERE, *frames, 0.25), 4 * usual, rtol=1e-9)
    assert_allclose(horn_schunck(SPHERE, *(1e3 * frames - 5)), usual, rtol=1e-6, atol=1e-9)
    assert_allclose(horn_schunck(SPHERE, *frames[::-1]), -usual, rtol=1e-9, atol=1e-12)


def test_channels_add_up():
    frames, _ = rotating_pattern(SPHERE, 0.01, 2)
    one = horn_schunck(SPHERE, *frames, smoothness=0.1)
    twice = horn_schunck(SPHERE, *np.stack([frames, frames], axis=-1), smoothness=0.2)
    assert_allclose(twice, one, rtol=1e-4, atol=1e-7)


def test_still_frames_have_no_motion():
    f = SPHERE.vertices[:, 0]
    assert_allclose(horn_schunck(SPHERE, f, f), 0, atol=1e-15)
    assert_allclose(horn_schunck(SPHERE, 0 * f, 0 * f), 0, atol=1e-15)


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"duration": 0}, ("duration", 0)),
        ({"smoothness": np.nan}, ("smoothness",)),
        ({"g": np.zeros((642, 2))}, ()),
    ],
)
def test_bad_input_is_refused(given, named):
    values = {"f": np.zeros(642), "g": np.zeros(642)} | given
    with raises(AbfmError, *named):
        horn_schunck(SPHERE, **values)
