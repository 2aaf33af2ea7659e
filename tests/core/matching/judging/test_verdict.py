import itertools
import json
import math
from dataclasses import asdict, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

import abfm
from abfm.errors import ParameterError
from abfm.matching import Remedy
from abfm.matching.judging.cause import Cause
from abfm.matching.judging.remedies import Remedies
from abfm.matching.judging.verdict import Evidence, judge
from abfm.matching.solvability import distance, hardly_moved, range_bound, vanished
from abfm.matching.solving.record import StopReason, early_warning
from abfm.matching.terms.functions import FunctionTerm
from abfm.outcome import Outcome, worse_residual
from abfm.parameters import ALPHA_MAX, COUNT_MAX, PAPER, VALUE_MIN, Parameters
from abfm.wording import share
from tests.core.fields import bump
from tests.messages import check_message, raises
from tests.shapes import disc, ellipsoid, icosphere

SPHERE, FINE, EGG = icosphere(3), icosphere(4), ellipsoid(3, 1.0, 0.7, 0.55)
# without the search for distant targets, so that matches fail for various causes
PAPER_RUN = Parameters.of(**PAPER, alpha=0.02, sigma=1e-3, cooling_factor=10, iterations=150)
SHARE = st.floats(0, 2) | st.sampled_from([0.05, 0.1, 0.15, 0.3])
CONSTANT = np.full(len(SPHERE.vertices), 0.3)


def at(degrees, width=0.15, mesh=SPHERE):
    """Return a Gaussian at this angle from the z axis, on the sphere or on the egg."""
    angle = np.deg2rad(degrees)
    if mesh is EGG:
        return bump(mesh, [np.sin(angle), 0, 0.55 * np.cos(angle)], width)
    return bump(mesh, [0, np.sin(angle), np.cos(angle)], width)


def around(degrees, width=0.1):
    return at(degrees, width, EGG)


def matched(f, g, **parameters):
    return abfm.match(SPHERE, f, g, Parameters.of(**{"refine": 0, **parameters}))


def judged(match, **known):
    last = match.energy_history[match.stages == match.stages[-1], 0]
    evidence = Evidence(match.advected.T, match.residual, match.stop_reason, energies=last, **known)
    functions = FunctionTerm(match.mesh, match.source, match.target, match.mask, match.weights)
    return judge(functions, evidence, match.parameters)


def verdict_of(f, g, advected, reason="converged", parameters=PAPER_RUN, **known):
    """Return the verdict of a match with this advected source (V,)."""
    problem, advected = FunctionTerm(SPHERE, f, g), advected[None]
    evidence = Evidence(advected, problem.residual(advected), StopReason(reason), **known)
    return judge(problem, evidence, parameters)


def labels(found):
    return [remedy.label for remedy in found.remedies]


def test_matched_functions_need_no_advice():
    """A matched source has no advice; the residual of flow lines decides if it is larger."""
    match = matched(at(0), at(45))
    verdict = judged(match)
    assert (verdict.kind, verdict.advice) == (Outcome.MATCHED, "")
    check_message(verdict.reason, share(match.initial_residual), share(match.residual))
    assert judged(match, verified=0.04).kind == "matched"
    assert judged(match, verified=0.08).kind == "nearly"
    check_message(judged(match, verified=0.08).reason, "8%")
    problem, seen = FunctionTerm(SPHERE, at(0), at(45)), []
    abfm.match(SPHERE, at(0), at(45), Parameters.of(iterations=30), on_iteration=seen.append)
    assert len(seen) == 31
    assert not any(vanished(problem, now.advected.T) or now.warning for now in seen)
    assert not hardly_moved(problem, seen[-1].advected.T)


@given(mismatches=st.lists(st.tuples(SHARE, SHARE | st.just(np.nan)), min_size=2, max_size=2))
def test_outcome_depends_on_the_larger_residual(mismatches):
    problem, judged_by = FunctionTerm(SPHERE, at(0), at(40)), []
    for mismatch, verified in mismatches:
        evidence = Evidence(at(38)[None], mismatch, StopReason.CONVERGED, verified)
        kind = judge(problem, evidence, PAPER_RUN).kind
        assert (kind == "matched") == (mismatch <= 0.05 and not verified > 0.05)
        assert (kind == "not reached") == (mismatch > 0.15 or verified > 0.15)
        judged_by.append((worse_residual(mismatch, verified), kind.rank))
    (_, better), (_, worse) = sorted(judged_by)
    assert better <= worse


def test_equal_functions_match_unless_constant():
    flat, noise = np.ones(len(CONSTANT)), 1 + 1e-10 * SPHERE.vertices[:, 0]
    for f, g in itertools.product((noise, flat), repeat=2):
        verdict = judged(matched(f, g, iterations=2))
        assert (verdict.kind, verdict.cause) == (Outcome.IMPOSSIBLE, Cause.BOTH_CONSTANT)
    same = judged(matched(at(0), at(0), iterations=2))
    assert (same.kind, same.advice) == (Outcome.MATCHED, "")
    check_message(same.reason, "0.01%")


def test_verdict_ignores_a_large_constant():
    """A constant offset does not hide a residual, even if functions vary by 1e-8 of it only."""
    f, g, flat = at(0, 0.2), at(30, 0.2), np.ones(len(CONSTANT))
    for size in (1e-2, 1e-5, 1e-8):
        unmoved = judged(matched(1 + size * f, 1 + size * g, iterations=0))
        assert unmoved.kind == "not reached"
        match = matched(1 + size * f, 1 + size * g)
        assert (match.verdict.kind, match.residual < 0.05) == ("matched", True)
        assert judged(matched(1 + size * f, flat, iterations=2)).kind == "impossible"


def test_different_ranges_are_impossible():
    match = matched(at(0, 0.2), 2 * at(30, 0.2))
    bound = range_bound(match.problem.functions)
    assert bound > 0.4
    # the outcome does not depend on the discrete flow, which could reach the goal
    assert match.residual < bound + 0.01
    verdict = judged(match)
    assert (verdict.kind, verdict.cause) == (Outcome.IMPOSSIBLE, Cause.VALUES_DIFFER)
    assert "to 2" in verdict.reason
    assert "to 1" in verdict.reason
    assert f"at least {math.floor(100 * bound)}%" in verdict.reason
    assert judged(matched(at(0, 0.2), 1.3 * at(30, 0.2))).kind == "nearly"
    f, g = np.stack([at(0), at(20)], axis=1), np.stack([at(10), 2 * at(30)], axis=1)
    check_message(judged(matched(f, g, iterations=2)).reason, 2)
    weighted = abfm.match(SPHERE, f, g, Parameters.of(iterations=2), weights=[1, 0])
    assert judged(weighted).kind != "impossible"


def test_constant_functions_are_impossible():
    match = matched(at(0, 0.2), CONSTANT)
    to_flat, from_flat = judged(match), judged(matched(CONSTANT, at(0)))
    assert to_flat.kind == from_flat.kind == "impossible"
    assert (to_flat.cause, from_flat.cause) == (Cause.TARGET_CONSTANT, Cause.SOURCE_CONSTANT)
    assert judged(matched(CONSTANT, 2 * CONSTANT)).kind == "impossible"
    assert judged(matched(at(0), 0 * CONSTANT, iterations=3)).kind == "impossible"


def test_vanished_source_is_not_reached():
    f, g, seen = at(0, 0.05, FINE), at(120, 0.05, FINE), []
    problem = FunctionTerm(FINE, f, g)
    match = abfm.match(FINE, f, g, PAPER_RUN.with_values(iterations=20), on_iteration=seen.append)
    verdict = judged(match)
    assert verdict.kind == "not reached"
    check_message(verdict.reason, "144%", "102%")
    check_message(verdict.advice, "reach", 1)
    assert vanished(problem, match.advected.T)
    assert not vanished(problem, match.source.T)
    assert seen[0].warning is None
    check_message(seen[5].warning)
    evidence = Evidence(match.advected.T, match.residual, StopReason.NO_PROGRESS)
    assert distance(problem) == pytest.approx(np.sqrt(3) / FINE.length_scale, abs=0.03)
    check_message(judge(problem, evidence, PAPER_RUN.with_values(reach=1.0)).advice)


def test_unmoved_source_is_not_reached():
    large_sigma = PAPER_RUN.with_values(sigma=10.0, cooling_stages=1)
    match = abfm.match(SPHERE, at(0, 0.1), at(90, 0.1), large_sigma)
    verdict, problem = judged(match), FunctionTerm(SPHERE, match.source, match.target)
    assert verdict.kind == "not reached"
    check_message(verdict.reason)
    assert labels(verdict) == ["Reach further", "Match closer"]
    check_message(verdict.advice, 1)
    assert "more iterations" not in verdict.advice
    assert hardly_moved(problem, match.advected.T)
    assert early_warning(problem, match.advected.T, 2) is None
    warning = early_warning(problem, match.advected.T, 10)
    check_message(warning)
    assert not hardly_moved(problem, match.target.T)


def test_different_peaks_match_only_in_part():
    """One peak cannot become two: a discrete flow that splits it is not confirmed by flow lines."""
    match = matched(at(0), at(50) + at(-50), goal=0.08)
    assert match.residual < 0.08
    unknown, refuted, confirmed = (judged(match, verified=value) for value in (np.nan, 0.7, 0.05))
    assert (unknown.kind, refuted.kind, confirmed.kind) == ("nearly", "not reached", "matched")
    for verdict in (unknown, refuted):
        check_message(verdict.reason, 1, 2)
    check_message(verdict_of(at(0), at(50) + at(-50), at(50)).reason)


def test_different_boundary_values_are_not_reached():
    mesh = disc(16)
    ends = (bump(mesh, [place, 0, 0], 0.1) for place in (0.2, 1))
    verdict = judged(abfm.match(mesh, *ends, Parameters.of(refine=0, iterations=200)), verified=0.7)
    assert verdict.kind == "not reached"
    check_message(verdict.reason, "boundary", 0, 1)


def test_unconfirmed_match_is_not_reached():
    given = at(0), at(40), at(40)
    verdict = verdict_of(*given, verified=0.4)
    assert verdict.kind == "not reached"
    check_message(verdict.reason, "40%")
    check_message(verdict.advice, "reach", 1)
    nearly = verdict_of(*given, verified=0.1)
    assert nearly.kind == "nearly"
    check_message(nearly.reason)
    verdict = verdict_of(*given, folded=0.15)
    assert verdict.kind == "not reached"
    check_message(verdict.reason, "15%")
    confirmed = verdict_of(*given, folded=0.15, verified=0.02)
    assert confirmed.kind == "matched"
    check_message(confirmed.advice, "15%")
    assert verdict_of(*given, folded=0.05).advice == ""


def test_iteration_limit_advises_more_iterations():
    verdict = matched(at(0), at(60), iterations=4).verdict
    assert verdict.kind == "not reached"
    assert verdict.reason.endswith(verdict.why)
    check_message(verdict.why, 4)
    check_message(verdict.advice, 1000)
    assert [(each.label, each.parameters, each.starts_from_field) for each in verdict.remedies] == [
        ("More time", {"iterations": 1000}, False),
        ("Continue", {}, True),
    ]
    few, limit = Parameters.of(iterations=4), "iteration limit"
    nearly = verdict_of(at(0), at(45), at(50), limit, few)
    assert (nearly.kind, nearly.remedies) == ("nearly", verdict.remedies)
    assert labels(verdict_of(at(0), at(45), at(53), limit, few, verified=0.9)) == ["More time"]
    assert labels(verdict_of(at(0), at(45), at(50), limit)) == ["Reach further"]
    unmoved = matched(at(0), at(90), iterations=0).verdict
    assert "0 iterations" in unmoved.reason
    assert labels(unmoved) == ["More time", "Continue"]
    given = at(0), at(60), at(30), limit
    check_message(verdict_of(*given, energies=np.ones(30)).reason)
    check_message(verdict_of(*given, energies=np.linspace(2, 1, 30)).reason)


@pytest.mark.parametrize(
    ("stop_reason", "named"),
    [
        ("cancelled", ""),
        ("line search failed", "0.06"),
        ("converged", "0.00033"),
        ("iteration limit", "reach"),
    ],
)
def test_stop_reason_is_the_last_cause(stop_reason, named):
    """The reason for stopping is the cause of a verdict if there is no other cause."""
    verdict = verdict_of(at(0), at(60), at(30), stop_reason)
    assert verdict.kind == "not reached"
    check_message(verdict.reason, "125%", "73%")
    check_message(verdict.advice, named)


def test_default_alpha_is_advised_if_the_line_search_failed():
    """For alpha = 0 the default is advised if the line search failed, but never a smaller value."""
    given, rough = (at(0), at(60), at(30)), Parameters(alpha=0.0)
    check_message(verdict_of(*given, "line search failed", rough).advice, "0.01")
    assert "alpha" not in verdict_of(*given, "converged", rough).advice


def test_similar_signals_have_a_neutral_reason():
    """Sums of partly shared waves, like measured signals, have a reason without "failed"."""
    rng = np.random.default_rng(1)
    waves = np.sin(5 * SPHERE.vertices @ rng.normal(size=(3, 6)) + rng.normal(size=6)).T
    f, g = waves[:3].sum(axis=0), waves[1:4].sum(axis=0)
    verdict = judged(matched(f, g, iterations=60, alpha=0.3, sigma=0.1))
    assert verdict.kind in ("not reached", "nearly")
    check_message(verdict.reason)
    assert "failed" not in verdict.reason


def test_every_verdict_is_one_line_without_a_full_stop():
    f, g, unknown, kinds = at(0), at(60), np.nan, set()
    for source, target in ((f, g), (f, 1.3 * g), (f, 3 * g), (f, g + at(-60)), (CONSTANT, f)):
        for advected, reason, verified, folded in itertools.product(
            (source, target, 0.05 * source, at(30)),
            ("converged", "iteration limit", "line search failed", "cancelled"),
            (unknown, 0.01, 0.2, 1.0),
            (unknown, 0.5),
        ):
            known = {"verified": verified, "folded": folded}
            verdict = verdict_of(source, target, advected, reason, **known)
            kinds.add(verdict.kind)
            assert verdict.reason
            for line in (verdict.reason, verdict.advice):
                assert "\n" not in line
                assert not line.endswith((".", " "))
                assert "nan" not in line
            assert verdict.advice or verdict.kind == "matched"
    assert kinds == {"matched", "nearly", "not reached", "impossible"}


def remedies(parameters, degrees=60, width=0.1, refined=0):
    problem = FunctionTerm(EGG, around(0, width), around(degrees, width))
    return Remedies(problem, parameters, refined)


@pytest.mark.parametrize(
    ("names", "degrees", "parameters"),
    [
        (["Reach further"], 150, PAPER_RUN),
        (["Reach further"], 150, Parameters.of(reach=0.0, refine=0)),
        (["More time", "Continue"], 60, Parameters.of(iterations=20, refine=0)),
        (["Match closer", "Refine"], 90, Parameters(sigma=1.5)),
        (["Less smooth"], 60, Parameters(alpha=10.0, sigma=0.1)),
        (["Smoother", "Refine"], 90, Parameters.of(order=1, alpha=0.001, refine=0)),
    ],
)
def test_each_remedy_lowers_the_residual(names, degrees, parameters):
    match = abfm.match(EGG, around(0), around(degrees), parameters)
    assert match.verdict.kind in ("nearly", "not reached")
    assert labels(match.verdict) == names
    for remedy in match.verdict.remedies:
        p = parameters.with_values(**remedy.parameters)
        start = match.start_for(p) if remedy.starts_from_field else None
        again = abfm.match(EGG, around(0), around(degrees), p, start=start)
        assert again.worse_residual < match.worse_residual, remedy


def test_larger_tau_is_equivalent_to_smaller_sigma():
    """Doubling tau is equivalent to halving sigma, so no remedy changes tau."""
    p = Parameters.of(sigma=0.1, levels=1, reach=0.0, cooling_stages=1, iterations=20)
    slow, long = (
        abfm.match(EGG, around(0, 0.2), around(60, 0.2), p.with_values(**changes))
        for changes in ({"sigma": 0.05}, {"tau": 4.0})
    )
    fastest = np.abs(slow.velocity).max()
    assert_allclose(4 * long.velocity, slow.velocity, atol=1e-6 * fastest)
    assert_allclose(long.energy_history[:, 0], slow.energy_history[:, 0] / 4, rtol=1e-6)


def test_remedy_changes_only_different_parameters():
    without_reach = remedies(PAPER_RUN, 120).larger_reach()
    assert without_reach.parameters["reach"] == 1.0
    names = {"order", "levels", "sigma", "sigma_unit", "iterations"}
    assert names <= without_reach.parameters.keys()
    check_message(without_reach.words)
    near = remedies(Parameters.of(reach=0.05), 120).larger_reach()
    assert near.parameters == {"reach": 1.0}
    for remedy in (without_reach, near):
        assert json.loads(json.dumps(asdict(remedy))) == asdict(remedy)
    assert remedies(Parameters(sigma=0.02)).smaller_sigma().parameters == {"sigma": 0.0067}
    assert remedies(Parameters(), refined=1).finer_mesh().parameters == {"refine": 2}
    assert remedies(Parameters(), refined=3).finer_mesh() is None
    assert remedies(Parameters.of(method="linearised")).finer_mesh() is None


@settings(max_examples=60)
@given(
    st.builds(
        Parameters.of,
        alpha=st.floats(1e-4, 1.0),
        sigma=st.none() | st.floats(1e-3, 30.0),
        order=st.sampled_from([1, 2]),
        reach=st.sampled_from([0.0, 0.1, 1.0]),
        iterations=st.integers(0, 2000),
    ),
    st.sampled_from(["converged", "iteration limit", "line search failed", "no progress"]),
    st.lists(st.tuples(SHARE, SHARE | st.just(np.nan), st.integers(0, 9)), min_size=6, max_size=6),
)
def test_remedies_never_undo_each_other(p, reason, outcomes):
    """Alpha, order, reach and refinement only grow, and sigma only falls.

    This is true for any outcome of each run. Alpha falls only from more than ten times its default.
    """
    problem = FunctionTerm(EGG, around(0), around(60))
    for mismatch, verified, choice in outcomes:
        shown, refined = around(40)[None], p.refine or 0
        evidence = Evidence(shown, mismatch, StopReason(reason), verified, refined=refined)
        found = judge(problem, evidence, p).remedies
        if not found:
            return
        following = p.with_values(**found[choice % len(found)].parameters)
        assert following.alpha >= p.alpha or p.alpha > 0.1, found
        for name in ("order", "reach", "iterations"):
            assert following.to_dict()[name] >= p.to_dict()[name], found
        assert (following.refine or 0) >= (p.refine or 0)
        assert following.last_sigma <= p.last_sigma
        p = following


@pytest.mark.parametrize(
    ("parameters", "label"),
    [
        (Parameters(sigma=0.5), "Match closer"),
        (Parameters(alpha=0.001), "Smoother"),
        (Parameters.of(reach=0.01), "Reach further"),
    ],
)
def test_disagreement_first_advises_the_defaults(parameters, label):
    assert remedies(parameters, width=0.2).more_consistent().label == label


def test_defaults_are_only_advised_to_refine():
    assert remedies(Parameters(), width=0.01).more_consistent() is None
    problem = FunctionTerm(EGG, around(0, 0.1), around(60, 0.1))
    refuted = Evidence(problem.target, 0.0, StopReason.CONVERGED, verified=0.5)
    for evidence, kind in ((refuted, "not reached"), (replace(refuted, verified=0.1), "nearly")):
        found = judge(problem, evidence, Parameters())
        assert (found.kind, labels(found)) == (kind, ["Refine"])
        assert judge(problem, replace(evidence, refined=3), Parameters()).remedies == ()


@pytest.mark.parametrize("wrong", [{"sigmma": 1.0}, {"sigma": -1.0}, {"sigma": "small"}])
def test_remedy_with_wrong_parameters_is_refused(wrong):
    with raises(ParameterError):
        Remedy("Match closer", "a smaller sigma", wrong)


@pytest.mark.parametrize(
    "extreme", [{"alpha": ALPHA_MAX}, {"sigma": VALUE_MIN}, {"iterations": COUNT_MAX}]
)
@pytest.mark.parametrize("size", [1.0, 1e-29])
def test_remedies_of_extreme_parameters_are_valid(extreme, size):
    parameters, (x, y, _) = Parameters.of(**extreme), EGG.vertices.T
    made = Remedies(FunctionTerm(EGG, size * x, size * y), parameters)
    names = "more_iterations larger_alpha smaller_sigma much_smaller_sigma larger_reach finer_mesh"
    for name in names.split():
        parameters.with_values(**getattr(made, name)().parameters)


@pytest.mark.parametrize(
    ("correlation", "residual_ratio", "held_out", "kind", "cause"),
    [
        (0.0, 0.9, 0.9, "registered", Cause.LIMIT_OF_DATA),
        (0.0, 0.9, math.nan, "registered", Cause.LIMIT_OF_DATA),
        (0.0, 0.96, 0.9, "not reached", Cause.LITTLE_IMPROVEMENT),
        (0.9, 0.79, 0.9, "registered", Cause.LIMIT_OF_DATA),
        (0.9, 0.81, 0.9, "not reached", Cause.LITTLE_IMPROVEMENT),
        (0.9, 0.5, 1.01, "not reached", Cause.NO_HELD_OUT_IMPROVEMENT),
        (0.99, 0.9, 0.9, "nearly", Cause.NONE),
    ],
)
def test_registered_needs_a_clear_gain(correlation, residual_ratio, held_out, kind, cause):
    """Noise is registered only if its residual is clearly below that of the zero field.

    ``residual_ratio`` is absolute for unrelated functions, and otherwise relative to the
    residual of the zero field. No smaller sigma is advised, because held-out patches chose it.
    """
    f, other = np.random.default_rng(0).normal(size=(2, len(SPHERE.vertices)))
    g = correlation * f + math.sqrt(1 - correlation**2) * other
    functions = FunctionTerm(SPHERE.normalized(), f, g)
    residual = residual_ratio * (functions.residual(functions.source) if correlation else 1)
    advected = np.roll(f, 1)[None]
    stop = StopReason.NO_PROGRESS
    evidence = Evidence(advected, residual, stop, residual, 0.0, held_out=held_out)
    found = judge(functions, evidence, Parameters())
    assert (found.kind, found.cause, found.remedies) == (kind, cause, ())
