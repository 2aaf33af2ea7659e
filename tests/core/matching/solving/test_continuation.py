"""The way of a match: far, then near; from smooth to close; where it ends, and on which mesh."""

from dataclasses import replace
from functools import cache
from itertools import groupby, pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import abfm
from abfm import MatchingEnergy, Parameters, Problem
from abfm.flow import ContinuousFlow
from abfm.matching.solving import continuation, descent, held_out
from abfm.matching.solving.held_out import best_between
from abfm.matching.solving.levels import Levels
from abfm.matching.solving.measures import flow_line_measures
from abfm.matching.solving.record import StepResult
from abfm.matching.solving.schedule import Schedule, Variant
from abfm.mesh.subdivision import mean_of_children, refined
from abfm.parameters import FIRST_SIGMA_MAX, LAST_SIGMA
from tests.core.fields import bump, wavy_field
from tests.shapes import icosphere

SPHERE, SMALL = icosphere(3), icosphere(2)
NUMBERS = "residual", "verified_residual", "folded", "log2_area", "log2_shape"
SIGMAS = (5.0, 2.0, 1.0, 0.5, 0.2, 0.1)
SEEDS = (0, 2, 3)
_CHOSEN_BY = "sigma", "score"


def pair(a=0, b=60, width=0.15, mesh=SPHERE):
    return bump(mesh, mesh.vertices[a], width), bump(mesh, mesh.vertices[b], width)


@cache
def exact(width=0.15, b=60, mesh=SPHERE, **parameters):
    """A match of two Gaussians, and its iterates."""
    seen = []
    p = Parameters.of(**{"refine": 0} | parameters)
    return abfm.match(mesh, *pair(0, b, width, mesh), p, on_iteration=seen.append), seen


def worse(step):
    return max(step.residual, step.verified_residual)


def waves(points, seed):
    """Twelve waves in random directions, three to eight radians per unit of length."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(12, 3))
    directions *= rng.uniform(3, 8, 12)[:, None] / np.linalg.norm(directions, axis=1)[:, None]
    return np.sin(points @ directions.T + rng.uniform(0, 6, 12)).sum(axis=1)


@cache
def carried_waves(seed):
    """Waves and what a smooth flow makes of them, each with a fifth of noise; and its origins."""
    origins = ContinuousFlow(SPHERE, 0.1 * wavy_field(SPHERE, seed)[None], 1.0).origins().positions
    rng, there = np.random.default_rng(seed), origins / np.linalg.norm(origins, axis=1)[:, None]
    f, g = (waves(points, seed) for points in (SPHERE.vertices, there))
    f, g = (h + 0.2 * h.std() * rng.normal(size=len(h)) for h in (f, g))
    return Problem(SPHERE, f, g), origins


@cache
def registered(seed, **parameters):
    seen, problem = [], carried_waves(seed)[0].with_parameters(Parameters.of(**parameters))
    return abfm.match(problem, on_iteration=seen.append), seen


def error(match, fields, origins):
    """Root of the mean square, of where the values of vertices come from."""
    found = ContinuousFlow(match.mesh, fields, 1.0).origins().positions
    return np.sqrt(((found - origins) ** 2).sum(axis=1).mean())


def test_the_far_norm_leads_until_the_target_is_found_and_never_again_on_this_way():
    _, seen = exact(0.07, 30)
    ways = [list(way) for _, way in groupby(seen, lambda one: len(one.velocity))][:2]
    assert [len(way[0].velocity) for way in ways] == [1, 2]
    for way in ways:
        reaches = [one.reach for one in way]
        assert reaches == sorted(reaches, reverse=True)
        assert set(reaches) == {0.0, 1.0}
        assert way[0].residual > 1.2  # from no motion again
        at = reaches.index(0.0)
        assert way[at - 1].residual <= 0.75
        assert way[at].sigma == way[at - 1].sigma
        ends = [list(step)[-1] for _, step in groupby(way[:at], lambda one: one.sigma)]
        assert all(one.residual > 0.75 for one in ends[:-1])


@pytest.mark.parametrize(("sigma", "enough"), [(None, 0.05), (0.02, 0.15)])
def test_a_second_way_has_two_fields_in_a_row_and_is_walked_where_one_leaves_more(sigma, enough):
    near, seen = exact(0.2, sigma=sigma)
    assert {len(one.velocity) for one in seen} == {1}
    assert near.worse_residual <= enough
    far, seen = exact(0.07, 30, sigma=sigma)
    ways = [list(way) for _, way in groupby(seen, lambda one: len(one.velocity))]
    assert [len(way[0].velocity) for way in ways[:2]] == [1, 2]
    assert len({step.velocity.shape for step in far.path}) == 1
    alone, seen = exact(0.07, 30, sigma=sigma, segments=1)
    assert {len(one.velocity) for one in seen} == {1}
    assert far.worse_residual <= alone.worse_residual


@pytest.mark.parametrize(("width", "sigma", "count"), [(0.2, 0.02, 2), (0.3, 0.05, 3)])
def test_short_coarse_stages_end_at_the_same_match(width, sigma, count, monkeypatch):
    """With a given sigma the mesh itself makes up for iterations left out on coarser ones."""
    mesh = icosphere(4)
    f, g = (bump(mesh, axis, width) for axis in ([0, 0, 1], [0, 1, 0]))
    p = Parameters.of(sigma=sigma, cooling_stages=1, levels=count)

    def matched():
        seen = []
        found = abfm.match(mesh, f, g, p, on_iteration=seen.append)
        return found, [one for one in seen if one.level == 0]

    short, few = matched()
    patched = Schedule.stage
    monkeypatch.setattr(
        Schedule,
        "stage",
        lambda *args, **error: replace(patched(*args, **error), goal=0.0, is_search=False),
    )
    long, many = matched()
    assert len(few) < 0.8 * len(many)
    assert {len(one.velocity) for one in few} == {1}
    for one in (short, long):
        assert one.worse_residual < 0.01  # a fifth of the goal
    assert_allclose(short.energy_history[-1][0], long.energy_history[-1][0], rtol=0.1)


def test_fields_of_coarse_meshes_are_smoothed_for_a_given_sigma():
    """The kinks that they have over edges of the coarse mesh cost less than the match is worth."""
    mesh = icosphere(4)
    f, g = (bump(mesh, axis, 0.2) for axis in ([0, 0, 1], [0, 1, 0]))
    seen = []
    abfm.match(mesh, f, g, Parameters.of(sigma=0.02, levels=2), on_iteration=seen.append)
    coarse = [one for one in seen if one.level == 0][-1]
    first, *_, last = (one for one in seen if one.level == 1)
    assert first.regularity < 100 * coarse.regularity
    assert last.residual < coarse.residual


@pytest.mark.parametrize("goal", [0.3, 0.15, 0.1])
def test_without_a_given_sigma_it_ends_where_both_witnesses_leave_the_goal(goal):
    match, _ = exact(goal=goal)
    *before, end = match.path
    assert match.step == len(before)
    assert worse(end) <= goal
    assert all(worse(step) > goal for step in before)
    assert match.verdict.kind == "matched"
    sigmas = [step.sigma for step in match.path]
    assert sigmas[0] == FIRST_SIGMA_MAX
    *falls, last = np.divide(sigmas[:-1], sigmas[1:])
    assert_allclose(falls, 3.0)
    assert_allclose(np.log(last) / np.log(3), max(1, round(np.log(last) / np.log(3))))  # confirmed
    assert exact(goal=goal / 2)[0].path[-1].sigma <= end.sigma


def test_where_none_confirms_the_goal_the_best_step_by_the_worse_witness_is_the_match():
    match, _ = exact(0.07, 30)
    left = [worse(step) for step in match.path]
    assert min(left) > match.parameters.goal
    assert match.step == int(np.argmin(left))
    assert match.worse_residual == min(left)
    assert match.stop_reason != "iteration limit"


@pytest.mark.parametrize(("width", "b"), [(0.1, 30), (0.12, 60), (0.1, 100)])
def test_what_flow_lines_leave_more_is_shared_by_both_witnesses(width, b, monkeypatch):
    corrected = exact(width, b)[0].path
    monkeypatch.setattr(continuation, "_corrected", lambda state, level: state)
    match = abfm.match(SPHERE, *pair(0, b, width), Parameters(refine=0))
    assert match.residual < 0.05 < match.verified_residual
    better = min(corrected, key=worse)
    assert worse(better) < 0.8 * match.worse_residual
    apart = match.verified_residual - match.residual
    assert abs(better.verified_residual - better.residual) < 0.5 * apart


@pytest.mark.parametrize("sigma", [30.0, 0.7, 0.05])
@pytest.mark.parametrize("unit", ["relative", "absolute"])
def test_a_given_sigma_is_where_it_ends_and_nothing_comes_after(sigma, unit):
    match, seen = exact(sigma=sigma, sigma_unit=unit, goal=0.3)
    assert match.step == len(match.path) - 1
    assert match.path[-1].sigma == seen[-1].sigma == sigma == min(one.sigma for one in seen)
    assert match.refined == 0


@pytest.mark.parametrize("seed", SEEDS)
def test_on_measured_functions_what_is_left_falls_with_sigma_and_what_it_costs_rises(seed):
    ends = [registered(seed, sigma=sigma)[0].path[-1] for sigma in SIGMAS]
    assert [end.sigma for end in ends] == list(SIGMAS)
    assert (np.diff([end.residual for end in ends]) < 0).all()
    for cost in ("log2_area", "log2_shape"):
        assert (np.diff([getattr(end, cost) for end in ends]) > 0).all()


@pytest.mark.parametrize("seed", SEEDS)
def test_of_measured_functions_the_step_is_chosen_whose_map_is_about_the_truest(seed):
    match, _ = registered(seed)
    origins = carried_waves(seed)[1]
    errors = [error(match, step.velocity, origins) for step in match.path]
    assert match.verdict.kind == "registered"
    assert errors[match.step] <= 1.5 * min(errors)
    # the truest one is neither the first nor the last
    assert max(errors[0], errors[-1]) > 1.2 * min(errors)
    assert 0.3 * error(match, 0 * match.velocity, origins) > errors[match.step]
    assert LAST_SIGMA < match.path[match.step].sigma < FIRST_SIGMA_MAX


@pytest.mark.parametrize("seed", SEEDS)
def test_chosen_sigma_is_minimum_of_parabola(seed):
    """It lies between steps of a ratio of sqrt(3), which end one step after the best of them."""
    match, _ = registered(seed)
    path = list(match.path)
    own = path.pop(match.step)
    sigmas, scores = (np.array([getattr(step, name) for step in path]) for name in _CHOSEN_BY)
    assert_allclose(sigmas[:-1] / sigmas[1:], np.sqrt(3))
    best = int(np.argmin(scores))
    assert best == len(path) - 2
    sigma, weights = best_between(sigmas[best - 1 :], scores[best - 1 :])
    assert own.sigma == pytest.approx(sigma)
    assert own.score == pytest.approx(weights @ scores[best - 1 :])
    assert own.score <= scores.min()
    assert path[match.step - 1].sigma > own.sigma > path[match.step].sigma
    reason = match.facts.reason
    assert f"sigma {own.sigma:.3g} has the smallest held-out score, {own.score:.4f}" in reason
    assert f"{path[match.step].score:.4f} at {path[match.step].sigma:.3g}" in reason
    assert "held-out score" not in match.at_step(0).facts.reason


def test_chosen_sigma_is_a_solution_of_its_own():
    """The step between two others is minimised, so with its sigma given the map is the same."""
    match, _ = registered(0)
    given, _ = registered(0, sigma=match.path[match.step].sigma)
    origins = carried_waves(0)[1]
    errors = [error(found, found.velocity, origins) for found in (match, given)]
    assert errors[0] == pytest.approx(errors[1], rel=0.1)
    assert match.residual == pytest.approx(given.residual, rel=0.05)


def test_choosing_sigma_costs_little(monkeypatch):
    """All folds together take less than twice as many evaluations as the steps themselves."""
    in_folds, search = [], descent.search_of

    def counted(energy, stage, at):
        return search(energy, stage, lambda: in_folds.append(1), at)

    def minimum(*given):
        with monkeypatch.context() as patch:
            patch.setattr(descent, "search_of", counted)
            return descent.minimum(*given)

    monkeypatch.setattr(held_out, "minimum", minimum)
    seen = []
    abfm.match(carried_waves(0)[0], on_iteration=seen.append)
    assert 0 < len(in_folds) < 2 * seen[-1].evaluations


def test_measured_functions_are_walked_anew_from_a_start():
    match, _ = registered(0)
    again = abfm.match(match.problem.starting_from(match.path[-1].velocity))
    assert_array_equal(again.fine_velocity, match.fine_velocity)
    start = match.problem.starting_from(match.velocity)
    kept = abfm.match(start.with_parameters(Parameters.of(iterations=0)))
    assert_allclose(kept.velocity, match.velocity, atol=1e-12)


def test_nothing_is_said_to_look_wrong_while_smaller_sigmas_or_other_ways_are_to_come():
    for match, seen in (exact(0.07, 30), exact(0.05, 30, iterations=40), registered(0)):
        warned = [one for one in seen if one.warning]
        last = match.parameters.last_sigma
        assert all(one.sigma < 3 * last for one in warned)


@pytest.mark.parametrize("found", [lambda: exact(0.07, 30)[0], lambda: registered(0)[0]])
def test_steps_are_what_they_say(found):
    match = found()
    energy = MatchingEnergy(match.problem)
    for one, following in pairwise(match.path):
        assert one.sigma > following.sigma
        assert one.reach >= following.reach
    for number, step in enumerate(match.path):
        there = match.at_step(number)
        assert (there.step, there.load_warning) == (number, "")
        for name in NUMBERS[:3]:
            assert getattr(there, name) == getattr(step, name)
        assert_array_equal(there.fine_velocity, step.velocity)
        said = flow_line_measures(energy, step.velocity / energy.length_scale)
        for name in NUMBERS[1:]:
            assert said[name] == pytest.approx(getattr(step, name), abs=1e-9)
    assert match.path[match.step].velocity is match.fine_velocity


@pytest.mark.parametrize("width", [0.1, 0.12])
@pytest.mark.parametrize("changes", [{}, {"sigma": 0.3}], ids=["auto", "given"])
def test_a_finer_mesh_never_ends_worse_and_is_made_as_often_as_asked_for(width, changes):
    of = [exact(width, 30, SMALL, **{"refine": k} | changes)[0] for k in (0, 1, 2)]
    left = [match.worse_residual for match in of]
    assert left == sorted(left, reverse=True)
    assert of[0].refined == 0
    for k, match in enumerate(of):
        assert match.refined <= k
        assert match.parameters.refine == k
        assert match.path[match.step].sigma == changes.get("sigma", match.path[match.step].sigma)
        if match.refined < k:  # once one gains nothing there is no next one
            assert left[k] == left[k - 1] or left[k] <= match.parameters.goal
    assert left[2] < 0.7 * left[0]


def test_what_is_refined_is_seen_on_the_mesh_itself():
    match, seen = exact(0.3, 8, SMALL, refine=1, goal=0.01, segments=1)
    count, faces = len(SMALL.vertices), len(SMALL.faces)
    assert match.refined == 1
    assert match.fine.mesh is refined(SMALL, 1)
    assert_array_equal(match.velocity, mean_of_children(match.fine_velocity, faces))
    carried = match.fine.push(match.fine.source, 1.0)
    assert_allclose(match.advected, carried[:count], atol=1e-6)
    assert match.advect(1.0) == pytest.approx(match.advected[:, 0], abs=1e-6)
    assert match.fine.verify(subdivided=False).flow_lines == pytest.approx(match.verified_residual)
    assert {one.vertices for one in seen} == {count, len(refined(SMALL, 1).vertices)}
    assert seen[-1].velocity.shape == (1, faces, 3)
    assert seen[-1].advected.shape == (count, 1)


def test_what_the_mesh_resolves_is_refined_only_where_flow_lines_alone_are_far_and_a_flow_can_do():
    """Otherwise the mesh is not what is in the way."""

    def resolved(f, g, mismatch, verified):
        energy = MatchingEnergy(SPHERE, f, g, Parameters())
        stage = Schedule(energy.parameters, energy.functions, 1).stage(0, 1.0, Variant(0.01, 1))
        result = StepResult(
            stage, np.zeros(energy.shape), f[None], mismatch, {"verified_residual": verified}
        )
        return continuation._is_resolved(Levels.of_mesh(energy), result)

    one, other = pair(width=0.25)
    assert resolved(one, other, 0.2, 0.2)
    assert not resolved(one, other, 0.1, 0.2)
    assert not resolved(one, other, 0.1, 0.1)
    assert not resolved(*pair(width=0.05), 0.2, 0.2)  # of fewer than five edges
    assert resolved(one, one + other, 0.1, 0.2)  # of two peaks


def test_a_jump_is_refined_only_where_that_is_asked_for():
    ends = "indicator:vertex=0,radius=0.4", "indicator:vertex=30,radius=0.4"
    of = [abfm.match(SMALL, *ends, Parameters(refine=k)) for k in (None, 1)]
    assert [match.refined for match in of] == [0, 1]
    assert of[0].worse_residual > max(of[0].parameters.goal, of[1].worse_residual)


def test_far_from_the_target_nothing_is_refined_that_has_no_iterations_left():
    for iterations, times in ((6, 0), (60, 1)):
        found = exact(0.2, 30, SMALL, refine=None, iterations=iterations)[0]
        assert (found.refined, len(found.energy_history)) == (times, iterations + 1)


def test_only_what_is_not_confirmed_is_refined_and_a_given_sigma_where_it_is_asked_for():
    assert exact(0.12, 30, SMALL, refine=None)[0].refined > 0
    assert exact(0.12, 30, SMALL, refine=None, sigma=0.3)[0].refined == 0
    assert exact(0.12, 30, SMALL, refine=1, sigma=0.3)[0].refined == 1
    assert exact(0.3, 8, refine=3)[0].refined == 0
    assert registered(0)[0].refined == 0
    usual, finer = registered(0)[0], registered(0, refine=1)[0]
    assert (usual.refined, finer.refined) == (0, 1)
    assert finer.path[finer.step].sigma == usual.path[usual.step].sigma
    assert finer.worse_residual < usual.worse_residual
