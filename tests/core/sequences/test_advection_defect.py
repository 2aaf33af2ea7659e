"""What the discrete flow carries less far than flow lines do."""

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
from tests.core.sequences.films import SPHERE, turning
from tests.shapes import icosphere


def test_quadratic_functions_are_exact_where_slopes_are():
    """On a regular grid, away from its boundary."""
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
    wanted = [a**2 - 3 * a * b, b**2 + 2 * b - a, np.ones_like(a)]
    assert_allclose(quadratic_values(points, functions), wanted, atol=1e-12)
    assert np.abs(points.pull_back(functions.T).T - wanted).max() > 1e-3


def test_on_a_curved_surface_it_is_closer_than_linear():
    points = points_by_area(SPHERE, 500)
    places = points.positions / np.linalg.norm(points.positions, axis=1)[:, None]
    f, wanted = (np.sin(3 * p[:, 0]) * p[:, 2] for p in (SPHERE.vertices, places))
    found = quadratic_values(points, f[None]), points.pull_back(f)
    off, off_by_linear = (np.abs(values - wanted).mean() for values in found)
    assert off < 0.3 * off_by_linear


def energy_of(frames):
    film = check_frames(SPHERE, frames, None, None, None)
    return MatchingEnergy(film.problem(0, interval_parameters(film, defaults(), 0.3, 0)))


def test_nothing_lags_behind_that_does_not_move_or_has_no_flow_lines():
    energy = energy_of(turning(SPHERE, 0.1, 2)[0])
    still = np.zeros((len(SPHERE.faces), 2))
    assert_allclose(advection_defect(energy, still), 0, atol=1e-10)
    assert_array_equal(advection_defect(energy, still + 1e9), 0)


def test_it_is_linear_in_the_functions():
    frames, _ = turning(SPHERE, 0.3, 2)
    field = np.random.default_rng(0).standard_normal((len(SPHERE.faces), 2))
    first, noise = frames[0], np.random.default_rng(1).standard_normal(frames.shape[1])
    one, other, both = (
        advection_defect(energy_of([f, frames[1]]), 0.2 * field)
        for f in (first, noise, first + 3 * noise)
    )
    assert_allclose(both, one + 3 * other, atol=1e-12)


@pytest.fixture
def wave():
    """Four waves around a sphere, of ten edges each: frames, field, and where it is steep."""
    mesh = icosphere(3)

    def four(p):
        return np.cos(4 * np.arctan2(p[:, 1], p[:, 0])) * (1 - p[:, 2] ** 2) ** 2

    frames, wanted = turning(mesh, 0.3, 3, four)
    slopes = np.linalg.norm((gradient(mesh) @ frames[0]).reshape(-1, 2), axis=1)
    return mesh, frames, wanted, slopes > 0.5 * np.sqrt(face_areas(mesh) @ slopes**2)


def test_without_it_a_wave_is_found_too_fast(wave, monkeypatch):
    mesh, frames, wanted, told = wave

    def solved():
        found = abfm.sequence(mesh, frames, parameters=defaults(sigma=0.03))
        along = (found.velocity * wanted).sum(axis=2) / (wanted**2).sum(axis=1)
        return np.median(along[:, told]) - 1, found.verified_residual.max()

    too_fast, left = solved()
    monkeypatch.setattr(
        solve, "advection_defect", lambda energy, field: 0 * energy.functions.source
    )
    too_fast_before, left_before = solved()
    assert too_fast_before > 0.05
    assert abs(too_fast) < 0.3 * too_fast_before
    assert left < 0.7 * left_before
