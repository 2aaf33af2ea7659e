"""The sample of frames: waves with known velocities."""

import numpy as np

import abfm
from abfm_viewer.window.wave import drifting_wave, turning_wave
from tests.viewer.sessions import EGG


def test_waves_have_the_given_velocities():
    directions = EGG.vertices / np.linalg.norm(EGG.vertices, axis=1)[:, None]
    times, step = np.array([0.3, 0.3 + 1e-6]), 1e-6
    frames, axes = turning_wave(directions, times)
    moved = directions - step * np.cross(axes[0], directions)  # origins of the values at each place
    moved /= np.linalg.norm(moved, axis=1)[:, None]
    back = turning_wave(moved, times[:1])[0][0]
    np.testing.assert_allclose((frames[1] - frames[0]) / step, (back - frames[0]) / step, atol=1e-3)
    mesh = abfm.load_mesh(abfm.assets.asset_path("eight.off"))
    frames, field = drifting_wave(mesh, np.array([0.0, 0.1]))
    np.testing.assert_allclose(abfm.advect(mesh, field, frames[0], 0.1), frames[1], atol=1e-9)
    *others, harmonic = abfm.calculus.helmholtz_hodge(mesh, field)
    np.testing.assert_allclose(harmonic, field, atol=1e-9)
    np.testing.assert_allclose(others, 0, atol=1e-9)
