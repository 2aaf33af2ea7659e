"""Fields of sequences: known motions, symmetries, time, noise, and verdicts."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import abfm
from abfm import AbfmError, TriangleMesh
from abfm.calculus.operators import curl, divergence, face_areas
from abfm.calculus.vector_fields import to_frame
from abfm.maps import vertex_points
from abfm.matching.judging.cause import Cause
from abfm.matching.judging.verdict import Verdict
from abfm.outcome import Outcome
from abfm.sequences import defaults
from abfm.sequences.frames import check_frames
from abfm.sequences.noise import noise_levels
from abfm.sequences.solving.choosing import change_rates
from abfm.sequences.solving.solve import IntervalMeasures, SequenceSolver
from abfm.sequences.verdicts import facts_of_intervals, verdict_of
from abfm.workers import Control
from abfm.workers.progress import reporting_steps
from tests.core.sequences import rotating_sphere
from tests.core.sequences.known_motions import (
    SPHERE,
    bumps,
    coordinates,
    relative_field_error,
    rotating_pattern,
)
from tests.core.surfaces import last_order
from tests.messages import check_message, raises
from tests.shapes import icosphere, square, torus, with_loose_vertex

SETTINGS = defaults(order=1, alpha=1, sigma=0.3)


@pytest.fixture(scope="module")
def pattern():
    return rotating_pattern(SPHERE, 0.1, 4)


@pytest.fixture(scope="module")
def found(pattern):
    return abfm.sequence(SPHERE, pattern[0], parameters=SETTINGS)


def test_rotating_pattern_gives_the_rotation(pattern, found):
    frames, expected = pattern
    assert found.velocity.shape == (3, len(SPHERE.faces), 3)
    for i in range(3):
        assert relative_field_error(SPHERE, found.velocity[i], expected, frames[i]) < 0.15
    assert found.confirmed == len(found) == 3


def errors_of_rotation(parameters):
    errors = []
    for level in (2, 3, 4):
        mesh = icosphere(level)
        frames, expected = rotating_pattern(mesh, 0.1, 2, coordinates)
        found = abfm.sequence(mesh, frames, parameters=parameters)
        errors.append(relative_field_error(mesh, found.velocity[0], expected, frames[0]))
    return errors


def test_error_converges_with_the_mesh():
    assert last_order(errors_of_rotation(defaults(sigma=1e-3, order=2, alpha=0.01))) > 1.5


def test_error_with_a_chosen_norm_converges():
    errors = errors_of_rotation(defaults(sigma=1e-3))
    assert np.log2(errors[0] / errors[2]) / 2 > 1.7
    assert last_order(errors) > 1.45


def test_unequal_intervals_give_the_same_motion():
    frames, expected = rotating_pattern(SPHERE, 0.05, 6)
    chosen = [0, 1, 3, 5]
    close = defaults(sigma=0.1)
    found = abfm.sequence(SPHERE, frames[chosen], np.array(chosen, float), close)
    for i, frame in enumerate(chosen[:-1]):
        assert relative_field_error(SPHERE, found.velocity[i], expected, frames[frame]) < 0.12


def test_fields_follow_units_offsets_and_rotations(pattern, found):
    turn = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    other = abfm.TriangleMesh(7 * SPHERE.vertices @ turn.T + 3, SPHERE.faces)
    there = abfm.sequence(other, 1e4 * pattern[0] - 5, 0.01 * np.arange(4), SETTINGS)
    assert_allclose(there.velocity, 700 * found.velocity @ turn.T, rtol=1e-5, atol=7e-5)
    assert_allclose(there.uncertainty, 700 * found.uncertainty, rtol=1e-3)
    assert_allclose(there.determined, found.determined, rtol=1e-3, atol=1e-6)


def test_renumbered_vertices_give_the_same_fields(pattern, found):
    order = np.random.default_rng(1).permutation(len(SPHERE.vertices))
    place = np.argsort(order)
    mesh = abfm.TriangleMesh(SPHERE.vertices[order], place[SPHERE.faces])
    other = abfm.sequence(mesh, pattern[0][:, order], parameters=SETTINGS)
    assert_allclose(other.velocity, found.velocity, rtol=1e-4, atol=1e-6)


def test_reversed_time_reverses_the_fields(pattern, found):
    back = abfm.sequence(SPHERE, pattern[0][::-1], parameters=SETTINGS)
    assert_allclose(back.velocity[::-1], -found.velocity, atol=0.1 * np.abs(found.velocity).max())


def test_sweeps_lower_the_total_energy(pattern):
    rng = np.random.default_rng(0)
    noisy = pattern[0] + 0.1 * pattern[0].std() * rng.standard_normal(pattern[0].shape)
    totals, changes = [], []
    for gamma in (0.0, 1.0, 10.0):
        solver = SequenceSolver(check_frames(SPHERE, noisy, None, None, None), SETTINGS, gamma)
        solver.run(lambda i: None)
        changes.append(np.linalg.norm(np.diff(solver.fields, axis=0)))
        before = solver.total_energy()
        solver._smooth_in_time()
        totals.append((before, solver.total_energy()))
    assert changes[0] > changes[1] > changes[2]
    for before, after in totals:
        assert after <= before * (1 + 1e-12)


def test_smoothness_in_time_reduces_noise_errors():
    frames, expected = rotating_pattern(SPHERE, 0.05, 6)
    rng = np.random.default_rng(0)
    noisy = frames + 0.1 * frames.std() * rng.standard_normal(frames.shape)
    means = []
    for gamma in (0.0, 3.0):
        found = zip(
            abfm.sequence(SPHERE, noisy, None, SETTINGS, gamma).velocity, frames, strict=False
        )
        means.append(np.mean([relative_field_error(SPHERE, v, expected, f) for v, f in found]))
    separate, together = means
    assert together < separate


def test_gamma_0_solves_intervals_separately(pattern):
    absolute = replace(SETTINGS, sigma_unit="absolute")  # independent of the other frames
    separate = abfm.sequence(SPHERE, pattern[0][:2], parameters=absolute, gamma=0)
    among = abfm.sequence(SPHERE, pattern[0], parameters=absolute, gamma=0)
    assert_array_equal(among.velocity[0], separate.velocity[0])


def test_chosen_sigma_grows_with_the_noise():
    frames, _ = rotating_pattern(SPHERE, 0.1, 3)
    rng = np.random.default_rng(0)
    chosen = [
        abfm.sequence(SPHERE, frames + noise * frames.std() * rng.standard_normal(frames.shape))
        for noise in (0.0, 0.5)
    ]
    assert chosen[0].sigma < chosen[1].sigma
    assert chosen[0].noise < 0.15 < 0.5 < chosen[1].noise < 1


def test_masked_values_equal_missing_values_bit_for_bit():
    """Values below the mask are not advected to other places, and do not count as noise."""
    visible, frames = rotating_sphere.MESH.vertices[:, 0] < 0.5, rotating_sphere.rotating_frames()
    complete = abfm.sequence(rotating_sphere.MESH, np.where(visible, frames, np.nan))
    assert complete.confirmed == 4
    for spoiled in (np.inf, 1e200, -3.0):
        given = np.where(visible, frames, spoiled)
        result = abfm.sequence(rotating_sphere.MESH, given, mask=visible).arrays()
        for name, array in complete.arrays().items():
            assert_array_equal(result[name], array, err_msg=name)


def test_channels_of_weight_0_change_nothing(pattern, found):
    for other in (np.full_like(pattern[0], np.nan), 1e20 * np.roll(pattern[0], 7, axis=1)):
        both = np.stack([pattern[0], other], axis=2)
        result = abfm.sequence(SPHERE, both, parameters=SETTINGS, weights=[1, 0])
        assert result.frames.shape == both.shape
        assert result.at(0.5).shape == both.shape[1:]
        assert_allclose(result.velocity, found.velocity, atol=1e-12)
        assert result.verdicts == found.verdicts
        assert result.noise == pytest.approx(found.noise, rel=1e-12)


def test_nonfinite_values_are_not_compared(pattern, found):
    holes = pattern[0].copy()
    hidden = SPHERE.vertices[:, 0] > 0.9
    holes[1:, hidden] = np.nan
    result = abfm.sequence(SPHERE, holes, parameters=SETTINGS)
    assert np.isfinite(result.frames).all()
    visible = ~hidden[SPHERE.faces].any(axis=1)
    errors = np.linalg.norm((result.velocity - found.velocity)[0, visible], axis=1)
    assert np.median(errors) < 0.05 * np.linalg.norm(found.velocity[0], axis=1).mean()


def test_frames_without_values_are_left_out(tmp_path):
    """Numbers and times of the other frames, and the note, stay right in the saved result."""
    frames = rotating_pattern(SPHERE, 0.05, 4)[0]
    given = np.insert(frames, (1, 3), np.nan, axis=0)
    numbers, times = np.array([0, 2, 3, 5]), np.array([0.0, 1.0, 2.5, 3.0, 4.0, 6.0])
    found = [check_frames(SPHERE, given, each, None, None) for each in (None, times)]
    for each, expected in zip(found, (numbers, times[numbers]), strict=True):
        assert_array_equal(each.values[:, :, 0], frames)
        assert_array_equal(each.times, expected)
        assert_array_equal(each.numbers, numbers)
        assert each.notes == ("2 frames without values left out, counted from 0: 1, 4",)
    few = abfm.sequence(SPHERE, given[:4], parameters=SETTINGS, dt=0.1)
    few.save(tmp_path / "s.npz")
    saved = abfm.load(tmp_path / "s.npz")
    assert_array_equal(saved.numbers, [0, 2, 3])
    assert_allclose(saved.times, [0, 0.2, 0.3])
    assert saved.notes == few.notes == ("1 frame without values left out, counted from 0: 1",)


def test_given_frames_are_not_changed():
    mesh = with_loose_vertex(icosphere(1))
    given = np.arange(2.0)[:, None] + mesh.vertices[:, 0]
    given[1, 4] = np.nan
    given.flags.writeable = False
    assert np.isfinite(check_frames(mesh, given, None, None, None).values).all()


def test_interpolated_frames_are_closer_than_the_blend(pattern, found):
    frames, _ = pattern
    assert_array_equal(found.at(0), frames[0])
    assert_array_equal(found.at(3), frames[3])
    assert_array_equal(found.at(2), frames[2])
    between = rotating_pattern(SPHERE, 0.05, 2)[0][1]
    error = np.linalg.norm(found.at(0.5) - between)
    assert error < 0.5 * np.linalg.norm((frames[0] + frames[1]) / 2 - between)
    for t in (-0.1, 3.1, np.nan):
        with raises(AbfmError, 0, 3):
            found.at(t)


def test_match_of_an_interval_agrees_with_the_sequence(found):
    match = found[1]
    assert match.residual == found.residual[1]
    assert match.velocity[0] is not None
    assert_array_equal(match.velocity[0], found.velocity[1])
    assert match.problem.functions.residual(match.advected.T) == pytest.approx(
        found.residual[1], rel=1e-6
    )
    assert match.verify(subdivided=False).flow_lines == pytest.approx(
        found.verified_residual[1], rel=1e-6
    )
    assert match.reverified().load_warning == ""
    assert len(list(found)) == 3
    assert found[-1].residual == found.residual[2]


def test_path_lines_rotate_with_the_pattern():
    frames, _ = rotating_pattern(SPHERE, 0.1, 5)
    found = abfm.sequence(SPHERE, frames, parameters=defaults(sigma=0.3))
    start = vertex_points(SPHERE, np.flatnonzero(np.abs(SPHERE.vertices[:, 2]) < 0.4))
    paths = found.paths(start)
    assert len(paths) == 5
    x, y, _ = paths[-1].positions.T
    a, b, _ = start.positions.T
    turned = np.angle((x + 1j * y) / (a + 1j * b))
    assert np.median(np.abs(turned - 0.4)) < 0.04
    later = found.paths(start, 2.5)
    for other in (np.eye(3), vertex_points(icosphere(1))):
        with raises(AbfmError):
            found.paths(other)
    assert len(later) == 3
    x, y, _ = later[-1].positions.T
    assert np.median(np.abs(np.angle((x + 1j * y) / (a + 1j * b)) - 0.15)) < 0.02


def test_parts_have_divergence_and_curl(found):
    gradient, rotated, harmonic = found.parts(0)
    assert_allclose(gradient + rotated + harmonic, found.velocity[0], atol=1e-10)
    field = to_frame(SPHERE, found.velocity[1]).ravel()
    assert_array_equal(found.divergence[1], divergence(SPHERE) @ field)
    assert_array_equal(found.curl[1], curl(SPHERE) @ field)
    assert_allclose(
        found.curl[1] @ SPHERE.vertices[:, 2], (found.curl[1] * SPHERE.vertices[:, 2]).sum()
    )
    areas = face_areas(SPHERE)
    squares = areas @ (found.velocity[2] ** 2).sum(axis=1)
    assert found.speed[2] == pytest.approx(np.sqrt(squares / areas.sum()))


def test_rotation_has_two_spirals_at_the_poles(found):
    tracks = found.tracks()
    poles = [t for t in tracks if t.kind == "spiral" and len(t) == 3]
    heights = sorted(t.points.positions[:, 2].mean() for t in poles)
    assert heights[0] < -0.9
    assert heights[-1] > 0.9


def test_cancelled_sequence_keeps_solved_fields(pattern):
    control = Control()
    stop = {"control": control, "on_interval": lambda i: control.cancel() if i == 1 else None}
    result = abfm.sequence(SPHERE, pattern[0], parameters=SETTINGS, **stop)
    assert all(np.abs(field).max() > 0 for field in result.velocity[:2])
    assert_array_equal(result.velocity[2], 0)
    assert result.verdicts[2].kind == "not reached"
    assert result.confirmed == 2
    assert_array_equal(result.solved, [True, True, False])


def test_episodes_use_solved_intervals_only(found):
    unsolved = verdict_of(found[0].problem, None, None, False)
    verdicts = (found.verdicts[0], unsolved, found.verdicts[2])
    still = found.velocity * np.array([1, 0, 1])[:, None, None]
    assert [each.kind for each in replace(found, velocity=still).episodes()] == [
        *("transient", "stable", "transient")
    ]
    assert replace(found, velocity=still, verdicts=verdicts).episodes() == []


@pytest.mark.parametrize(("values", "time"), [(1, 250), (1e20, 1e-15), (1e-20, 1e15)])
def test_flows_are_independent_of_units(values, time, pattern, found):
    result = abfm.sequence(SPHERE, values * pattern[0], time * (np.arange(4) - 3), SETTINGS)
    assert_allclose(time * result.velocity, found.velocity, rtol=1e-9, atol=1e-11)
    assert result.verdicts == found.verdicts


@pytest.mark.parametrize(
    ("values", "time", "named"),
    [
        (1e90, 1, ("1.78e+90", 1)),
        (1e-90, 1, ("1.78e-90",)),
        (1e160, 1, ("1.78e+160",)),
        (1, 1e-60, ("1e-60",)),
        (1, 1e60, ("1e+60",)),
    ],
)
def test_values_whose_squares_overflow_are_refused(values, time, named, pattern):
    for given in (SETTINGS, defaults(sigma=0.3, sigma_unit="absolute"), None):
        with raises(AbfmError, *named):
            abfm.sequence(SPHERE, values * pattern[0], time * np.arange(4), given)


def test_run_cancelled_before_sigma_has_no_motion(pattern):
    control = Control()

    def stop(now):
        if now is not None and "sigma" in now.task:
            control.cancel()

    with reporting_steps(stop):
        result = abfm.sequence(SPHERE, pattern[0], control=control)
    assert np.isnan(result.sigma)
    assert_array_equal(result.velocity, 0)
    assert result[0].verdict.kind == "not reached"


def test_noise_is_estimated_from_compared_values(pattern):
    rng, level = np.random.default_rng(0), 0.3 * pattern[0].std()
    noisy = pattern[0] + level * rng.standard_normal(pattern[0].shape)
    for known in (SPHERE.vertices[:, 0] < 2, SPHERE.vertices[:, 0] < 0.2):
        holes = np.where(known, noisy, np.nan)
        expected = np.sqrt(2) * level / np.sqrt(np.mean(noisy[:, known] ** 2))
        result = abfm.sequence(SPHERE, holes, parameters=SETTINGS).noise
        assert result == pytest.approx(expected, rel=0.2)


def test_changes_count_compared_values_only(pattern):
    """Sigma is chosen by intervals in which compared values change."""
    frames, visible = pattern[0], SPHERE.vertices[:, 0] < 0.2
    other = np.random.default_rng(0).standard_normal(frames.shape)
    both = np.stack([frames, other], axis=2)
    plain, weighed, masked, unseen = (
        change_rates(check_frames(SPHERE, values, None, mask, weights))
        for values, mask, weights in (
            (frames, None, None),
            (both, None, [1, 0]),
            (frames, visible, None),
            (np.where(visible, frames, other), visible, None),
        )
    )
    assert_allclose(weighed, plain)
    assert_allclose(unseen, masked)


def test_mask_too_small_for_held_out_patches_is_refused(pattern):
    mask = np.zeros(len(SPHERE.vertices))
    mask[3] = 1
    with raises(AbfmError):
        abfm.sequence(SPHERE, pattern[0], mask=mask)
    assert abfm.sequence(SPHERE, pattern[0], parameters=SETTINGS, mask=mask).sigma == SETTINGS.sigma


@pytest.mark.parametrize(("noise", "step"), [(0.0, 1.0), (0.05, 0.001)])
def test_distant_frames_are_matched_for_any_unit_of_time(noise, step):
    rng, width, angle = np.random.default_rng(0), 0.4, 1.6  # apart by four times the width
    turns = [[np.cos(angle * t), np.sin(angle * t), 0] for t in range(3)]
    frames = [np.exp(-((SPHERE.vertices - c) ** 2).sum(axis=1) / (2 * width**2)) for c in turns]
    frames += noise * rng.standard_normal((3, len(SPHERE.vertices)))
    found = abfm.sequence(SPHERE, frames, step * np.arange(3), SETTINGS)
    assert found.confirmed == 2
    paths = found.paths([int(np.argmax(SPHERE.vertices @ turns[0]))])
    for point, centre in zip(paths, turns, strict=True):
        assert np.linalg.norm(point.positions[0] - centre) < 0.5 * width


def test_change_without_motion_is_not_confirmed():
    frames, _ = rotating_pattern(SPHERE, 0.06, 6)
    rng = np.random.default_rng(0)
    frames = frames + 0.1 * frames.std() * rng.standard_normal(frames.shape)
    frames[3] = frames.std() * rng.standard_normal(frames.shape[1])
    kinds = [v.kind for v in abfm.sequence(SPHERE, frames, parameters=SETTINGS).verdicts]
    assert [kind.is_good for kind in kinds] == [True, True, False, False, True]


def test_intervals_without_motion_are_not_coupled():
    moved = bumps([0, 0.2, 0.4], noise=0)
    other = np.exp(-((SPHERE.vertices[:, 2] - 1) ** 2) / 0.1) * [[2.0], [2.1], [2.2]]
    complete = abfm.sequence(SPHERE, np.concatenate([moved, other]), parameters=SETTINGS)
    assert complete.verdicts[2].kind == "impossible"
    scale = check_frames(SPHERE, complete.frames[:, :, 0], None, None, None).deviation
    separate = abfm.sequence(
        SPHERE, moved, parameters=replace(SETTINGS, sigma=0.3 * scale, sigma_unit="absolute")
    )
    # up to the tolerance at which sweeps stop
    errors = np.linalg.norm(complete.velocity[:2] - separate.velocity)
    assert errors < 0.05 * np.linalg.norm(separate.velocity)


def test_gap_in_time_is_matched():
    frames, _ = rotating_pattern(SPHERE, 0.1, 4)
    found = abfm.sequence(SPHERE, frames, [0, 1, 101, 102], SETTINGS)
    assert found.confirmed == 3
    assert found.residual.max() < 0.02
    assert found.speed[[0, 2]] == pytest.approx(100 * found.speed[1], rel=0.2)


def test_flattened_bump_is_not_a_motion():
    frames = np.concatenate([bumps([0], 0.4), bumps([3], 0.2)])
    checked = check_frames(SPHERE, frames, None, None, None)
    problem = checked.problem(0, SETTINGS.for_interval(1.0, 0.3))
    functions = problem.functions
    gone = functions.source * 0.01  # as if the flow had squeezed the bump away
    residual = functions.residual(gone)
    assert residual < 1.1 < 0.6 * functions.residual(functions.source)
    measures = IntervalMeasures(gone, np.zeros((2, 3)), residual, residual, 0.0)
    assert verdict_of(problem, measures, noise_levels(checked), True).kind == "not reached"


def test_field_that_explains_little_is_not_confirmed():
    frames, still = rotating_pattern(SPHERE, 0.07, 3, coordinates)[0], defaults(sigma=30)
    assert abfm.sequence(SPHERE, frames, parameters=SETTINGS).confirmed == 2
    result = abfm.sequence(SPHERE, frames, parameters=still)
    assert result.residual.max() < 0.1
    assert result.confirmed == 0
    check_message(result.verdicts[0].reason)


def test_motion_on_slivers_is_not_called_noise():
    """Reasons of unmatched motion name details narrower than edges, not only noise or no motion."""
    mesh = torus(12, 40)  # edges around the axis are ten times as long as those around the tube

    def bump(angle):
        place = [1.4 * np.cos(angle), 1.4 * np.sin(angle), 0]
        return np.exp(-0.5 * (np.linalg.norm(mesh.vertices - place, axis=1) / 0.5) ** 2)

    [result] = abfm.sequence(mesh, [bump(0.0), bump(0.05)]).verdicts
    assert result.kind == "not reached"
    check_message(result.reason)
    # a wave of two edges per length looks random when compared with neighbours only
    long = TriangleMesh(square(20).vertices * [1, 40, 1], square(20).faces)
    waves = [np.cos(20 * np.pi * (long.vertices[:, 1] / 40 - shift)) for shift in (0, 0.01)]
    [result] = abfm.sequence(long, waves).verdicts
    check_message(result.reason, "only noise or details narrower than edges")
    checked = check_frames(mesh, [bump(0.0), bump(0.05)], None, None, None)
    problem, levels = checked.problem(0, SETTINGS.for_interval(1.0, 0.3)), noise_levels(checked)
    residual = checked.problem(0, SETTINGS.for_interval(1.0, 0.3)).functions.residual(
        problem.functions.source
    )
    still = IntervalMeasures(problem.functions.source, np.zeros((2, 3)), residual, residual, 0.0)
    result = verdict_of(problem, still, levels, True)
    check_message(result.reason, "0.88")
    only_lines = replace(still, verified_residual=residual / 9)
    check_message(verdict_of(problem, only_lines, levels, True).reason)


@pytest.mark.parametrize("values", [(0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (1.0, 2.0, 3.0)])
def test_constant_frames_determine_no_motion(values):
    frames = np.outer(values, np.ones(len(SPHERE.vertices)))
    found = abfm.sequence(SPHERE, frames)
    assert [v.kind for v in found.verdicts] == [Outcome.NOT_REACHED] * 2
    assert {v.cause for v in found.verdicts} == {Cause.BOTH_CONSTANT}
    assert (found.facts.outcome, found.facts.tone) == (Outcome.NOT_REACHED, "failure")
    check_message(found.facts.reason)


def test_equal_varying_frames_are_matched_without_motion():
    found = abfm.sequence(SPHERE, np.tile(SPHERE.vertices[:, 2], (3, 1)))
    assert_array_equal(found.velocity, 0)
    assert (found.confirmed, found.episodes(), found.tracks(1)) == (2, [], [])
    assert [v.kind for v in found.verdicts] == [Outcome.MATCHED] * 2
    assert (found.facts.outcome, found.facts.tone) == (Outcome.MATCHED, "good")


@pytest.mark.parametrize(
    ("outcomes", "outcome", "tone"),
    [
        (["matched", "matched"], "matched", "good"),
        (["nearly", "nearly"], "nearly", "warning"),
        (["matched", "not reached"], "matched", "warning"),
        (["matched", "registered", "not reached", "impossible"], "matched", "warning"),
        (["nearly", "registered", "registered", "not reached"], "registered", "warning"),
        (["matched", "not reached", "not reached"], "not reached", "failure"),
        (["matched", "impossible", "impossible", "not reached"], "impossible", "failure"),
    ],
)
def test_half_of_the_intervals_decide_the_outcome(outcomes, outcome, tone):
    verdicts = [Verdict(Outcome(each), "a: why", "") for each in outcomes]
    number = np.arange(len(outcomes), dtype=float)
    unknown = np.full_like(number, np.nan)
    facts = facts_of_intervals(verdicts, number, unknown, number, np.array(0.8))
    assert (facts.outcome, facts.tone) == (outcome, tone)
    assert facts.outcome.is_good == (tone != "failure")
    phrase, share = facts.headline.split(": ")
    assert phrase == {"nearly": "nearly matched"}.get(outcome, outcome)
    assert share.removesuffix(" confirmed") not in facts.reason  # it is not repeated
    assert facts.numbers == {
        "residual": np.median(number),
        "verified_residual": None,
        "folded": np.median(number),
        "motion_share": 0.8,
    }


def test_interval_is_judged_by_its_own_noise():
    none = np.nan
    frames = bumps([0, 0.2, 0.4, none, none, none, 0, 0.2])
    found = abfm.sequence(SPHERE, frames, parameters=SETTINGS)
    # pure noise has no motion; a bump that appears or disappears does not move
    kinds = [v.kind for v in found.verdicts]
    assert [kind.is_good for kind in kinds] == [True, True, *4 * [False], True]
    assert {kinds[2], kinds[5]} == {Outcome.IMPOSSIBLE}
    for verdict in found.verdicts[3:5]:
        check_message(verdict.reason)
    # an offset of the values changes nothing
    lifted = abfm.sequence(SPHERE, frames[:3] + 100.0, parameters=SETTINGS)
    assert lifted.confirmed == 2
    deviations = frames[1:3].std(axis=1)
    assert lifted.noise == pytest.approx(np.sqrt(2) * 0.05 / deviations.mean(), rel=0.2)


def test_noise_is_estimated_on_a_thresholded_surface():
    visible, frames = SPHERE.vertices[:, 0] > 0.5, bumps([0, 0.1, 0.2])
    result = abfm.sequence(SPHERE, np.where(visible, frames, 0.0), parameters=SETTINGS).noise
    known = abfm.sequence(SPHERE, np.where(visible, frames, np.nan), parameters=SETTINGS).noise
    assert visible.mean() < 0.3
    assert result == pytest.approx(known, rel=0.3)


@pytest.mark.parametrize(
    ("frames", "given", "named"),
    [
        (np.zeros((1, 642)), {}, ()),
        (np.zeros((643, 3)), {}, (642, 643)),
        (np.zeros((2, 642)), {"times": [0, 1], "dt": 1}, ("times", "dt")),
        (np.zeros((2, 642)), {"dt": 0}, ("dt", 0)),
        (np.zeros(642), {}, ()),
        (np.full((2, 642), np.nan), {}, ()),
        (np.full((2, 642), np.nan) * [[1], [np.inf]], {}, ()),
        (np.zeros((2, 642)), {"weights": [0]}, ("weights", "zeros")),
        (np.where(np.arange(642) % 2 == [[0], [1]], 1, np.nan), {}, ()),
        (np.zeros((2, 642)), {"times": [0, 0]}, (0,)),
        (np.zeros((3, 642)), {"times": [0, 2, 1]}, (1, 2)),
        (np.zeros((3, 642)), {"times": [0, 1, np.nan]}, (1,)),
        (np.zeros((2, 642)), {"times": [0, np.inf]}, ()),
        (np.zeros((2, 642)), {"times": [0, 1, 2]}, ()),
        (np.zeros((2, 642)), {"gamma": -1}, ("gamma", -1)),
        (np.zeros((2, 642)), {"gamma": np.nan}, ("gamma",)),
        (np.zeros((2, 642)), {"mask": np.ones(3)}, ()),
        (np.zeros((2, 642)), {"mask": np.zeros(642)}, ("mask", "zeros")),
        (np.ones((2, 642)), {"mask": np.arange(642) - 1.0}, ("mask",)),
        (np.zeros((2, 642)), {"times": [-1e308, 1e308]}, ()),
        (np.zeros((2, 642)), {"weights": [1, 2]}, ()),
        (np.zeros((2, 642)), {"parameters": abfm.Parameters()}, ("parameters",)),
        (np.where([[0], [1], [0]], 1, np.full((3, 642), np.nan)), {}, ()),
    ],
)
def test_invalid_input_is_refused_in_one_line(frames, given, named):
    with raises(AbfmError, *named) as error:
        abfm.sequence(SPHERE, frames, **given)
    assert "\n" not in str(error.value)
