"""Sequences with known motion, and the baseline that is tuned by this motion."""

import numpy as np
import pytest

from abfm.flow.continuous_flow import ContinuousFlow
from benchmarks import textures, waves
from benchmarks.motion import compared, error_cells, sequences
from benchmarks.textures import Case, PlaneWaves, moving_texture
from tests.shapes import icosphere

BALL = icosphere(2)
EDGE = textures.edge_length(BALL)


def test_rotated_frames_follow_the_field():
    moving = moving_texture(BALL, "smooth", "rotation", 1.0)
    angle = np.linalg.norm(moving.field, axis=1).max()
    c, s = np.cos(angle), np.sin(angle)
    back = BALL.vertices @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    expected = PlaneWaves(20 * EDGE, 0).values(back)
    errors = np.abs(moving.frames[1] - expected).max()
    assert errors < 0.02 * np.ptp(expected)
    assert errors < 0.2 * (moving.frames[1] - moving.frames[0]).std()


@pytest.mark.parametrize("motion", textures.MOTIONS)
def test_size_of_field_is_displacement(motion):
    moving = moving_texture(BALL, "rough", motion, 0.5)
    sizes = np.linalg.norm(moving.field, axis=1)
    assert np.sqrt(np.mean(sizes**2)) == pytest.approx(0.5 * EDGE, rel=0.05)
    normals = BALL.vertices[BALL.faces].mean(axis=1)
    assert np.abs(np.einsum("fx,fx->f", moving.field, normals)).max() < 1e-12
    assert moving.errors(0, moving.field) == pytest.approx((0, 0), abs=1e-5)
    assert moving.errors(0, 2 * moving.field) == pytest.approx((0, 1), abs=1e-5)


def test_noise_has_its_standard_deviation():
    moving = moving_texture(icosphere(4), "rough", "rotation", 0.5)
    noise = moving.noisy(0.1, 5) - moving.frames
    assert noise.std() == pytest.approx(0.1 * moving.frames.std(), rel=0.05)


def test_gradients_are_those_of_values():
    wave, step = PlaneWaves(0.7, 3), 1e-6
    for k in range(3):
        change = np.zeros(3)
        change[k] = step
        ends = [wave.values(BALL.vertices + sign * change) for sign in (1, -1)]
        slopes = wave.gradients(BALL.vertices)[:, k]
        np.testing.assert_allclose((ends[0] - ends[1]) / (2 * step), slopes, atol=1e-6)


def test_defaults_beat_baseline_on_smooth_texture():
    row = Case("smooth", "rotation", 0.0, 1.0, 3).row()
    assert len(row) == len(textures.HEADINGS)
    assert row[0] == "642"
    words = row[5:11]
    assert "*" not in "".join(words)
    linear, old, new = (float(word[:-1]) for word in words[:3])
    assert new < 0.6 * linear
    assert new < 0.6 * old


def test_better_baseline_is_bold():
    errors = np.array([[2.0, 0.1], [3.0, 0.3], [2.5, 0.05]])
    assert error_cells(errors) == ["**2.0°**", "3.0°", "2.5°", "10.0%", "30.0%", "5.0%"]


@pytest.mark.parametrize("kind", waves.KINDS)
def test_fields_advect_the_waves(kind):
    mesh = icosphere(3)
    moving = waves.wave(mesh, kind, 1.0)
    assert len(moving.frames) == waves.FRAMES
    moved = ContinuousFlow(mesh, moving.field, 1.0).origins().pull_back(moving.frames[0])
    change = np.std(moving.frames[0] - moving.frames[1])
    assert np.std(moved - moving.frames[1]) < 0.2 * change


def test_fields_of_a_wave_are_compared():
    moving = waves.wave(icosphere(3), "travelling", 1.0)
    errors = compared(sequences(moving.mesh, moving.frames[:3]), moving.errors)
    assert errors.shape == (3, 2)
    assert (errors[1:] < [10, 0.1]).all()
