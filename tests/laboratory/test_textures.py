"""Moving textures: the motion is exact, and the default norm is better than the tuned baseline."""

import numpy as np
import pytest

from laboratory import textures
from laboratory.common import mapped
from laboratory.motion import cells
from laboratory.textures import Case, MovingTexture, PlaneWaves
from tests.shapes import icosphere

BALL = icosphere(2)


def test_turning_frames_are_a_rotation():
    moving = MovingTexture(BALL, "smooth", "turn", 1.0, 0.0)
    angle = np.linalg.norm(moving.field, axis=1).max()
    c, s = np.cos(angle), np.sin(angle)
    back = BALL.vertices @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    expected = PlaneWaves(20 * moving.edge, 0).values(back)
    assert np.abs(moving.frames[1] - expected).max() < 0.02 * np.ptp(expected)
    rates = (moving.frames[1] - moving.frames[0]).std()
    assert np.abs(moving.frames[1] - expected).max() < 0.2 * rates


@pytest.mark.parametrize("motion", textures.MOTIONS)
def test_size_of_the_field_is_the_displacement(motion):
    moving = MovingTexture(BALL, "rough", motion, 0.5, 0.1)
    sizes = np.linalg.norm(moving.field, axis=1)
    assert np.sqrt(np.mean(sizes**2)) == pytest.approx(0.5 * moving.edge, rel=0.05)
    normals = BALL.vertices[BALL.faces].mean(axis=1)
    assert np.abs(np.einsum("fx,fx->f", moving.field, normals)).max() < 1e-12
    assert moving.errors(0, moving.field) == pytest.approx((0, 0), abs=1e-5)
    assert moving.errors(0, 2 * moving.field) == pytest.approx((0, 1), abs=1e-5)


def test_gradients_are_those_of_the_values():
    wave, step = PlaneWaves(0.7, 3), 1e-6
    for k in range(3):
        change = np.zeros(3)
        change[k] = step
        ends = [wave.values(BALL.vertices + sign * change) for sign in (1, -1)]
        slopes = wave.gradients(BALL.vertices)[:, k]
        np.testing.assert_allclose((ends[0] - ends[1]) / (2 * step), slopes, atol=1e-6)


def test_default_beats_the_tuned_baseline_and_order_1_on_a_smooth_texture():
    row = Case("smooth", "turn", 0.0, 1.0, 3).row()
    assert row[0] == "642"
    words = row[5:11]
    assert "*" not in "".join(words)
    linear, old, new = (float(word[:-1]) for word in words[:3])
    assert new < 0.6 * linear
    assert new < 0.6 * old


def test_errors_of_a_better_baseline_are_bold():
    errors = np.array([[2.0, 0.1], [3.0, 0.3], [2.5, 0.05]])
    assert cells(errors) == ["**2.0°**", "3.0°", "2.5°", "10.0%", "30.0%", "5.0%"]


@pytest.mark.parametrize("jobs", [1, 2])
def test_mapped_keeps_the_order(jobs):
    assert list(mapped(abs, [-3, 1, -2], jobs)) == [3, 1, 2]
