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
SEEDS = (0, 2)
_SELECTION_NAMES = "sigma", "score"


def pair(a=0, b=60, width=0.15, mesh=SPHERE):
    return bump(mesh, mesh.vertices[a], width), bump(mesh, mesh.vertices[b], width)


@cache
def exact(width=0.15, b=60, mesh=SPHERE, **parameters):
    """Match two Gaussians; return the match and its iterates."""
    seen = []
    p = Parameters.of(**{"refine": 0} | parameters)
    return abfm.match(mesh, *pair(0, b, width, mesh), p, on_iteration=seen.append), seen


def worse(step):
    return max(step.residual, step.verified_residual)


def waves(points, seed):
    """Return twelve waves in random directions, with 3 to 8 radians per unit of length."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(12, 3))
    directions *= rng.uniform(3, 8, 12)[:, None] / np.linalg.norm(directions, axis=1)[:, None]
    return np.sin(points @ directions.T + rng.uniform(0, 6, 12)).sum(axis=1)


@cache
def advected_waves(seed):
    """Return waves and their advected copies with noise of 20%, and the origins of values."""
    origins = ContinuousFlow(SPHERE, 0.1 * wavy_field(SPHERE, seed)[None], 1.0).origins().positions
    rng, there = np.random.default_rng(seed), origins / np.linalg.norm(origins, axis=1)[:, None]
    f, g = (waves(points, seed) for points in (SPHERE.vertices, there))
    f, g = (h + 0.2 * h.std() * rng.normal(size=len(h)) for h in (f, g))
    return Problem(SPHERE, f, g), origins


@cache
def registered(seed, **parameters):
    seen, problem = [], advected_waves(seed)[0].with_parameters(Parameters.of(**parameters))
    return abfm.match(problem, on_iteration=seen.append), seen


def error(match, fields, origins):
    """Return the root mean square error of the origins of the vertex values."""
    found = ContinuousFlow(match.mesh, fields, 1.0).origins().positions
    return np.sqrt(((found - origins) ** 2).sum(axis=1).mean())


def test_reach_ends_when_the_target_is_found():
    """In each variant, stages have the reach until the residual is at most 0.75."""
    _, seen = exact(0.07, 30)
    variants = [list(variant) for _, variant in groupby(seen, lambda one: len(one.velocity))][:2]
    assert [len(variant[0].velocity) for variant in variants] == [1, 2]
    for variant in variants:
        reaches = [one.reach for one in variant]
        assert reaches == sorted(reaches, reverse=True)
        assert set(reaches) == {0.0, 1.0}
        assert variant[0].residual > 1.2  # the second variant begins with the zero field
        at = reaches.index(0.0)
        assert variant[at - 1].residual <= 0.75
        assert variant[at].sigma == variant[at - 1].sigma
        ends = [list(step)[-1] for _, step in groupby(variant[:at], lambda one: one.sigma)]
        assert all(one.residual > 0.75 for one in ends[:-1])


@pytest.mark.parametrize(("sigma", "required"), [(None, 0.05), (0.02, 0.15)])
def test_second_variant_has_two_fields(sigma, required):
    """A second variant, with two fields, follows if the first exceeds the required residual."""
    close, seen = exact(0.2, sigma=sigma)
    assert {len(one.velocity) for one in seen} == {1}
    assert close.worse_residual <= required
    distant, seen = exact(0.07, 30, sigma=sigma)
    variants = [list(variant) for _, variant in groupby(seen, lambda one: len(one.velocity))]
    assert [len(variant[0].velocity) for variant in variants[:2]] == [1, 2]
    assert [(one[0].attempt, one[0].attempts) for one in variants[:2]] == [(1, 2), (2, 2)]
    assert len({step.velocity.shape for step in distant.path}) == 1
    alone, seen = exact(0.07, 30, sigma=sigma, segments=1)
    assert {len(one.velocity) for one in seen} == {1}
    assert distant.worse_residual <= alone.worse_residual


@pytest.mark.parametrize(("width", "sigma", "count"), [(0.2, 0.02, 2), (0.3, 0.05, 3)])
def test_short_coarse_stages_end_at_the_same_match(width, sigma, count, monkeypatch):
    mesh = icosphere(4)
    f, g = (bump(mesh, axis, width) for axis in ([0, 0, 1], [0, 1, 0]))
    p = Parameters.of(sigma=sigma, cooling_stages=1, levels=count)

    def matched():
        seen = []
        found = abfm.match(mesh, f, g, p, on_iteration=seen.append)
        return found, [one for one in seen if one.level == 0]

    short, few = matched()
    patched = Schedule.stage

    def fixed(*args, **error):
        return replace(patched(*args, **error), goal=0.0, is_search=False)

    monkeypatch.setattr(Schedule, "stage", fixed)
    long, many = matched()
    assert len(few) < 0.8 * len(many)
    assert {len(one.velocity) for one in few} == {1}
    for one in (short, long):
        assert one.worse_residual < 0.01  # the goal is 0.05
    assert_allclose(short.energy_history[-1][0], long.energy_history[-1][0], rtol=0.1)


def test_coarse_fields_are_smoothed_for_given_sigma():
    """Fields of coarse levels are smoothed, as kinks over coarse edges cost more than is gained."""
    mesh = icosphere(4)
    f, g = (bump(mesh, axis, 0.2) for axis in ([0, 0, 1], [0, 1, 0]))
    seen = []
    abfm.match(mesh, f, g, Parameters.of(sigma=0.02, levels=2), on_iteration=seen.append)
    coarse = [one for one in seen if one.level == 0][-1]
    first, *_, last = (one for one in seen if one.level == 1)
    assert first.regularity < 100 * coarse.regularity
    assert last.residual < coarse.residual


@pytest.mark.parametrize("goal", [0.3, 0.15, 0.1])
def test_path_ends_when_both_checks_reach_the_goal(goal):
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
    assert_allclose(np.log(last) / np.log(3), max(1, round(np.log(last) / np.log(3))))
    assert exact(goal=goal / 2)[0].path[-1].sigma <= end.sigma


def test_step_whose_larger_residual_is_least_is_selected():
    match, _ = exact(0.07, 30)
    residuals = [worse(step) for step in match.path]
    assert min(residuals) > match.parameters.goal
    assert match.step == int(np.argmin(residuals))
    assert match.worse_residual == min(residuals)
    assert match.stop_reason != "iteration limit"


@pytest.mark.parametrize(("width", "b"), [(0.1, 30), (0.1, 100)])
def test_correction_balances_both_checks(width, b, monkeypatch):
    corrected = exact(width, b)[0].path
    monkeypatch.setattr(continuation, "_corrected", lambda state, level: state)
    match = abfm.match(SPHERE, *pair(0, b, width), Parameters(refine=0))
    assert match.residual < 0.05 < match.verified_residual
    better = min(corrected, key=worse)
    assert worse(better) < 0.8 * match.worse_residual
    difference = match.verified_residual - match.residual
    assert abs(better.verified_residual - better.residual) < 0.5 * difference


@pytest.mark.parametrize("sigma", [30.0, 0.7, 0.05])
@pytest.mark.parametrize("unit", ["relative", "absolute"])
def test_path_ends_at_given_sigma(sigma, unit):
    match, seen = exact(sigma=sigma, sigma_unit=unit, goal=0.3)
    assert match.step == len(match.path) - 1
    assert match.path[-1].sigma == seen[-1].sigma == sigma == min(one.sigma for one in seen)
    assert match.refined == 0


@pytest.mark.parametrize("seed", SEEDS)
def test_residual_falls_and_distortion_grows_with_sigma(seed):
    ends = [registered(seed, sigma=sigma)[0].path[-1] for sigma in SIGMAS]
    assert [end.sigma for end in ends] == list(SIGMAS)
    assert (np.diff([end.residual for end in ends]) < 0).all()
    for cost in ("log2_area", "log2_shape"):
        assert (np.diff([getattr(end, cost) for end in ends]) > 0).all()


@pytest.mark.parametrize("seed", SEEDS)
def test_selected_step_has_nearly_the_most_accurate_map(seed):
    """The most accurate step is neither the first one nor the last one."""
    match, _ = registered(seed)
    origins = advected_waves(seed)[1]
    errors = [error(match, step.velocity, origins) for step in match.path]
    assert match.verdict.kind == "registered"
    assert errors[match.step] <= 1.5 * min(errors)
    assert max(errors[0], errors[-1]) > 1.2 * min(errors)
    assert 0.3 * error(match, 0 * match.velocity, origins) > errors[match.step]
    assert LAST_SIGMA < match.path[match.step].sigma < FIRST_SIGMA_MAX


@pytest.mark.parametrize("seed", SEEDS)
def test_selected_sigma_is_minimum_of_parabola(seed):
    """Sigma minimises a parabola between steps; the path ends one step after the best score."""
    match, _ = registered(seed)
    path = list(match.path)
    selected = path.pop(match.step)
    sigmas, scores = (np.array([getattr(step, name) for step in path]) for name in _SELECTION_NAMES)
    assert_allclose(sigmas[:-1] / sigmas[1:], np.sqrt(3))
    best = int(np.argmin(scores))
    assert best == len(path) - 2
    sigma, weights = best_between(sigmas[best - 1 :], scores[best - 1 :])
    assert selected.sigma == pytest.approx(sigma)
    assert selected.score == pytest.approx(weights @ scores[best - 1 :])
    assert selected.score <= scores.min()
    assert path[match.step - 1].sigma > selected.sigma > path[match.step].sigma
    reason = match.facts.reason
    assert (
        f"sigma {selected.sigma:.3g} has the smallest held-out score, {selected.score:.4f}"
        in reason
    )
    assert f"{path[match.step].score:.4f} at {path[match.step].sigma:.3g}" in reason
    assert "held-out score" not in match.at_step(0).facts.reason


def test_selected_sigma_is_minimised():
    """The interpolated step is minimised, so a given sigma of this value gives the same map."""
    match, _ = registered(0)
    given, _ = registered(0, sigma=match.path[match.step].sigma)
    origins = advected_waves(0)[1]
    errors = [error(found, found.velocity, origins) for found in (match, given)]
    assert errors[0] == pytest.approx(errors[1], rel=0.1)
    assert match.residual == pytest.approx(given.residual, rel=0.05)


def test_selection_of_sigma_costs_little(monkeypatch):
    in_folds, search = [], descent.search_of

    def counted(energy, stage, at):
        return search(energy, stage, lambda: in_folds.append(1), at)

    def minimum(*given):
        with monkeypatch.context() as patch:
            patch.setattr(descent, "search_of", counted)
            return descent.minimise_fold(*given)

    monkeypatch.setattr(held_out, "minimise_fold", minimum)
    seen = []
    abfm.match(advected_waves(0)[0], on_iteration=seen.append)
    assert 0 < len(in_folds) < 2 * seen[-1].evaluations


def test_measured_functions_ignore_a_start():
    match, _ = registered(0)
    again = abfm.match(match.problem.starting_from(match.path[-1].velocity))
    assert_array_equal(again.fine_velocity, match.fine_velocity)
    start = match.problem.starting_from(match.velocity)
    unchanged = abfm.match(start.with_parameters(Parameters.of(iterations=0)))
    assert_allclose(unchanged.velocity, match.velocity, atol=1e-12)


def test_no_warning_before_the_last_variant_and_sigma():
    for match, seen in (exact(0.07, 30), exact(0.05, 30, iterations=40), registered(0)):
        warned = [one for one in seen if one.warning]
        last = match.parameters.last_sigma
        assert all(one.sigma < 3 * last for one in warned)


@pytest.mark.parametrize("found", [lambda: exact(0.07, 30)[0], lambda: registered(0)[0]])
def test_measurements_of_steps_agree_with_their_fields(found):
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
        measures = flow_line_measures(energy, step.velocity / energy.length_scale)
        for name in NUMBERS[1:]:
            assert measures[name] == pytest.approx(getattr(step, name), abs=1e-9)
    assert match.path[match.step].velocity is match.fine_velocity


@pytest.mark.parametrize("changes", [{}, {"sigma": 0.3}], ids=["auto", "given"])
def test_refinement_never_increases_the_residual(changes):
    of = [exact(0.12, 30, SMALL, **{"refine": k} | changes)[0] for k in (0, 1, 2)]
    residuals = [match.worse_residual for match in of]
    assert residuals == sorted(residuals, reverse=True)
    assert of[0].refined == 0
    for k, match in enumerate(of):
        assert match.refined <= k
        assert match.parameters.refine == k
        assert match.path[match.step].sigma == changes.get("sigma", match.path[match.step].sigma)
        if match.refined < k:  # fewer than requested, as another one would not help
            assert residuals[k] == residuals[k - 1] or residuals[k] <= match.parameters.goal
    assert residuals[2] < 0.7 * residuals[0]


def test_refined_match_is_a_match_of_the_mesh():
    match, seen = exact(0.3, 8, SMALL, refine=1, goal=0.01, segments=1)
    count, faces = len(SMALL.vertices), len(SMALL.faces)
    assert match.refined == 1
    assert match.fine.mesh is refined(SMALL, 1)
    assert_array_equal(match.velocity, mean_of_children(match.fine_velocity, faces))
    advected = match.fine.push(match.fine.source, 1.0)
    assert_allclose(match.advected, advected[:count], atol=1e-6)
    assert match.advect(1.0) == pytest.approx(match.advected[:, 0], abs=1e-6)
    assert match.fine.verify(subdivided=False).flow_lines == pytest.approx(match.verified_residual)
    assert {one.vertices for one in seen} == {count, len(refined(SMALL, 1).vertices)}
    assert seen[-1].velocity.shape == (1, faces, 3)
    assert seen[-1].advected.shape == (count, 1)


def test_resolved_functions_are_rarely_refined():
    """A finer mesh is used if only the residual along flow lines is large, unless peaks differ."""

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
    assert not resolved(*pair(width=0.05), 0.2, 0.2)  # narrower than five edges
    assert resolved(one, one + other, 0.1, 0.2)  # one peak cannot become two


def test_jumps_are_refined_only_on_request():
    ends = "indicator:vertex=0,radius=0.4", "indicator:vertex=30,radius=0.4"
    of = [abfm.match(SMALL, *ends, Parameters(refine=k)) for k in (None, 1)]
    assert [match.refined for match in of] == [0, 1]
    assert of[0].worse_residual > max(of[0].parameters.goal, of[1].worse_residual)


def test_refinement_needs_remaining_iterations():
    for iterations, times in ((6, 0), (60, 1)):
        found = exact(0.2, 30, SMALL, refine=None, iterations=iterations)[0]
        assert (found.refined, len(found.energy_history)) == (times, iterations + 1)


def test_refinement_of_unconfirmed_matches():
    assert exact(0.12, 30, SMALL, refine=None)[0].refined > 0
    assert exact(0.12, 30, SMALL, refine=None, sigma=0.3)[0].refined == 0
    assert exact(0.12, 30, SMALL, refine=1, sigma=0.3)[0].refined == 1
    assert exact(0.3, 8, refine=3)[0].refined == 0
    assert registered(0)[0].refined == 0
    usual, finer = registered(0)[0], registered(0, refine=1)[0]
    assert (usual.refined, finer.refined) == (0, 1)
    assert finer.path[finer.step].sigma == usual.path[usual.step].sigma
    assert finer.worse_residual < usual.worse_residual
