import threading
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

import abfm
from abfm.assets import asset_path
from abfm.calculus.vector_fields import to_frame
from abfm.matching.objective.matching_energy import Objective
from abfm.matching.objective.regularizer import Regularizer
from abfm.matching.solving import continuation
from abfm.matching.solving.levels import Level
from abfm.mesh import TriangleMesh
from abfm.mesh.coarsening import coarsened
from abfm.parameters import PAPER, Parameters
from tests.core.fields import bump, rotation_field, wavy_field
from tests.core.invariance.moves import potato
from tests.core.surfaces import moved, relative_error, renumbered
from tests.shapes import hemisphere, icosphere

SPHERE, SMALL = icosphere(4), icosphere(3)
SHORT_RUN = Parameters.of(iterations=60, refine=0)


def at(degrees, mesh=SPHERE, width=0.1):
    """Return a Gaussian on a unit sphere at this angle from the pole."""
    angle = np.deg2rad(degrees)
    return bump(mesh, [0, np.sin(angle), np.cos(angle)], width)


def matched(degrees, p, mesh=SPHERE, width=0.1, **given):
    """Match a Gaussian at the pole to one at this angle; also return all iterates."""
    seen = []
    f, g = at(0, mesh, width), at(degrees, mesh, width)
    return abfm.match(mesh, f, g, p, **{"on_iteration": seen.append} | given), seen


def body(name, a, b, width, vertices):
    """Return a coarsened bundled mesh, and Gaussians near two vertices of the original."""
    given = abfm.load_mesh(asset_path(name))
    mesh = coarsened(given, vertices)
    nearest = (np.linalg.norm(mesh.vertices - given.vertices[v], axis=1).argmin() for v in (a, b))
    return mesh, *(abfm.function(mesh, f"gaussian:vertex={v},width={width}") for v in nearest)


def test_reach_finds_distant_targets():
    (found, _), (failed, _) = (
        matched(135, Parameters.of(reach=reach, refine=refine), SMALL, width=0.085)
        for reach, refine in ((1.0, 1), (0.0, 0))
    )
    assert found.residual < 0.05
    assert found.verified_residual < 0.1
    assert failed.residual > 0.9 < failed.verified_residual
    assert failed.verdict.kind == "not reached"
    assert "squeezed" in failed.verdict.reason


def test_distant_target_on_a_body_is_found():
    given = body("human_A.off", 7, 300, 0.1, vertices=500)
    p = Parameters.of(iterations=120, alpha=0.003, divergence=1.0, refine=0)
    assert abfm.match(*given, p).residual < 0.3
    assert abfm.match(*given, p.with_values(reach=0.0)).residual > 0.6
    close = abfm.match(*given, Parameters(refine=0, divergence=1.0, sigma=0.003))
    assert close.residual < 0.05
    assert close.worse_residual < 0.5
    shared = abfm.match(*given, Parameters(refine=0, divergence=1.0))
    assert shared.worse_residual < 0.35


def test_field_moves_other_functions_like_a_rotation():
    match, _ = matched(60, SHORT_RUN, SMALL, 0.2)
    for t in (0.5, 1.0):
        arrived = match.push(at(0, SMALL, 0.2), t)
        centre = arrived @ SMALL.vertices / arrived.sum()
        expected = at(60 * t, SMALL, 0.2) @ SMALL.vertices / at(60 * t, SMALL, 0.2).sum()
        assert centre @ expected / np.linalg.norm(centre) / np.linalg.norm(expected) > 0.98


@pytest.mark.parametrize("levels", [2, 3])
def test_match_over_several_levels_ends_on_the_mesh(levels):
    # with a larger weight of the divergence, coarse meshes need more iterations
    match, seen = matched(80, SHORT_RUN.with_values(levels=levels, divergence=1.0))
    assert match.velocity.shape == (1, len(SPHERE.faces), 3)
    assert match.advected.shape == (len(SPHERE.vertices), 1)
    assert match.residual < 0.15
    assert_allclose(match.push(at(0), 1.0), match.advected[:, 0], atol=1e-6)
    assert len(match.energy_history) == len(match.stages) == len(seen) <= 61
    assert [one.level for one in seen] == sorted(one.level for one in seen)
    # a match that is confirmed skips the levels in between
    assert {0, levels - 1} <= {one.level for one in seen}
    counts = list({one.level: one.vertices for one in seen}.values())
    assert counts == sorted(counts)
    assert counts[-1] == len(SPHERE.vertices)
    assert counts[0] == pytest.approx(len(SPHERE.vertices) / 4 ** (levels - 1), rel=0.1)
    for one in (seen[0], seen[-1]):
        assert one.velocity.shape == match.velocity.shape
        assert one.advected.shape == match.advected.shape
    assert [one.iteration for one in seen] == list(range(len(seen)))
    assert (np.diff(match.stages) >= 0).all()


@pytest.mark.parametrize("iterations", [0, 1, 2, 7])
@pytest.mark.parametrize(
    "changes", [{}, {"levels": 3, "refine": 0}, PAPER, {"cooling_stages": 1, "refine": 0}]
)
def test_few_iterations_are_not_exceeded(iterations, changes):
    match, _ = matched(50, Parameters.of(**changes, iterations=iterations), SMALL)
    assert 1 <= len(match.energy_history) <= iterations + 1
    assert match.velocity.shape == (1, len(SMALL.faces), 3)
    if iterations == 0:
        assert not match.velocity.any()
    else:
        assert match.residual < match.initial_residual * (1 + 1e-9)


def test_linearised_steps_may_use_several_meshes():
    p = Parameters.of(iterations=40, levels=2, method="linearised", segments=8)
    match, _ = matched(40, p, SMALL, 0.2)
    assert match.velocity.shape == (8, len(SMALL.faces), 3)
    assert match.residual < 0.4 * match.initial_residual


@pytest.fixture
def control():
    return abfm.workers.Control()


@pytest.mark.parametrize("iteration", [0, 3, 20])
def test_match_cancelled_on_coarse_level_is_on_the_mesh(iteration, control):
    seen = []

    def stop(one):
        seen.append(one)
        if one.iteration == iteration:
            control.cancel()

    match, _ = matched(80, SHORT_RUN.with_values(levels=3), on_iteration=stop, control=control)
    assert match.stop_reason == "cancelled"
    assert seen[-1].level == 0
    assert len(match.energy_history) == iteration + 1
    assert match.velocity.shape == (1, len(SPHERE.faces), 3)
    assert bool(match.velocity.any()) == (iteration > 0)
    assert_array_equal(match.velocity, seen[-1].velocity)


@pytest.mark.parametrize("is_stabilising", [True, False])
def test_match_can_be_cancelled_between_two_levels(is_stabilising, control, monkeypatch):
    evaluate, to_finer = Objective.evaluate, Level.fields_to_finer

    def overflowing(objective, fields):
        found = evaluate(objective, fields)
        if found.advected.shape[1] < len(SPHERE.vertices) or control.cancelled:
            return found
        control.cancel()
        return replace(found, advected=np.full_like(found.advected, np.nan))

    def cancelling(level, fields):
        control.cancel()
        return to_finer(level, fields)

    if is_stabilising:
        monkeypatch.setattr(Objective, "evaluate", overflowing)
    else:
        monkeypatch.setattr(Level, "fields_to_finer", cancelling)
    match, seen = matched(60, SHORT_RUN.with_values(levels=2), control=control)
    assert match.stop_reason == "cancelled"
    assert {one.level for one in seen} == {0}
    assert match.velocity.any()


@pytest.mark.parametrize("after", [0, 5])
def test_cancel_in_second_variant_keeps_the_first(control, after):
    """The first variant is returned, since the second one has not found the target yet."""
    seen, begun = [], []

    def stop(one):
        seen.append(one)
        if len(one.velocity) > 1:
            begun.append(one)
        if len(begun) > after:
            control.cancel()

    p = Parameters.of(levels=1, refine=0)
    match, _ = matched(120, p, SMALL, 0.07, on_iteration=stop, control=control)
    residuals = [max(step.residual, step.verified_residual) for step in match.path]
    assert begun[0].residual > 0.8 > 0.4 > match.worse_residual == min(residuals)
    assert {step.velocity.shape for step in match.path} == {(1, len(SMALL.faces), 3)}


def test_cancelled_refinement_keeps_a_better_coarse_result(control, monkeypatch):
    """A step on a subdivided mesh may have a much larger residual than the coarser steps."""

    def diverged(state, stage, point):
        found = verified(state, stage, point)
        if state.unrefined:
            return replace(found, residual=1e14)
        # the first step on the mesh is the best one, so that smaller values of sigma follow later
        is_first = stage.level == 1 and all(result.stage.level == 0 for result in state.path)
        residual = 1e-3 if is_first else 1.0
        return replace(found, residual=residual, measures={"verified_residual": residual})

    def stop(one):
        seen.append(one)
        if any(step.residual > 1e10 for step in one.path):
            control.cancel()

    seen, verified = [], continuation._verified
    monkeypatch.setattr(continuation, "_verified", diverged)
    p = Parameters.of(levels=2, refine=1, goal=1e-4)
    match, _ = matched(30, p, SMALL, 0.2, control=control, on_iteration=stop)
    assert seen[-1].vertices > len(SMALL.vertices)
    assert match.stop_reason == "cancelled"
    assert match.worse_residual == 1e-3
    assert match.velocity.shape[1] == len(SMALL.faces)


def test_start_that_misses_the_target_begins_a_search():
    p, field = (
        SHORT_RUN.with_values(levels=2, sigma=0.02),
        rotation_field(SPHERE, [-np.deg2rad(60), 0, 0]),
    )
    match, seen = matched(60, p, start=field)
    assert {one.level for one in seen} == {0}
    assert {one.levels for one in seen} == {1}
    assert_allclose(seen[0].velocity[0], field, atol=1e-12)
    assert seen[0].sigma == p.last_sigma
    assert match.residual <= seen[0].residual
    p, field = SHORT_RUN.with_values(levels=2), rotation_field(SPHERE, [np.deg2rad(60), 0, 0])
    match, seen = matched(60, p, start=field)
    assert {one.level for one in seen} == {0, 1}
    assert seen[0].reach == p.solver.reach
    # the search begins with the given field
    assert relative_error(SPHERE, seen[0].advected[:, 0], at(-60)) < 0.4
    assert match.residual < 0.15


@pytest.mark.parametrize("levels", [1, 2])
def test_overflowing_start_is_ignored(levels):
    p = SHORT_RUN.with_values(iterations=20, levels=levels)
    noise = 30 * np.random.default_rng(0).normal(size=(len(SMALL.faces), 3))
    with_noise, without = (matched(60, p, SMALL, start=start)[0] for start in (noise, None))
    assert_array_equal(with_noise.velocity, without.velocity)
    given, _ = matched(60, p.with_values(iterations=0, levels=1), SMALL, start=noise)
    assert given.velocity.any()  # without iterations, the start itself is the result


def test_without_reach_every_start_is_continued():
    p = SHORT_RUN.with_values(iterations=3, reach=0, levels=2)
    _, seen = matched(60, p, start=wavy_field(SPHERE, 1))
    assert {one.vertices for one in seen} == {len(SPHERE.vertices)}
    p = SHORT_RUN.with_values(iterations=2, reach=0)
    match, _ = matched(60, p, SMALL, start=rotation_field(SMALL, [0, 0, 900]))
    assert np.isfinite(match.residual)
    assert np.isnan(match.verified_residual)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize(("tip", "start"), [(0.6, None), (0.6, 1e-10), (1.5, None)])
def test_sliver_never_makes_residual_worse(tip, start):
    """The residual never exceeds that of the start; unguarded, slivers gave up to 1e144."""
    corners = [[0, 0, 0], [1, 0, 0], [0.3, 0.9, 0], [tip, -1e-10, 0]]
    mesh = TriangleMesh(np.array(corners), [[0, 1, 2], [1, 0, 3]])
    given = None if start is None else start * wavy_field(mesh, 0)
    p = Parameters.of(iterations=8, refine=1)
    for a, b in ((0, 2), (3, 0), (3, 1), (3, 2)):
        f, g = bump(mesh, mesh.vertices[a], 0.15), bump(mesh, mesh.vertices[b], 0.15)
        match = abfm.match(mesh, f, g, p, start=given)
        unchanged = abfm.match(mesh, f, g, p.with_values(iterations=0), start=given)
        assert match.residual <= max(match.initial_residual, unchanged.residual)


def test_result_is_bitwise_reproducible_with_other_threads():
    """Matches in other threads, which use the same coarse meshes, do not change a bit."""
    p = SHORT_RUN.with_values(levels=2)
    alone = abfm.match(SPHERE, at(0), at(70), p)
    others = [
        threading.Thread(target=abfm.match, args=(icosphere(3), at(a, SMALL), at(50, SMALL), p))
        for a in (0, 100)
    ]
    for thread in others:
        thread.start()
    together = abfm.match(TriangleMesh(SPHERE.vertices, SPHERE.faces), at(0), at(70), p)
    for thread in others:
        thread.join()
    for name in ("velocity", "advected", "energy_history", "stages"):
        assert_array_equal(getattr(alone, name), getattr(together, name))
    for name in ("mismatch", "verified_residual", "folded"):
        assert getattr(alone, name) == getattr(together, name)


def test_residual_is_nearly_invariant():
    mesh = potato(3)
    f, g = (bump(mesh, mesh.vertices[vertex], 0.2) for vertex in (7, 60))
    p = Parameters.of(levels=2, refine=0)
    here = abfm.match(mesh, f, g, p)
    turned = moved(mesh, Rotation.from_rotvec([1.0, 0.4, -0.3]).as_matrix(), 1e3)
    mixed, vertices, _ = renumbered(mesh, 2)
    assert here.worse_residual < 0.1
    for given in ((turned, f, g), (mixed, f[vertices], g[vertices]), (mesh, 1e6 * f, 1e6 * g)):
        one = abfm.match(*given, p)
        assert abs(one.residual - here.residual) < 0.03
        assert abs(one.verified_residual - here.verified_residual) < 0.1


@pytest.mark.parametrize("mesh", [SMALL, hemisphere(12)], ids=["closed", "boundary"])
def test_flow_line_residual_equals_the_verification(mesh):
    f, g = (
        np.stack([bump(mesh, mesh.vertices[i], 0.25) for i in pair], axis=1)
        for pair in ((5, 40), (20, 70))
    )
    weighted = {"mask": np.linspace(0, 1, len(mesh.vertices)), "weights": [1.0, 0.3]}
    for extras in ({}, weighted):
        match = abfm.match(mesh, f, g, Parameters.of(iterations=20, segments=2), **extras)
        found = match.verify(subdivided=False)
        assert match.verified_residual == pytest.approx(found.flow_lines, rel=1e-9)
        assert match.folded == pytest.approx(found.folded, abs=1e-12)


def test_schedule_of_the_paper_uses_only_sigma():
    p = Parameters.of(
        **PAPER, alpha=0.02, sigma=1e-3, cooling_stages=3, cooling_factor=10, iterations=40
    )
    match, seen = matched(40, p, SMALL, 0.2)
    assert {(one.level, one.levels, one.reach) for one in seen} == {(0, 1, 0.0)}
    assert [one.sigma for one in seen] == [p.stage_sigmas()[stage] for stage in match.stages]
    assert np.bincount(match.stages).tolist() == [11, 10, 20]
    x = to_frame(SMALL, seen[-1].velocity) / SMALL.length_scale
    R = Regularizer(SMALL.normalized(), 0.02)
    expected = sum(float((v * R.apply(v)).sum()) for v in x) / 2
    assert match.energy_history[-1, 1] == pytest.approx(expected, rel=1e-9)
    for stage in range(3):
        assert (np.diff(match.energy_history[match.stages == stage, 0]) <= 0).all()
    assert match.residual < 0.05
    absolute = Parameters.of(**PAPER, sigma=0.05, cooling_stages=1, iterations=15)
    one, _ = matched(40, absolute, SMALL, 0.2)
    relative = 0.05 / one.problem.functions.function_size
    other, _ = matched(40, absolute.with_values(sigma=relative, sigma_unit="relative"), SMALL, 0.2)
    assert_allclose(one.energy_history, other.energy_history, rtol=1e-6)
