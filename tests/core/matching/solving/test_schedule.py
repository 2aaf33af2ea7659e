"""The course of a match: the paper's where that is asked for."""

import math
from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from abfm.matching.solving.schedule import MATCHED, REACHED, Found, Stage, finish, gradual, search
from abfm.parameters import PAPER, Parameters


def stages(p, levels=1, warm=False, clustered=False):
    """All stages in their order, with the first way to the target."""
    ways = search(p, levels, clustered)
    return (ways[0].stages if ways and not warm else []) + finish(p, levels, Found(warm), clustered)


@given(st.floats(1e-6, 1e3), st.floats(1.5, 20), st.integers(1, 8), st.integers(0, 2000))
def test_without_reach_on_one_mesh_the_course_is_the_papers(sigma, factor, count, iterations):
    """Every sigma from the largest to its value, each early one with its share."""
    cooling = {"sigma": sigma, "cooling_factor": factor, "cooling_stages": count}
    p = Parameters(**PAPER, **cooling, iterations=iterations, stage_iterations=0)
    plan = stages(p)
    assert len(search(p, 1)) == (count > 1)
    assert [stage.sigma for stage in plan] == p.stage_sigmas()
    assert [stage.iterations for stage in plan] == p.stage_limits()
    for stage in plan:
        assert (stage.level, stage.reach, stage.goal, stage.until) == (0, 0, 0, iterations)
        assert (stage.fixed, stage.needed_above, stage.balanced) == (True, 0, False)
        assert stage.pays([1.0] * 1000)
    assert [stage.last for stage in plan] == [False] * (count - 1) + [True]


def test_fixed_numbers_of_iterations_are_kept():
    """Of each stage before the last, with reach or without, and no stage ends before."""
    for changes in (PAPER, {"levels": 1}, {}):
        p = Parameters(**changes, stage_iterations=7, cooling_stages=4)
        for levels, clustered in ((1, False), (3, False), (2, True), (4, True)):
            ends = finish(p, levels, Found(False), clustered)
            found = [stage for way in search(p, levels, clustered) for stage in way.stages]
            assert all((stage.iterations, stage.alpha) == (7, p.alpha) for stage in found)
            assert gradual(p, levels, clustered) == []
            assert all(stage.fixed and stage.goal == 0 for stage in found + ends)
            if clustered:
                assert [stage.level for stage in ends].count(levels - 1) == 1
                assert (ends[-1].iterations, ends[-1].until) == (p.iterations, p.iterations)


ANY = st.builds(
    Parameters,
    reach=st.sampled_from([0.0, 0.3, 1.0]),
    iterations=st.integers(0, 1000),
    cooling_stages=st.integers(1, 5),
)


@given(ANY, st.integers(1, 5), st.booleans(), st.booleans())
def test_every_plan_ends_on_the_mesh_itself_within_the_iterations(p, meshes, warm, clustered):
    levels, iterations = meshes + clustered, p.iterations
    plan = stages(p, levels, warm, clustered)
    found = [stage for way in search(p, levels, clustered) for stage in way.stages]
    for stage in found + gradual(p, levels, clustered):
        assert stage.level == 0 <= stage.until <= iterations
    assert all(0 <= stage.until <= iterations for stage in plan)
    assert [stage.level for stage in plan] == sorted(stage.level for stage in plan)
    assert {stage.level for stage in plan} == set(range(meshes - 1 if warm else 0, levels))
    for level in range(meshes - 1, levels):  # twice where clusters come first
        last = [stage for stage in plan if stage.level == level and stage.last]
        first, *closing = (stage for stage in last if not stage.balanced)
        assert (first.sigma, first.needed_above) == (p.last_sigma, 0)
        assert all(stage.needed_above == stage.goal == MATCHED for stage in closing)
    assert not any(stage.reach for stage in finish(p, levels, Found(warm), clustered))
    for stage in plan:
        if stage.level < meshes - 1:
            assert not stage.last
            assert stage.until <= 0.75 * iterations


@given(ANY, st.integers(1, 5), st.booleans())
def test_the_mesh_as_it_is_comes_after_all_that_is_done_with_clusters(p, meshes, warm):
    """The course is that of a mesh without thin triangles."""
    assert search(p, meshes + 1, True) == search(p, meshes)
    assert gradual(p, meshes + 1, True) == gradual(p, meshes)
    plan = finish(p, meshes + 1, Found(warm), True)
    held = [stage for stage in plan if stage.level != meshes]
    itself, alone = plan[len(held) :], finish(p, meshes, Found(warm))
    assert all(stage.level == meshes for stage in itself)
    for one, other in zip(held, alone, strict=True):
        assert replace(one, until=0) == replace(other, until=0)
    assert [stage.balanced for stage in held] == [False] * (len(held) - 1) + [True]
    assert not any(stage.balanced for stage in itself)
    assert all(stage.last and stage.until == p.iterations for stage in itself)
    if p.reach == 0 and meshes == 1:
        assert held == alone
        assert itself == [replace(next(stage for stage in held if stage.last), level=meshes)]
        assert itself[0].fixed
        return
    assert all(stage.goal == MATCHED and not stage.fixed for stage in itself)
    assert [stage.needed_above for stage in itself] == [0] + [MATCHED] * (len(itself) - 1)
    last = [stage for stage in held if stage.last and not stage.balanced]
    assert [stage.sigma for stage in itself] == [stage.sigma for stage in last]
    assert len(itself) > 1
    for stage, before in zip(held, alone, strict=True):
        assert stage.until <= min(before.until, 0.9 * p.iterations)
    assert all(stage.iterations <= max(1, 0.15 * p.iterations) for stage in itself)


@pytest.mark.parametrize("levels", [1, 3])
def test_a_search_looks_far_then_near_and_further_where_that_fails(levels):
    p = Parameters(reach=0.4, cooling_stages=3)
    ways = [way.stages for way in search(p, levels)]
    assert [len(way) for way in ways] == [2] * len(ways)
    assert ways[0][0].reach == 0.4
    assert max(way[0].reach for way in ways) > 0.4 > min(way[0].reach for way in ways)
    for way in ways:
        assert way[1].reach == 0
        assert all(stage.level == 0 for stage in way)
        assert way[0].sigma <= way[1].sigma == p.stage_sigmas()[0]
    assert 0 < REACHED < 1


def test_less_smooth_ways_are_tried_where_a_smooth_one_does_not_surely_find_the_target():
    p = Parameters()
    first, *others = search(p, 1)
    assert {stage.alpha for stage in first.stages} == {p.alpha}
    for way in others:
        alphas = {stage.alpha for stage in way.stages}
        assert len(alphas) == 1
        assert max(alphas) < p.alpha
        assert way.found == REACHED > first.found > MATCHED
    found = finish(p, 1, Found(False, alpha=others[0].stages[0].alpha))
    assert found[0].alpha == others[0].stages[0].alpha
    still = search(Parameters(alpha=0.0), 1)  # nothing is less smooth
    assert len(still) == len(others)
    assert {way.found for way in still} == {REACHED}


@pytest.mark.parametrize("changes", [{}, PAPER, {"cooling_stages": 1}, {"balance": 0.0}])
def test_warm_starts_begin_on_the_mesh_with_the_last_sigma(changes):
    p = Parameters(**changes)
    plan = finish(p, 1, Found(True))
    assert plan[0].last
    assert plan[0].sigma == p.last_sigma
    assert all(stage.sigma <= p.last_sigma for stage in plan)
    assert [stage.balanced for stage in plan] == [False] * (len(plan) - 1) + [p.balance > 0]


def test_sigmas_fall_towards_the_last_and_below_it_only_where_needed_and_must_pay_well_before():
    plan = stages(Parameters(cooling_stages=4, balance=0.0))
    sigmas = [stage.sigma for stage in plan if not stage.reach]
    assert sigmas == sorted(sigmas, reverse=True)
    assert [stage.alpha for stage in plan] == sorted((stage.alpha for stage in plan), reverse=True)
    below = [stage for stage in plan if stage.sigma < Parameters().last_sigma]
    assert len(below) > 1
    for one, next_one in pairwise(below):
        assert next_one.alpha / one.alpha == pytest.approx((next_one.sigma / one.sigma) ** 2)
    assert {stage.alpha for stage in plan if not stage.needed_above} == {Parameters().alpha}
    assert all(stage.needed_above > 0 and stage.goal == stage.needed_above for stage in below)
    for levels, warm in ((1, False), (1, True), (3, False), (3, True)):
        plan = finish(Parameters(), levels, Found(warm))
        usual = {stage.paying for stage in plan if stage.needed_above == 0}
        assert min(usual) > max(stage.paying for stage in plan if stage.needed_above > 0)


def test_a_stage_pays_while_its_energy_falls():
    stage = Stage(0, 1.0, 1.0, 0.0, 100, 100, fixed=False)
    falling, still = [0.99**k for k in range(40)], [1.0] * 40
    assert stage.pays(falling)
    assert not replace(stage, paying=0.1).pays(falling)
    assert not stage.pays(still)
    assert stage.pays(still[:5])  # too early to tell
    assert replace(stage, fixed=True).pays(still)
    assert not stage.pays([math.inf] * 40)


@given(st.floats(1e-3, 50), st.integers(1, 3), st.booleans(), st.integers(1, 4), st.booleans())
def test_a_raised_sigma_is_the_last_before_closing_ones(raised, meshes, clustered, count, warm):
    p, levels = Parameters(cooling_stages=count), meshes + clustered
    plan, last = finish(p, levels, Found(warm, raised), clustered), max(p.last_sigma, raised)
    assert {stage.sigma for stage in plan if not stage.needed_above} == {last}
    for level in range(meshes - 1, levels):
        sigmas = [stage.sigma for stage in plan if stage.level == level and stage.needed_above]
        # the first one is less smooth
        assert sigmas == [pytest.approx(last / 3**step) for step in range(len(sigmas))]
        assert 1 / 3**5.001 < sigmas[-1] / p.last_sigma < 1 / 3**3.999
