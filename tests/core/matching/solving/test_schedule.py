"""The schedule of a match: its sigmas, ways and stages; the paper's where that is asked for."""

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
def test_a_given_sigma_is_the_last_and_multiples_of_it_lead_there(sigma, factor, functions):
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
def test_without_one_they_fall_from_the_warmest_more_slowly_for_measured_functions(
    functions, power, unit
):
    schedule = Schedule(Parameters.of(sigma_unit=unit), functions, 1)
    sigmas = np.divide(schedule.sigmas, 1 if unit == "relative" else functions.function_size)
    assert (sigmas[0], schedule.is_measured) == (FIRST_SIGMA_MAX, functions is MEASURED)
    assert_allclose(sigmas[:-1] / sigmas[1:], 3.0**power)
    assert LAST_SIGMA <= sigmas[-1] < LAST_SIGMA * 3.0**power


@given(SIGMA, FACTOR, st.integers(1, 8), st.integers(0, 2000))
def test_without_reach_on_one_mesh_the_course_is_the_papers(sigma, factor, count, iterations):
    """Every sigma from the largest to its value, each early one with its share."""
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


def test_fixed_numbers_of_iterations_are_kept_and_no_stage_ends_before():
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
def test_there_is_a_second_way_with_two_fields_or_for_measured_functions_a_third_of_alpha(
    changes, functions, other
):
    p = Parameters.of(**changes)
    first = (p.alpha, 1)
    ways = [first, other] if other else [first]
    assert_allclose(Schedule(p, functions, 1).variants(1), ways)
    assert Schedule(p, EXACT, 1).variants(2) == [(p.alpha, 2)]  # as a start has them


def test_after_a_way_that_did_not_find_the_target_the_next_one_looks_as_far_as_there_is():
    schedule = Schedule(Parameters.of(reach=0.5), EXACT, 1)
    assert [schedule.reach(left) for left in (0.6, 0.9, np.inf)] == [0.5, REACH_MAX, REACH_MAX]
    for schedule in (
        Schedule(Parameters(), MEASURED, 1),
        Schedule(Parameters(sigma=1.0), EXACT, 1),
    ):
        assert schedule.reach(0.9) == 1.0


@given(st.integers(0, 1000), st.floats(0.01, 0.5), st.sampled_from([1, 2, 4]))
def test_exact_functions_end_below_the_goal_and_a_quarter_of_the_time_is_for_the_mesh_itself(
    iterations, goal, meshes
):
    p = Parameters.of(iterations=iterations, goal=goal)
    for level in range(meshes):
        stage = Schedule(p, EXACT, meshes).stage(level, 1.0, Variant(p.alpha, 1), p.solver.reach)
        assert 0 < stage.goal < goal
        assert stage.until == (iterations if level == meshes - 1 else int(0.75 * iterations))
    for schedule in (Schedule(p, MEASURED, 1), Schedule(replace(p, sigma=1.0), EXACT, 1)):
        assert schedule.stage(0, 1.0, Variant(p.alpha, 1)).goal == 0


def test_given_sigma_ends_coarse_levels_at_their_error():
    """Only in the stage whose result the mesh itself replaces, and in no fixed or free schedule."""
    p = Parameters(sigma=0.1)
    schedule, way = Schedule(p, EXACT, 2), Variant(p.alpha, 1)
    *early, last = schedule.sigmas
    for reach in (0.0, 1.0):
        coarse, fine = (schedule.stage(level, last, way, reach, 0.2) for level in (0, 1))
        assert (coarse.goal, coarse.is_search) == (0.2, reach > 0)
        assert (fine.goal, fine.is_search) == (0.0, False)
        for other, sigma in (
            *((schedule, sigma) for sigma in early),
            (Schedule(p.with_values(stage_iterations=7), EXACT, 2), last),
            (Schedule(Parameters(), EXACT, 2), last),
            (Schedule(Parameters(), MEASURED, 2), last),
        ):
            assert other.stage(0, sigma, way, reach, 0.2) == other.stage(0, sigma, way, reach)


def test_search_pays_while_the_residual_falls():
    """Once the target is found; before that and in other stages the energy alone decides."""
    stage = Stage(0, 1, 1.0, 1.0, 1.0, 100, 100, fixed=False, goal=0.0)
    search = replace(stage, is_search=True)
    falling = [0.9**k for k in range(40)]
    for residual, is_worthwhile in ((0.8, True), (0.6, False)):
        assert search.is_worthwhile(falling, [residual] * 40) == is_worthwhile
        assert search.is_worthwhile(falling[:5], [residual] * 5)
        assert stage.is_worthwhile(falling, [residual] * 40)
        assert replace(search, fixed=True).is_worthwhile(falling, [residual] * 40)
    assert search.is_worthwhile(falling, falling)
    assert not search.is_worthwhile([1.0] * 40, falling)


def test_a_stage_pays_while_its_energy_falls():
    stage = Stage(0, 1, 1.0, 1.0, 0.0, 100, 100, fixed=False, goal=0.0)
    falling, still = [0.99**k for k in range(40)], [1.0] * 40
    assert stage.is_worthwhile(falling)
    assert not stage.is_worthwhile([0.998**k for k in range(40)])
    assert not stage.is_worthwhile(still)
    assert stage.is_worthwhile(still[:5])  # too early to tell
    assert replace(stage, fixed=True).is_worthwhile(still)
    assert not stage.is_worthwhile([math.inf] * 40)


def test_what_was_learned_serves_the_same_norm_on_the_same_mesh():
    stage = Stage(1, 1, 1.0, 1.0, 0.0, 100, 100, fixed=False, goal=0.0)
    colder = replace(stage, sigma=0.1)
    assert colder.continues(stage)
    assert not replace(colder, fixed=True).continues(stage)
    for other in ({"level": 0}, {"fields": 2}, {"reach": 1.0}, {"alpha": 0.3}):
        assert not replace(stage, **other).continues(stage)
