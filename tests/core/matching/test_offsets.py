"""A constant added to both functions has no effect on the residual and the match."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import abfm
from abfm import MatchingEnergy, Parameters, Problem
from abfm.matching.solvability import hardly_moved, is_measured, squeezed, value_gap
from abfm.matching.solving.measures import flow_line_measures
from abfm.outcome import Outcome
from tests.core.fields import bump
from tests.shapes import ellipsoid, icosphere

SPHERE, EGG = icosphere(3), ellipsoid(3, 1.0, 0.7, 0.55)
OFFSETS = [1e-3, 1.0, 2.0, 3.0, 100.0, 1e6]
RNG = np.random.default_rng(5)
PAIRS = {
    "bumps": (bump(SPHERE, [0, 0, 1], 0.13), bump(SPHERE, [0, 0.6, 0.8], 0.13)),
    "noise": (RNG.normal(size=len(SPHERE.vertices)), RNG.normal(size=len(SPHERE.vertices))),
    "channels": (RNG.normal(size=(len(SPHERE.vertices), 2)), SPHERE.vertices[:, :2]),
}


def measurements(f, g, mask):
    """Return all numbers and decisions that affect path and verdict, for a fixed field."""
    problem = Problem(SPHERE, f, g, Parameters(sigma=0.1), mask=mask)
    energy, functions = MatchingEnergy(problem), problem.functions
    x = 0.1 * np.random.default_rng(2).normal(size=energy.shape)
    found = energy.objective(problem.parameters.last_sigma).evaluate(x)
    advected = found.advected
    numbers = [
        found.energy,
        np.linalg.norm(found.gradient),
        functions.residual(advected),
        functions.residual(functions.source),
        functions.function_size,
        value_gap(functions),
        *flow_line_measures(energy, np.zeros((1, len(SPHERE.faces), 3))).values(),
    ]
    moved = squeezed(functions, advected), hardly_moved(functions, advected)
    decisions = [*moved, is_measured(functions)]
    return numbers, decisions


@pytest.mark.parametrize("offset", OFFSETS)
@pytest.mark.parametrize("name", PAIRS)
@pytest.mark.parametrize("mask", [None, (SPHERE.vertices[:, 0] > -0.5) * 1.0])
def test_offset_changes_no_measurement_of_a_field(offset, name, mask):
    f, g = PAIRS[name]
    numbers, decisions = measurements(f, g, mask)
    others, same = measurements(f + offset, g + offset, mask)
    assert decisions == same
    assert_allclose(others, numbers, rtol=1e-12 * max(offset, 1e4), atol=1e-15 * max(offset, 1e3))


@pytest.mark.parametrize("offset", OFFSETS)
def test_offset_changes_neither_path_nor_verdict(offset):
    """The match has few iterations, so that the growth of rounding errors is small."""
    f, g = (abfm.function(SPHERE, f"gaussian:vertex={v},width=0.13") for v in (1, 30))
    one, other = (abfm.match(SPHERE, f + c, g + c) for c in (0.0, offset))
    assert len(one.energy_history) < 150
    assert (other.verdict.kind, other.verdict.cause) == (one.verdict.kind, one.verdict.cause)
    assert other.facts.headline == one.facts.headline
    assert len(other.path) == len(one.path)
    for step, same in zip(one.path, other.path, strict=True):
        assert step.sigma == same.sigma
        assert same.residual == pytest.approx(step.residual, rel=2e-3)
    difference = np.linalg.norm(other.velocity - one.velocity) / np.linalg.norm(one.velocity)
    assert difference < 1e-3


def test_a_large_constant_hides_no_residual():
    """Relative to the norm of the target, as in the paper, almost any residual would be small."""
    f, g = (bump(EGG, place, 0.13) + 3 for place in ([1, 0, 0], [0, 0, 0.55]))
    unmoved = abfm.match(EGG, f, g, Parameters.of(iterations=0))
    assert unmoved.mismatch < 0.15
    assert unmoved.residual > 1
    assert unmoved.facts.outcome is Outcome.NOT_REACHED
    assert unmoved.facts.numbers["residual"] == unmoved.residual


def test_residual_is_relative_to_masked_deviation():
    f, g = PAIRS["bumps"]
    mask = np.where(SPHERE.vertices[:, 2] > 0, 1.0, 0.25)
    functions = Problem(SPHERE, f, g, mask=mask).functions
    mean = np.average(g, weights=functions.areas)
    varying = functions.norm(functions.target - mean)
    assert functions.residual(functions.source) == pytest.approx(
        functions.norm(functions.source - functions.target) / varying, rel=1e-12
    )
    # the residual of a constant with the mean of the target
    assert functions.residual(np.full_like(functions.target, mean)) == pytest.approx(1)


@pytest.mark.parametrize("constant", [0.0, 1.0, -3e5])
def test_a_constant_target_is_impossible(constant):
    flat = np.full(len(SPHERE.vertices), constant)
    for f in (PAIRS["bumps"][0], flat):
        found = abfm.match(SPHERE, f, flat, Parameters.of(iterations=2, refine=0))
        assert found.facts.outcome is Outcome.IMPOSSIBLE
        assert not found.facts.outcome.is_good
