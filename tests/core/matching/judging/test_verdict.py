"""The verdict on matches: each cause is told from a small match that has it."""

import itertools
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import abfm
from abfm.matching.judging.verdict import Kind, Outcome, Remedy, Verdict, advice, confirmed_mismatch
from abfm.matching.solvability import distance, stood_still, vanished
from abfm.matching.solving.record import StopReason, early_warning
from abfm.matching.terms.functions import FunctionTerm
from abfm.parameters import PAPER, Parameters
from tests.core.fields import bump
from tests.shapes import icosphere

SPHERE, FINE = icosphere(3), icosphere(4)
NEAR = {**PAPER, "alpha": 0.02, "sigma": 1e-3, "cooling_factor": 10, "iterations": 150}
"""Parameters of a solver that does not look for far targets, and so fails in the ways that are
told here.
"""
USUAL = Parameters(**NEAR)
SHARE = st.floats(0, 2) | st.sampled_from([0.05, 0.1, 0.15, 0.3])


def at(degrees, width=0.15, mesh=SPHERE):
    """A Gaussian on the unit sphere, so far from the pole."""
    angle = np.deg2rad(degrees)
    return bump(mesh, [0, np.sin(angle), np.cos(angle)], width)


def judged(match, **known):
    """The verdict on a match."""
    last = match.energy_history[match.stages == match.stages[-1], 0]
    outcome = Outcome(match.advected.T, match.mismatch, match.stop_reason, energies=last, **known)
    return advice(
        FunctionTerm(match.mesh, match.source, match.target, match.mask, match.weights),
        outcome,
        match.parameters,
    )


def imagined(source, target, advected, reason="converged", parameters=USUAL, **known):
    """The verdict on a function that a flow might have carried."""
    problem = FunctionTerm(SPHERE, source, target)
    return advice(
        problem,
        Outcome(
            advected[None], problem.relative_mismatch(advected[None]), StopReason(reason), **known
        ),
        parameters,
    )


def test_a_match_needs_no_advice():
    match = abfm.match(SPHERE, at(0), at(45))
    assert judged(match) == Verdict(
        "matched", f"the mismatch fell from 0.86 to {match.mismatch:.2g}", ""
    )
    assert judged(match, verified=0.08).kind == "matched"
    assert "(0.08 by flow lines)" in judged(match, verified=0.08).reason


@settings(deadline=None)
@given(mismatches=st.lists(st.tuples(SHARE, SHARE | st.just(np.nan)), min_size=2, max_size=2))
def test_of_functions_that_flows_can_carry_the_kind_is_the_worse_the_more_is_confirmed(mismatches):
    """What is confirmed is one number of the mismatch and that by flow lines."""
    problem, judged_by = FunctionTerm(SPHERE, at(0), at(40)), []
    for mismatch, verified in mismatches:
        kind = advice(
            problem, Outcome(at(38)[None], mismatch, StopReason.CONVERGED, verified), USUAL
        ).kind
        assert (kind == "matched") == (mismatch <= 0.05 and not verified > 0.1)
        assert (kind == "not reached") == (mismatch > 0.15 or verified > 0.3)
        judged_by.append((confirmed_mismatch(mismatch, verified), get_args(Kind).index(kind)))
    (_, better), (_, worse) = sorted(judged_by)
    assert better <= worse


def test_functions_that_are_alike_are_matched_from_the_start():
    flat = np.ones(len(SPHERE.vertices))
    noise = 1 + 1e-10 * SPHERE.vertices[:, 0]
    for f, g in itertools.product((noise, flat), repeat=2):
        verdict = judged(abfm.match(SPHERE, f, g, Parameters(iterations=2)))
        assert verdict.kind == "matched"
        assert verdict.cause.startswith("both are constant")
    assert judged(abfm.match(SPHERE, at(0), at(0), Parameters(iterations=2))) == Verdict(
        "matched", "the mismatch stayed at 0", ""
    )


def test_functions_are_judged_by_what_varies_however_small_beside_a_constant():
    f, g = at(0, 0.2), at(30, 0.2)
    flat = np.ones_like(f)
    for size in (1e-2, 1e-5, 1e-8):
        still = judged(abfm.match(SPHERE, 1 + size * f, 1 + size * g, Parameters(iterations=0)))
        assert still.kind == "not reached"
        matched = abfm.match(SPHERE, 1 + size * f, 1 + size * g)
        assert (matched.verdict.kind, matched.mismatch < 0.05) == ("matched", True)
        assert (
            judged(abfm.match(SPHERE, 1 + size * f, flat, Parameters(iterations=2))).kind
            == "impossible"
        )


def test_values_that_the_source_lacks_are_impossible_whatever_the_discrete_flow_shows():
    match = abfm.match(SPHERE, at(0, 0.2), 2 * at(30, 0.2))
    assert match.mismatch < 0.05
    verdict = judged(match)
    assert verdict.kind == "impossible"
    assert "the target has values from " in verdict.reason
    assert "to 2, the source from " in verdict.reason
    assert "to 1, and no flow changes values: 0.31 is the least left" in verdict.reason
    assert verdict.advice == "scale or clip one of the functions"
    assert judged(abfm.match(SPHERE, at(0, 0.2), 1.3 * at(30, 0.2))).kind == "nearly"


def test_values_are_told_for_the_channel_that_lacks_most():
    f, g = np.stack([at(0), at(20)], axis=1), np.stack([at(10), 2 * at(30)], axis=1)
    few = Parameters(iterations=2)
    assert "in channel 2 the target has values from" in judged(abfm.match(SPHERE, f, g, few)).reason
    assert judged(abfm.match(SPHERE, f, g, few, weights=[1, 0])).kind != "impossible"


def test_constants_are_impossible():
    flat = np.full(len(SPHERE.vertices), 0.3)
    match = abfm.match(SPHERE, at(0, 0.2), flat)
    assert match.mismatch < 0.05
    to_flat, from_flat = judged(match), judged(abfm.match(SPHERE, flat, at(0)))
    assert to_flat.kind == from_flat.kind == "impossible"
    assert "the target is constant and the source is not" in to_flat.reason
    assert (
        from_flat.reason
        == "the mismatch stayed at 1: the source is constant, and no flow changes that"
    )
    assert judged(abfm.match(SPHERE, flat, 2 * flat)).kind == "impossible"
    assert (
        judged(abfm.match(SPHERE, at(0), 0 * flat, Parameters(iterations=3))).kind == "impossible"
    )


def test_a_source_that_vanished_is_told():
    f, g = at(0, 0.05, FINE), at(120, 0.05, FINE)
    problem = FunctionTerm(FINE, f, g)
    warnings = []
    match = abfm.match(
        FINE,
        f,
        g,
        replace(USUAL, iterations=20),
        on_iteration=lambda now: warnings.append(now.warning),
    )
    verdict = judged(match)
    assert verdict.kind == "not reached"
    assert verdict.reason.startswith(
        "the mismatch fell from 1.4 to 1: the flow squeezed the source to nothing"
    )
    assert (
        verdict.advice == "a larger reach, such as 1 of sqrt(area) and the course of the defaults"
    )
    assert vanished(problem, match.advected.T)
    assert not vanished(problem, match.source.T)
    assert warnings[0] is None
    assert warnings[5] is not None
    assert warnings[5].startswith("the source is being squeezed to nothing")
    outcome = Outcome(match.advected.T, match.mismatch, StopReason.NO_PROGRESS)
    assert distance(problem) == pytest.approx(np.sqrt(3) / FINE.length_scale, abs=0.03)
    assert "wider functions" in advice(problem, outcome, replace(USUAL, reach=1.0)).advice


def test_a_source_that_stood_still_for_want_of_iterations_gets_more():
    verdict = abfm.match(SPHERE, at(0), at(90), Parameters(iterations=0)).verdict
    assert "0 iterations" in verdict.reason
    assert [remedy.label for remedy in verdict.remedies] == ["More time", "Continue"]


def test_a_source_that_stood_still_is_told():
    match = abfm.match(
        SPHERE, at(0, 0.1), at(90, 0.1), replace(USUAL, sigma=10.0, cooling_stages=1)
    )
    verdict = judged(match)
    assert verdict.kind == "not reached"
    assert "the source hardly moved" in verdict.reason
    assert [remedy.label for remedy in verdict.remedies] == ["Reach further", "Match closer"]
    assert verdict.advice.endswith("a smaller sigma, such as 1")
    assert "more iterations" not in verdict.advice
    problem = FunctionTerm(SPHERE, match.source, match.target)
    assert stood_still(problem, match.advected.T)
    assert early_warning(problem, match.advected.T, 2) is None
    told = early_warning(problem, match.advected.T, 10)
    assert told is not None
    assert told.startswith("the source hardly moves")
    assert not stood_still(problem, match.target.T)


def test_a_match_that_goes_well_neither_vanishes_nor_stands_still():
    problem, seen = FunctionTerm(SPHERE, at(0), at(45)), []
    abfm.match(SPHERE, at(0), at(45), Parameters(iterations=30), on_iteration=seen.append)
    assert len(seen) == 31
    assert not any(vanished(problem, now.advected.T) or now.warning for now in seen)
    assert not stood_still(problem, seen[-1].advected.T)


def test_other_peaks_are_matched_in_part_at_best():
    """The discrete flow splits a peak; unless flow lines do so too, this is no match."""
    match = abfm.match(SPHERE, at(0), at(50) + at(-50))
    assert match.mismatch < 0.05
    unknown, refuted, confirmed = (judged(match, verified=value) for value in (np.nan, 0.7, 0.05))
    assert (unknown.kind, refuted.kind, confirmed.kind) == ("nearly", "not reached", "matched")
    for verdict in (unknown, refuted):
        assert "the source has 1 peak and 1 pit, the target 2 peaks and 1 pit" in verdict.reason
        assert "no flow changes that" in verdict.reason
    assert "no flow changes that" in imagined(at(0), at(50) + at(-50), at(50)).reason


def test_what_flow_lines_do_not_confirm_is_not_reached():
    verdict = imagined(at(0), at(40), at(40), verified=0.4)
    assert verdict.kind == "not reached"
    assert verdict.reason.endswith(
        "by flow lines the mismatch is 0.4, so the discrete flow is not one here"
    )
    assert (
        verdict.advice
        == "a larger reach, such as 1 of sqrt(area) and the course of the defaults; or a finer mesh"
    )
    nearly = imagined(at(0), at(40), at(40), verified=0.2)
    assert nearly.kind == "nearly"
    assert "confirm less" in nearly.reason


def test_folds_count_unless_flow_lines_confirm_the_match():
    verdict = imagined(at(0), at(40), at(40), folded=0.15)
    assert verdict.kind == "not reached"
    assert verdict.reason.endswith("15% of the faces are folded, which no flow does")
    confirmed = imagined(at(0), at(40), at(40), folded=0.15, verified=0.02)
    assert confirmed.kind == "matched"
    assert confirmed.advice == "do not trust its point map, where 15% of the faces are folded"
    assert imagined(at(0), at(40), at(40), folded=0.05).advice == ""


def test_iterations_that_ran_out():
    verdict = abfm.match(SPHERE, at(0), at(60), Parameters(iterations=4)).verdict
    assert verdict.kind == "not reached"
    assert verdict.reason.endswith("it stopped after the 4 iterations it was given, still falling")
    assert verdict.cause == "it stopped after the 4 iterations it was given, still falling"
    assert verdict.advice == "more iterations, such as 500; or go on from this field"
    assert verdict.remedies == (
        Remedy("More time", "more iterations, such as 500", {"iterations": 500}),
        Remedy("Continue", "go on from this field", {}, True),
    )
    nearly = imagined(at(0), at(45), at(50), "iteration limit", parameters=Parameters(iterations=4))
    assert (nearly.kind, nearly.remedies) == ("nearly", verdict.remedies)
    refuted = imagined(
        at(0), at(45), at(53), "iteration limit", parameters=Parameters(iterations=4), verified=0.9
    )
    assert [remedy.label for remedy in refuted.remedies] == ["More time"]
    blind = imagined(at(0), at(45), at(50), "iteration limit")
    assert [remedy.label for remedy in blind.remedies] == ["Reach further"]


def test_iterations_that_ran_out_long_after_the_energy_stopped_falling():
    problem = FunctionTerm(SPHERE, at(0), at(60))
    outcome = Outcome(
        at(30)[None],
        problem.relative_mismatch(at(30)[None]),
        StopReason.ITERATION_LIMIT,
        energies=np.ones(30),
    )
    verdict = advice(problem, outcome, USUAL)
    assert verdict.reason.endswith(
        "what is left differs, or would cost more smoothness than it gains"
    )
    assert (
        "still falling"
        in advice(problem, replace(outcome, energies=np.linspace(2, 1, 30)), USUAL).reason
    )


@pytest.mark.parametrize(
    ("stop_reason", "words", "advised"),
    [
        ("cancelled", "it was cancelled", "go on"),
        ("line search failed", "no step lowers the energy", "a larger alpha, such as 0.06"),
        ("converged", "what is left differs", "a smaller sigma, such as 0.00033"),
        ("iteration limit", "still falling", "a larger reach, such as 1"),
    ],
)
def test_the_stop_reason_is_told_where_nothing_else_is(stop_reason, words, advised):
    verdict = imagined(at(0), at(60), at(30), stop_reason)
    assert verdict.kind == "not reached"
    assert verdict.reason.startswith("the mismatch fell from 1.1 to 0.61: ")
    assert words in verdict.reason
    assert advised in verdict.advice


def test_without_smoothness_more_of_it_is_advised_from_the_usual_value_and_never_less():
    problem = FunctionTerm(SPHERE, at(0), at(60))
    outcome = Outcome(
        at(30)[None], problem.relative_mismatch(at(30)[None]), StopReason.LINE_SEARCH_FAILED
    )
    rough = Parameters(alpha=0.0)
    assert "a larger alpha, such as 0.01" in advice(problem, outcome, rough).advice
    assert (
        "alpha"
        not in advice(problem, replace(outcome, stop_reason=StopReason.CONVERGED), rough).advice
    )


def test_signals_that_only_resemble_each_other_are_told_without_blame():
    """Shared waves and others of each function's own, as measured signals have."""
    rng = np.random.default_rng(1)
    waves = np.sin(5 * SPHERE.vertices @ rng.normal(size=(3, 6)) + rng.normal(size=6)).T
    f, g = waves[:3].sum(axis=0), waves[1:4].sum(axis=0)
    match = abfm.match(SPHERE, f, g, Parameters(iterations=60, alpha=0.3, sigma=0.1))
    verdict = judged(match)
    assert verdict.kind in ("not reached", "nearly")
    assert verdict.reason.startswith("the mismatch fell from ")
    assert "failed" not in verdict.reason


def test_every_verdict_is_one_line_without_a_full_stop():
    """All combinations of what may be known, for functions of each kind."""
    flat = np.full(len(SPHERE.vertices), 0.3)
    pairs = [
        (at(0), at(60)),
        (at(0), 1.3 * at(60)),
        (at(0), 3 * at(60)),
        (at(0), at(60) + at(-60)),
        (flat, at(0)),
    ]
    unknown = np.nan
    kinds = set()
    for f, g in pairs:
        for advected, reason, verified, folded in itertools.product(
            (f, g, 0.05 * f, at(30)),
            ("converged", "iteration limit", "line search failed", "cancelled"),
            (unknown, 0.01, 0.2, 1.0),
            (unknown, 0.5),
        ):
            verdict = imagined(f, g, advected, reason, verified=verified, folded=folded)
            kinds.add(verdict.kind)
            assert verdict.reason.startswith("the mismatch ")
            for line in (verdict.reason, verdict.advice):
                assert "\n" not in line
                assert not line.endswith((".", " "))
                assert "nan" not in line
            assert verdict.advice or verdict.kind == "matched"
    assert kinds == {"matched", "nearly", "not reached", "impossible"}
