"""The minimisation of one interval, compared with its linear problem."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from abfm.matching.objective.matching_energy import MatchingEnergy
from abfm.sequences import defaults
from abfm.sequences.frames import check_frames, interval_parameters
from abfm.sequences.noise import noise
from abfm.sequences.solving.interval import Interval, Neighbour, cooling
from tests.core.sequences.known_motions import SPHERE, rotating_pattern

RNG = np.random.default_rng(0)


def new_interval(sigma=0.5, neighbours=(), channels=1, duration=1.0):
    frames, _ = rotating_pattern(SPHERE, 0.08, 2)
    stacked = np.stack([frames, frames**2, 1 - frames][:channels], axis=-1)
    checked = check_frames(SPHERE, stacked, [0.0, duration], None, None)
    parameters = interval_parameters(checked, defaults(), sigma, 0)
    energy = MatchingEnergy(checked.problem(0, parameters))
    return Interval(energy, neighbours), parameters.last_sigma


def random_field(size=0.01):
    return size * RNG.standard_normal((len(SPHERE.faces), 2))


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("duration", [1.0, 0.05])
def test_hessian_is_that_of_the_linear_problem(channels, duration):
    """For frames that hardly differ, the Hessian at the zero field equals differences of slopes."""
    frames, _ = rotating_pattern(SPHERE, 1e-5, 2)
    stacked = np.stack([frames, frames**2, 1 - frames][:channels], axis=-1)
    checked = check_frames(SPHERE, stacked, [0.0, duration], None, None)
    parameters = interval_parameters(checked, defaults(), 0.5, 0)
    neighbours = [Neighbour(random_field(), 0.7)]
    interval = Interval(MatchingEnergy(checked.problem(0, parameters)), neighbours)
    sigma = parameters.last_sigma
    still = np.zeros((len(SPHERE.faces), 2))
    at = interval.minimise(sigma, still, 0).at
    hessian = interval._hessian(sigma, at)
    direction = random_field(1e-4)
    norm = interval.energy.regularizer()

    def slope(field):
        point = interval.minimise(sigma, field, 0)
        coupling = duration * 0.7 * norm.apply(field - neighbours[0].field)
        return point.at.gradient[0] + coupling

    change = (slope(direction) - slope(-direction)) / 2
    assert_allclose(hessian(direction), change, atol=3e-3 * np.abs(change).max())


def test_hessian_is_symmetric_and_positive():
    interval, sigma = new_interval()
    hessian = interval._hessian(sigma, interval.minimise(sigma, random_field(), 0).at)
    a, b = random_field(), random_field()
    assert (a * hessian(b)).sum() == pytest.approx((b * hessian(a)).sum(), rel=1e-9)
    assert (a * hessian(a)).sum() > 0


def test_steps_never_raise_the_energy():
    interval, sigma = new_interval(neighbours=[Neighbour(random_field(), 0.5)])
    point = interval.minimise(sigma, np.zeros((len(SPHERE.faces), 2)), 0)
    first = np.linalg.norm(point.at.gradient)
    energies = [point.energy]
    for _ in range(8):
        point = interval.minimise(sigma, point.field, 1)
        energies.append(point.energy)
    assert (np.diff(energies) <= 0).all()
    norm = interval.energy.regularizer()
    coupling = 0.5 * norm.apply(point.field - interval._neighbours[0].field)
    assert np.linalg.norm(point.at.gradient[0] + coupling) < 0.02 * first


def test_neighbour_of_large_weight_determines_the_field():
    expected = np.zeros((len(SPHERE.faces), 2))
    expected[:, 0] = 0.01
    interval, sigma = new_interval(neighbours=[Neighbour(expected, 1e7)])
    found = interval.minimise_by_cooling(sigma, 10 * sigma, None).field
    assert_allclose(found, expected, atol=1e-4)


def test_bad_starts_are_ignored():
    interval, sigma = new_interval()
    reference = interval.minimise_by_cooling(sigma, 9 * sigma, None)
    found = interval.minimise_by_cooling(sigma, 9 * sigma, random_field(10.0))
    assert found.energy == reference.energy


def test_cooling_ends_at_its_sigma():
    assert_allclose(cooling(1.0, 9.0), [9, 3, 1])
    assert cooling(1.0, 0.5) == [1.0]
    assert_allclose(cooling(1.0, 8.0), [3, 1])


@pytest.mark.parametrize("level", [0.01, 0.3, 5.0])
def test_noise_of_a_smooth_function_is_estimated(level):
    smooth = SPHERE.vertices[:, 0]
    found = noise(SPHERE, smooth + level * RNG.standard_normal((20, len(smooth))))
    assert found.shape == (20,)
    curvature = float(noise(SPHERE, smooth))  # curvature within single edges also counts as noise
    assert curvature < 0.01
    assert np.median(found) == pytest.approx(np.hypot(level, curvature), rel=0.12)
    assert noise(SPHERE, np.ones(len(smooth))) == pytest.approx(0, abs=1e-12)
