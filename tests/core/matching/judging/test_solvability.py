"""What no flow can do: bounds that hold for anything that a flow could make of the source."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from abfm.matching.energy.energy import MatchingEnergy
from abfm.matching.judging.solvability import Problem, range_bound
from abfm.parameters import Parameters
from abfm.types import FloatArray
from tests.core.fields import bump
from tests.shapes import icosphere, square

SPHERE = icosphere(2)
COUNT = len(SPHERE.vertices)
SEEDS = st.integers(0, 10**6)


def random_problem(seed: int, channels: int = 2) -> Problem:
    rng = np.random.default_rng(seed)
    source, target = rng.normal(size=(2, channels, COUNT)) * rng.uniform(0.1, 2, (2, channels, 1))
    mask = rng.integers(0, 2, COUNT) * rng.uniform(size=COUNT)
    return Problem(SPHERE, source, target, mask, rng.uniform(size=channels))


def at(degrees: float, width: float = 0.15) -> FloatArray:
    """A Gaussian on the unit sphere, so far from the pole, as one channel."""
    angle = np.deg2rad(degrees)
    return bump(SPHERE, [0, np.sin(angle), np.cos(angle)], width)[None]


@given(SEEDS)
def test_the_mismatch_is_the_solvers(seed):
    problem = random_problem(seed)
    energy = MatchingEnergy(
        SPHERE, problem.source.T, problem.target.T, Parameters(), mask=problem.mask, weights=problem.weights
    )
    assert problem.mismatch(problem.source) == pytest.approx(energy.relative_mismatch(problem.source), rel=1e-12)


@given(SEEDS)
def test_nothing_with_the_sources_values_comes_below_the_bound(seed):
    """Values of the source in any order, or any between its least and largest, are all that a flow could give."""
    problem = random_problem(seed)
    rng = np.random.default_rng(seed)
    low, high = problem.source.min(axis=1, keepdims=True), problem.source.max(axis=1, keepdims=True)
    for made in (rng.permuted(problem.source, axis=1), rng.uniform(low, high, problem.source.shape)):
        assert problem.mismatch(made) >= range_bound(problem)
    assert problem.mismatch(np.clip(problem.target, low, high)) == pytest.approx(range_bound(problem), rel=1e-12)


@given(SEEDS, st.floats(1e-3, 1e3), st.floats(1, 3))
def test_the_bound_ignores_units_and_falls_with_a_wider_source(seed, unit, wider):
    problem = random_problem(seed)
    scaled = Problem(SPHERE, unit * problem.source, unit * problem.target, problem.mask, problem.weights)
    assert range_bound(scaled) == pytest.approx(range_bound(problem), rel=1e-9)
    middle = (problem.source.min(axis=1) + problem.source.max(axis=1))[:, None] / 2
    richer = Problem(SPHERE, middle + wider * (problem.source - middle), problem.target, problem.mask, problem.weights)
    assert range_bound(richer) <= range_bound(problem) + 1e-12


def test_the_bound_of_known_functions():
    assert range_bound(Problem(SPHERE, at(0), at(40))) < 0.05  # as vertices do not sample both tops alike
    assert range_bound(Problem(SPHERE, at(0) - at(180), 0.9 * at(0))) == 0
    constant = np.full((1, COUNT), 0.5)
    assert range_bound(Problem(SPHERE, constant, 2 * constant)) == pytest.approx(0.5)
    assert range_bound(Problem(SPHERE, constant, at(0))) == pytest.approx(
        Problem(SPHERE, constant, at(0)).mismatch(constant)
    )


def test_only_what_counts_is_bounded():
    """Where the mask is 0, or in a channel of weight 0, the target may have any values."""
    source, target = at(0), at(0).copy()
    target[0, :5] = 9
    mask = np.ones(COUNT)
    mask[:5] = 0
    assert range_bound(Problem(SPHERE, source, target)) > 0.5
    assert range_bound(Problem(SPHERE, source, target, mask)) == 0
    both = Problem(SPHERE, np.stack([source[0], source[0]]), np.stack([source[0], target[0]]), None, np.array([1.0, 0]))
    assert range_bound(both) == 0
    assert not both.source_is_constant()
    assert both.different_peaks() is None


def test_constants_are_those_that_count():
    flat = np.full((1, COUNT), 0.3)
    outside = flat.copy()
    outside[0, :5] = 1
    mask = np.ones(COUNT)
    mask[:5] = 0
    assert Problem(SPHERE, flat, at(0)).source_is_constant()
    assert not Problem(SPHERE, outside, at(0), mask).source_is_constant()  # its values may come from anywhere
    assert Problem(SPHERE, at(0), outside, mask).target_is_constant()
    assert not Problem(SPHERE, at(0), outside).target_is_constant()


def test_what_vanished_and_what_stood_still():
    problem = Problem(SPHERE, at(0), at(90))
    assert problem.vanished(0.01 * at(30) + 0.1)
    assert not problem.vanished(0.5 * at(30))
    assert problem.stood_still(at(0) + 0.01 * at(30))
    assert not problem.stood_still(at(20))
    flat = Problem(SPHERE, at(0), 0.01 * at(90))
    assert not flat.vanished(0.01 * at(30))  # as the target has it


@given(st.floats(10, 80))
def test_the_distance_is_that_between_gaussians(degrees):
    mesh = square(20)
    here, there = [0.5, 0.3, 0], [0.5, 0.3 + degrees / 200, 0]
    problem = Problem(mesh, bump(mesh, here, 0.04)[None], bump(mesh, there, 0.04)[None])
    apart = degrees / 200
    overlap = 0.04 * 4 / apart  # what they share cancels, and leaves centres farther apart
    assert apart * 0.95 <= problem.distance() <= apart + 0.04 * overlap
    assert problem.distance() == Problem(mesh, problem.target, problem.source).distance()


def test_no_distance_where_nothing_is_too_much():
    assert Problem(SPHERE, at(0), 2 * at(0)).distance() == 0


def test_peaks_are_not_told_where_a_mask_hides_some():
    two = np.maximum(at(0, 0.1), at(120, 0.1))
    assert Problem(SPHERE, at(0, 0.1), two).different_peaks() == (0, (1, 1), (2, 1))
    assert Problem(SPHERE, at(0, 0.1), two, (SPHERE.vertices[:, 2] > 0).astype(float)).different_peaks() is None
    second = Problem(SPHERE, np.stack([two[0], two[0]]), np.stack([two[0], at(0, 0.1)[0]]))
    assert second.different_peaks() == (1, (2, 1), (1, 1))
