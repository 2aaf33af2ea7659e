import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from abfm.matching.solving.schedule import Schedule, Stage, Variant
from abfm.matching.terms.functions import FunctionTerm
from abfm.parameters import FIRST_SIGMA_MAX, LAST_SIGMA, PAPER, REACH_MAX, Parameters
from tests.core.fields import bump
from tests.shapes import icosphere

SPHERE = icosphere(3)
EXACT = FunctionTerm(SPHERE, bump(SPHERE, [0, 0, 1], 0.2), bump(SPHERE, [0, 1, 0], 0.2))
MEASURED = FunctionTerm(SPHERE, *np.random.default_rng(0).normal(size=(2, len(SPHERE.vertices))))
SIGMA, FACTOR = st.floats(1e-3, 1e3), st.floats(1.5, 20)


@given(SIGMA, FACTOR, st.sampled_from([EXACT, MEASURED]))
def test_given_sigma_is_the_last_one(sigma, factor, functions):
    given = Parameters.of(sigma=sigma, cooling_factor=factor)
    sigmas = Schedule(given, functions, 1).sigmas
    assert sigmas[-1] == sigma
    assert_allclose(np.divide(sigmas[:-1], sigmas[1:]), factor)
    assert sigmas[0] <= max(sigma, FIRST_SIGMA_MAX) * (1 + 1e-6)
    assert sigmas[0] * factor > FIRST_SIGMA_MAX
    size = functions.function_size
    absolute = given.with_values(sigma=sigma * size, sigma_unit="absolute")
    assert_allclose(Schedule(absolute, functions, 1).sigmas, np.multiply(sigmas, size))


@pytest.mark.parametrize("unit", ["relative", "absolute"])
@pytest.mark.parametrize(("functions", "power"), [(EXACT, 1), (MEASURED, 0.5)])
def test_automatic_sigmas_begin_at_the_largest_one(functions, power, unit):
    schedule = Schedule(Parameters.of(sigma_unit=unit), functions, 1)
    sigmas = np.divide(schedule.sigmas, 1 if unit == "relative" else functions.function_size)
    assert (sigmas[0], schedule.is_measured) == (FIRST_SIGMA_MAX, functions is MEASURED)
    assert_allclose(sigmas[:-1] / sigmas[1:], 3.0**power)
    assert LAST_SIGMA <= sigmas[-1] < LAST_SIGMA * 3.0**power


@given(SIGMA, FACTOR, st.integers(1, 8), st.integers(0, 2000))
def test_one_mesh_without_reach_has_schedule_of_the_paper(sigma, factor, count, iterations):
    cooling = {"sigma": sigma, "cooling_factor": factor, "cooling_stages": count}
    p = Parameters.of(**PAPER, **cooling, iterations=iterations)
    for functions in (EXACT, MEASURED):
        schedule = Schedule(p, functions, 1)
        stages = [schedule.stage(0, sigma, Variant(p.alpha, 1)) for sigma in schedule.sigmas]
        assert (schedule.sigmas, schedule.variants(1)) == (p.stage_sigmas(), [(p.alpha, 1)])
        assert [stage.iterations for stage in stages] == p.stage_limits()
        for stage in stages:
            assert (stage.reach, stage.goal, stage.until, stage.fixed) == (0, 0, iterations, True)
            assert stage.is_worthwhile([1.0] * 1000)


def test_fixed_stages_use_all_their_iterations():
    p = Parameters.of(stage_iterations=7, sigma=0.1)
    schedule = Schedule(p, EXACT, 3)
    *early, last = (schedule.stage(2, sigma, Variant(p.alpha, 1)) for sigma in schedule.sigmas)
    assert {stage.iterations for stage in early} == {7}
    assert last.iterations == p.solver.iterations
    assert all(stage.fixed and not stage.goal for stage in (*early, last))
    assert not Schedule(Parameters.of(stage_iterations=7), MEASURED, 1).is_measured


@pytest.mark.parametrize(
    ("changes", "functions", "other"),
    [
        ({}, EXACT, (0.01, 2)),
        ({}, MEASURED, (0.01 / 3, 1)),
        ({"sigma": 1.0}, EXACT, (0.01, 2)),
        ({"sigma": 1.0}, MEASURED, None),
        ({"alpha": 0.0}, MEASURED, None),
        ({"order": 1}, EXACT, (0.01, 2)),
        ({"order": 1}, MEASURED, None),
        ({"segments": 1}, EXACT, None),
        ({"segments": 1}, MEASURED, (0.01 / 3, 1)),
        ({"reach": 0.0}, EXACT, None),
        ({"stage_iterations": 5}, EXACT, None),
        ({"method": "linearised"}, EXACT, None),
    ],
)
def test_second_variant_has_two_fields_or_a_smaller_alpha(changes, functions, other):
    p = Parameters.of(**changes)
    first = (p.alpha, 1)
    variants = [first, other] if other else [first]
    assert_allclose(Schedule(p, functions, 1).variants(1), variants)
    assert Schedule(p, EXACT, 1).variants(2) == [(p.alpha, 2)]  # a start with two fields


def test_reach_is_maximal_after_a_failed_variant():
    """The reach grows only if sigma is automatic and the functions are exact."""
    schedule = Schedule(Parameters.of(reach=0.5), EXACT, 1)
    reaches = [schedule.reach(residual) for residual in (0.6, 0.9, np.inf)]
    assert reaches == [0.5, REACH_MAX, REACH_MAX]
    for p, functions in ((Parameters(), MEASURED), (Parameters(sigma=1.0), EXACT)):
        assert Schedule(p, functions, 1).reach(0.9) == 1.0


@given(st.integers(0, 1000), st.floats(0.01, 0.5), st.sampled_from([1, 2, 4]))
def test_stages_have_goals_and_iterations(iterations, goal, meshes):
    """Stages of exact functions end below the goal; a quarter of iterations is for the mesh."""
    p = Parameters.of(iterations=iterations, goal=goal)
    for level in range(meshes):
        stage = Schedule(p, EXACT, meshes).stage(level, 1.0, Variant(p.alpha, 1), p.solver.reach)
        assert 0 < stage.goal < goal
        assert stage.until == (iterations if level == meshes - 1 else int(0.75 * iterations))
    for schedule in (Schedule(p, MEASURED, 1), Schedule(replace(p, sigma=1.0), EXACT, 1)):
        assert schedule.stage(0, 1.0, Variant(p.alpha, 1)).goal == 0


def test_given_sigma_ends_coarse_levels_at_their_error():
    p = Parameters(sigma=0.1)
    schedule, variant = Schedule(p, EXACT, 2), Variant(p.alpha, 1)
    *early, last = schedule.sigmas
    for reach in (0.0, 1.0):
        coarse, fine = (schedule.stage(level, last, variant, reach, 0.2) for level in (0, 1))
        assert (coarse.goal, coarse.is_search) == (0.2, reach > 0)
        assert (fine.goal, fine.is_search) == (0.0, False)
        for other, sigma in (
            *((schedule, sigma) for sigma in early),
            (Schedule(p.with_values(stage_iterations=7), EXACT, 2), last),
            (Schedule(Parameters(), EXACT, 2), last),
            (Schedule(Parameters(), MEASURED, 2), last),
        ):
            stage = other.stage(0, sigma, variant, reach)
            assert other.stage(0, sigma, variant, reach, 0.2) == stage


def test_search_continues_while_the_residual_falls():
    """Until a search finds the target, its residual has to fall; in other stages, the energy."""
    stage = Stage(0, 1, 1.0, 1.0, 1.0, 100, 100, fixed=False, goal=0.0)
    search = replace(stage, is_search=True)
    falling = [0.9**k for k in range(40)]
    for residual, continues in ((0.8, True), (0.6, False)):
        assert search.is_worthwhile(falling, [residual] * 40) == continues
        assert search.is_worthwhile(falling[:5], [residual] * 5)
        assert stage.is_worthwhile(falling, [residual] * 40)
        assert replace(search, fixed=True).is_worthwhile(falling, [residual] * 40)
    assert search.is_worthwhile(falling, falling)
    assert not search.is_worthwhile([1.0] * 40, falling)


def test_stage_continues_while_its_energy_falls():
    stage = Stage(0, 1, 1.0, 1.0, 0.0, 100, 100, fixed=False, goal=0.0)
    falling, constant = [0.99**k for k in range(40)], [1.0] * 40
    assert stage.is_worthwhile(falling)
    assert not stage.is_worthwhile([0.998**k for k in range(40)])
    assert not stage.is_worthwhile(constant)
    assert stage.is_worthwhile(constant[:5])  # few iterations never end a stage
    assert replace(stage, fixed=True).is_worthwhile(constant)
    assert not stage.is_worthwhile([math.inf] * 40)


def test_curvature_is_valid_for_the_same_norm_and_mesh():
    stage = Stage(1, 1, 1.0, 1.0, 0.0, 100, 100, fixed=False, goal=0.0)
    smaller = replace(stage, sigma=0.1)
    assert smaller.continues(stage)
    assert not replace(smaller, fixed=True).continues(stage)
    for other in ({"level": 0}, {"fields": 2}, {"reach": 1.0}, {"alpha": 0.3}):
        assert not replace(stage, **other).continues(stage)
