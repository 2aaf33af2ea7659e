"""What no flow can do: bounds that hold for anything that a flow could make of the source."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from abfm.matching.objective.matching_energy import MatchingEnergy
from abfm.matching.solvability import (
    different_peaks,
    distance,
    range_bound,
    source_is_constant,
    squeezed,
    stood_still,
    target_is_constant,
    vanished,
)
from abfm.matching.terms.functions import FunctionTerm
from abfm.parameters import Parameters
from abfm.types import FloatArray
from tests.core.fields import bump
from tests.shapes import icosphere, square

SPHERE = icosphere(2)
COUNT = len(SPHERE.vertices)
SEEDS = st.integers(0, 10**6)


def random_problem(seed: int) -> FunctionTerm:
    rng = np.random.default_rng(seed)
    source, target = rng.normal(size=(2, 2, COUNT)) * rng.uniform(0.1, 2, (2, 2, 1))
    mask = rng.integers(0, 2, COUNT) * rng.uniform(size=COUNT)
    return FunctionTerm(SPHERE, source.T, target.T, mask, rng.uniform(size=2))


def at(degrees: float, width: float = 0.15) -> FloatArray:
    """A Gaussian on the unit sphere, so far from the pole."""
    angle = np.deg2rad(degrees)
    return bump(SPHERE, [0, np.sin(angle), np.cos(angle)], width)


@given(SEEDS)
def test_the_mismatch_is_that_of_the_norms_and_the_solvers(seed):
    problem = random_problem(seed)
    energy = MatchingEnergy(
        SPHERE,
        problem.source.T,
        problem.target.T,
        Parameters(),
        mask=problem.mask,
        weights=problem.weights,
    )
    found = problem.relative_mismatch(problem.source)
    assert found == pytest.approx(energy.relative_mismatch(problem.source), rel=1e-12)
    assert found == pytest.approx(
        problem.norm(problem.source - problem.target) / problem.norm(problem.target), rel=1e-12
    )
    means = problem.source @ problem.areas / problem.areas.sum()
    assert problem.deviation(problem.source) == pytest.approx(
        problem.norm(problem.source - means[:, None]), rel=1e-12
    )


@given(SEEDS)
def test_nothing_with_the_sources_values_comes_below_the_bound(seed):
    """Values of the source in any order, or any between its least and largest, are all that a
    flow could give.
    """
    problem = random_problem(seed)
    rng = np.random.default_rng(seed)
    low, high = problem.source.min(axis=1, keepdims=True), problem.source.max(axis=1, keepdims=True)
    for made in (
        rng.permuted(problem.source, axis=1),
        rng.uniform(low, high, problem.source.shape),
    ):
        assert problem.relative_mismatch(made) >= range_bound(problem)
    assert problem.relative_mismatch(np.clip(problem.target, low, high)) == pytest.approx(
        range_bound(problem), rel=1e-12
    )


@given(SEEDS, st.floats(1e-3, 1e3), st.floats(1, 3))
def test_the_bound_ignores_units_and_falls_with_a_wider_source(seed, unit, wider):
    problem = random_problem(seed)
    scaled = FunctionTerm(
        SPHERE, unit * problem.source.T, unit * problem.target.T, problem.mask, problem.weights
    )
    assert range_bound(scaled) == pytest.approx(range_bound(problem), rel=1e-9)
    middle = (problem.source.min(axis=1) + problem.source.max(axis=1))[:, None] / 2
    wide = middle + wider * (problem.source - middle)
    richer = FunctionTerm(SPHERE, wide.T, problem.target.T, problem.mask, problem.weights)
    assert range_bound(richer) <= range_bound(problem) + 1e-12


def test_the_bound_of_known_functions():
    # as vertices do not sample both tops alike
    assert range_bound(FunctionTerm(SPHERE, at(0), at(40))) < 0.05
    assert range_bound(FunctionTerm(SPHERE, at(0) - at(180), 0.9 * at(0))) == 0
    constant = np.full(COUNT, 0.5)
    assert range_bound(FunctionTerm(SPHERE, constant, 2 * constant)) == pytest.approx(0.5)
    assert range_bound(FunctionTerm(SPHERE, constant, at(0))) == pytest.approx(
        FunctionTerm(SPHERE, constant, at(0)).relative_mismatch(constant[None])
    )


def test_only_what_counts_is_bounded():
    """Where the mask is 0, or in a channel of weight 0, the target may have any values."""
    source, target = at(0), at(0).copy()
    target[:5] = 9
    mask = np.ones(COUNT)
    mask[:5] = 0
    assert range_bound(FunctionTerm(SPHERE, source, target)) > 0.5
    assert range_bound(FunctionTerm(SPHERE, source, target, mask)) == 0
    both = FunctionTerm(
        SPHERE,
        np.stack([source, source], axis=1),
        np.stack([source, target], axis=1),
        None,
        [1.0, 0],
    )
    assert range_bound(both) == 0
    assert not source_is_constant(both)
    assert different_peaks(both) is None


def test_constants_are_those_that_count():
    flat = np.full(COUNT, 0.3)
    outside = flat.copy()
    outside[:5] = 1
    mask = np.ones(COUNT)
    mask[:5] = 0
    assert source_is_constant(FunctionTerm(SPHERE, flat, at(0)))
    # its values may come from anywhere
    assert not source_is_constant(FunctionTerm(SPHERE, outside, at(0), mask))
    assert target_is_constant(FunctionTerm(SPHERE, at(0), outside, mask))
    assert not target_is_constant(FunctionTerm(SPHERE, at(0), outside))


def test_what_vanished_and_what_stood_still():
    problem = FunctionTerm(SPHERE, at(0), at(90))
    assert vanished(problem, (0.01 * at(30) + 0.1)[None])
    assert not vanished(problem, (0.5 * at(30))[None])
    assert stood_still(problem, (at(0) + 0.01 * at(30))[None])
    assert not stood_still(problem, (at(20))[None])
    flat = FunctionTerm(SPHERE, at(0), 0.01 * at(90))
    assert not vanished(flat, (0.01 * at(30))[None])  # as the target has it


@given(st.floats(10, 80))
def test_the_distance_is_that_between_gaussians(degrees):
    mesh = square(20)
    here, there = [0.5, 0.3, 0], [0.5, 0.3 + degrees / 200, 0]
    problem = FunctionTerm(mesh, bump(mesh, here, 0.04), bump(mesh, there, 0.04))
    apart = degrees / 200
    overlap = 0.04 * 4 / apart  # what they share cancels, and leaves centres farther apart
    assert apart * 0.95 <= distance(problem) <= apart + 0.04 * overlap
    assert distance(problem) == distance(FunctionTerm(mesh, problem.target.T, problem.source.T))


def test_no_distance_where_nothing_is_too_much():
    assert distance(FunctionTerm(SPHERE, at(0), 2 * at(0))) == 0


def test_peaks_are_not_told_where_a_mask_hides_some():
    two = np.maximum(at(0, 0.1), at(120, 0.1))
    assert different_peaks(FunctionTerm(SPHERE, at(0, 0.1), two)) == (0, (1, 1), (2, 1))
    assert (
        different_peaks(
            FunctionTerm(SPHERE, at(0, 0.1), two, (SPHERE.vertices[:, 2] > 0).astype(float))
        )
        is None
    )
    second = FunctionTerm(SPHERE, np.stack([two, two], axis=1), np.stack([two, at(0, 0.1)], axis=1))
    assert different_peaks(second) == (1, (2, 1), (1, 1))


def test_squeezing_is_told_from_moving_by_which_of_them_lowers_the_mismatch():
    f, g = (bump(SPHERE, centre, 0.15) for centre in ([0.0, 0.0, 1.0], [0.0, 1.0, 0.0]))
    halfway = bump(SPHERE, [0.0, np.sqrt(0.5), np.sqrt(0.5)], 0.15)
    problem = FunctionTerm(SPHERE, f, g)
    assert squeezed(problem, 0.5 * f[None])
    assert not squeezed(problem, 0.8 * f[None])  # not yet
    assert not squeezed(problem, halfway[None])
    assert not squeezed(problem, 0.5 * g[None])  # it moved, and came smaller
    assert not squeezed(FunctionTerm(SPHERE, f, 0.4 * f), 0.5 * f[None])  # as the target is smaller
