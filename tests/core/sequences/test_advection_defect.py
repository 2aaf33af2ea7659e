"""The difference between the discrete flow and flow lines."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import abfm
from abfm.calculus.operators import face_areas, gradient
from abfm.maps.surface_points import SurfacePoints, points_by_area
from abfm.matching.objective.matching_energy import MatchingEnergy
from abfm.sequences import defaults
from abfm.sequences.frames import check_frames, interval_parameters
from abfm.sequences.solving import solve
from abfm.sequences.solving.advection_defect import advection_defect, quadratic_values
from tests.core.sequences.known_motions import SPHERE, rotating_pattern
from tests.shapes import icosphere


def test_quadratic_functions_are_exact():
    x, y = np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 9), indexing="ij")
    x, y, corner = x.ravel(), y.ravel(), np.arange(81).reshape(9, 9)
    a, b, c, d = (
        part.ravel()
        for part in (corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:])
    )
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    mesh = abfm.TriangleMesh(np.stack([x, y, 0 * x], axis=1), faces)
    inner = (np.abs(mesh.vertices[:, :2] - 0.5) < 0.4).all(axis=1)
    faces = np.flatnonzero(inner[mesh.faces].all(axis=1))
    weights = np.random.default_rng(0).dirichlet([1, 1, 1], len(faces))
    points = SurfacePoints(mesh, faces, weights)
    functions = np.array([x**2 - 3 * x * y, y**2 + 2 * y - x, np.ones_like(x)])
    a, b = points.positions[:, :2].T
    expected = [a**2 - 3 * a * b, b**2 + 2 * b - a, np.ones_like(a)]
    assert_allclose(quadratic_values(points, functions), expected, atol=1e-12)
    assert np.abs(points.pull_back(functions.T).T - expected).max() > 1e-3


def test_quadratic_values_beat_linear_ones_on_a_sphere():
    points = points_by_area(SPHERE, 500)
    places = points.positions / np.linalg.norm(points.positions, axis=1)[:, None]
    f, expected = (np.sin(3 * p[:, 0]) * p[:, 2] for p in (SPHERE.vertices, places))
    found = quadratic_values(points, f[None]), points.pull_back(f)
    off, off_by_linear = (np.abs(values - expected).mean() for values in found)
    assert off < 0.3 * off_by_linear


def energy_of(frames):
    checked = check_frames(SPHERE, frames, None, None, None)
    return MatchingEnergy(checked.problem(0, interval_parameters(checked, defaults(), 0.3, 0)))


def test_zero_and_extreme_fields_have_no_defect():
    energy = energy_of(rotating_pattern(SPHERE, 0.1, 2)[0])
    still = np.zeros((len(SPHERE.faces), 2))
    assert_allclose(advection_defect(energy, still), 0, atol=1e-10)
    assert_array_equal(advection_defect(energy, still + 1e9), 0)


def test_defect_is_linear_in_the_functions():
    frames, _ = rotating_pattern(SPHERE, 0.3, 2)
    field = np.random.default_rng(0).standard_normal((len(SPHERE.faces), 2))
    first, noise = frames[0], np.random.default_rng(1).standard_normal(frames.shape[1])
    one, other, both = (
        advection_defect(energy_of([f, frames[1]]), 0.2 * field)
        for f in (first, noise, first + 3 * noise)
    )
    assert_allclose(both, one + 3 * other, atol=1e-12)


@pytest.fixture
def wave():
    """Return frames of four waves around a sphere, of ten edges each, field and steep faces."""
    mesh = icosphere(3)

    def four(p):
        return np.cos(4 * np.arctan2(p[:, 1], p[:, 0])) * (1 - p[:, 2] ** 2) ** 2

    frames, expected = rotating_pattern(mesh, 0.3, 3, four)
    slopes = np.linalg.norm((gradient(mesh) @ frames[0]).reshape(-1, 2), axis=1)
    return mesh, frames, expected, slopes > 0.5 * np.sqrt(face_areas(mesh) @ slopes**2)


def test_without_correction_waves_are_too_fast(wave, monkeypatch):
    mesh, frames, expected, steep = wave

    def solved():
        found = abfm.sequence(mesh, frames, parameters=defaults(sigma=0.03))
        along = (found.velocity * expected).sum(axis=2) / (expected**2).sum(axis=1)
        return np.median(along[:, steep]) - 1, found.verified_residual.max()

    too_fast, residual = solved()
    monkeypatch.setattr(
        solve, "advection_defect", lambda energy, field: 0 * energy.functions.source
    )
    too_fast_before, residual_before = solved()
    assert too_fast_before > 0.05
    assert abs(too_fast) < 0.3 * too_fast_before
    assert residual < 0.7 * residual_before
