import math
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import abfm
from abfm.maps.distortion import Bound
from abfm.matching import Remedy, StopReason, Verdict
from abfm.matching.report import advice_in_options, residual_text
from abfm.outcome import VERDICTS, Outcome, outcome_of
from abfm.sequences.report import interval_headline
from abfm.wording import capital, counted, sentence, share
from abfm_viewer.cli.solve import status_of
from abfm_viewer.document import verdict_words
from abfm_viewer.document.verdict_words import best_text, numbers_text, stage_text
from tests.viewer.sessions import SPHERE

RESIDUAL = st.floats(0, 2) | st.sampled_from([0.05, 0.1, 0.15, 0.3])


@pytest.fixture(scope="module")
def iterations():
    return []


@pytest.fixture(scope="module")
def found(iterations):
    x, y, _ = SPHERE.vertices.T
    parameters = abfm.Parameters.of(iterations=12, levels=2, reach=0.5, refine=0)
    match = abfm.match(SPHERE, x, y, parameters, on_iteration=iterations.append)
    verdict = Verdict(Outcome.MATCHED, "the residual fell from 1 to 0.012", "")
    known = {"residual": 0.0123, "verified_residual": 0.03, "folded": 0.001}
    return replace(match, **known, stop_reason=StopReason.CONVERGED, verdict=verdict)


def judged(match, kind, residual=0.0123, verified=0.03):
    verdict = Verdict(Outcome(kind), "the residual fell from 1 to 0.5: the cause", "advice")
    known = {"residual": residual, "verified_residual": verified}
    return replace(match, verdict=verdict, **known)


@pytest.mark.parametrize(
    "case",
    [
        ("matched", 0.002, 0.0062, "0.7%", "good"),
        ("matched", 0.05, 0.049, "5%", "good"),
        ("matched", 0.0123, math.nan, "1.3%", "good"),
        ("matched", 0.0, 1e-9, "less than 0.01%", "good"),
        ("nearly", 0.08, 0.07, "8%", "warning"),
        ("nearly", 0.049, 0.0501, "5.1%", "warning"),
        ("nearly", 0.049, 0.12, "12%", "warning"),
        ("nearly", 0.03, math.nan, "", "warning"),  # because their peaks differ
        ("registered", 0.41, 0.42, "42%", "good"),
        ("not reached", 0.05, 0.326, "33%", "failure"),
        ("not reached", 0.05, math.nan, "", "failure"),  # folded faces
        ("not reached", 0.996, 1.3, "130%)", "failure"),
        ("not reached", 1.05, math.nan, "105%)", "failure"),
        ("not reached", 1.0, 1.42, "142%, not reduced)", "failure"),
        ("not reached", 1.6, 0.1, "160%, not reduced)", "failure"),
        ("impossible", 0.01, 0.01, "", "failure"),
    ],
)
def test_headline_has_the_verified_residual_and_a_tone(found, case):
    kind, residual, verified, expected, meant = case
    facts = changing_areas(judged(found, kind, residual, verified), 0.21, 0.6).facts
    assert (facts.outcome, facts.tone) == (kind, meant)
    assert facts.headline.startswith(kind)
    assert expected in facts.headline
    assert ("%" in facts.headline) is ("%" in expected)
    assert ("a factor of 1.2" in facts.headline) is (kind == "registered")


def changing_areas(match, mean, high):
    """Return a match with given area changes: mean and 95th percentile of |log2 J|."""
    step = replace(match.path[match.step], log2_area=mean, log2_area_95=high)
    return replace(match, path=(step,), step=0)


@pytest.mark.parametrize(
    ("kind", "tone"), [("matched", "warning"), ("nearly", "warning"), ("not reached", "failure")]
)
def test_large_area_change_is_a_warning(found, kind, tone):
    """The headline names the mean factor, the warning that of the 5% of largest change."""
    residual = {"matched": 0.02, "nearly": 0.1, "not reached": 0.4}[kind]
    match = judged(found, kind, residual, residual)
    within, beyond = (changing_areas(match, 3.3, high).facts for high in (1.0, 4.0))
    assert not within.warnings
    assert "factor" not in within.headline
    assert [("16" in warning) for warning in beyond.warnings] == [True] * (kind != "not reached")
    assert ("a factor of 9.8" in beyond.headline) is (kind != "not reached")
    assert ("areas ×9.8" in beyond.short_headline) is (kind != "not reached")
    assert beyond.tone == tone
    assert beyond.outcome == within.outcome == kind
    advised = replace(match, verdict=replace(match.verdict, advice=""))
    changed = changing_areas(advised, 3.3, 4.0)
    assert ("max_distortion" in changed.facts.advice) is (kind != "not reached")
    bounded = replace(changed, bound=Bound(1.0, 0.5, 4.0, 0))
    assert bounded.facts.numbers["max_distortion"] == 1
    assert bounded.facts.advice == ""


@given(pairs=st.lists(st.tuples(RESIDUAL, RESIDUAL | st.just(math.nan)), min_size=2, max_size=2))
def test_smaller_residual_never_has_a_worse_verdict(found, pairs):
    matches = []
    for residual, verified in pairs:
        one = replace(found, residual=residual, verified_residual=verified)
        kind = outcome_of(one.worse_residual, one.parameters.goal)
        matches.append(judged(one, kind, residual, verified))
    better, worse = sorted(matches, key=shown_share)
    if shown_share(better) < shown_share(worse):
        assert better.verdict.kind.rank <= worse.verdict.kind.rank
        assert status_of(better.facts) <= status_of(worse.facts)


@given(residual=RESIDUAL, verified=RESIDUAL | st.just(math.nan), kind=st.sampled_from(VERDICTS))
def test_headline_share_is_at_least_both_residuals(found, residual, verified, kind):
    match = judged(found, kind, residual, verified)
    expected = match.facts.headline
    if "%" in expected.split(",")[0]:
        assert kind in (outcome_of(match.worse_residual, match.parameters.goal), "registered")
        assert shown_share(match) >= 100 * np.nanmax([residual, verified]) - 1e-4
    assert expected.startswith(kind)


def shown_share(match):
    """Return the share in a match's headline in percent; infinity if it has only words."""
    shares = re.findall(r"([0-9.]+)%", match.facts.headline)
    return float(shares[0]) if shares else math.inf


def test_numbers_and_sentences_are_formatted():
    values = [1e-5, 1e-4, 0.00085, 0.0096, 0.0101, 0.026, 0.034, 0.07, 0.0996, 0.1001, 0.995, 2e4]
    expected = ["less than 0.01%", "0.01%", "0.09%", "1%", "1.1%", "2.6%", "3.4%", "7%"]
    expected += ["10%", "11%", "100%", "more than 10,000%"]
    assert [share(value) for value in values] == expected
    counts = [counted(number, "iteration") for number in (0, 1, 2)]
    assert counts == ["0 iterations", "1 iteration", "2 iterations"]
    assert capital("opening Bear.OFF") == "Opening Bear.OFF"
    assert sentence("the target is ||g|| = 0") == "The target is ||g|| = 0."
    assert capital("") == ""


@given(value=st.floats(1e-4, 1), percent=st.sampled_from([1, 2.5, 5, 7.5, 10, 15, 30]))
def test_rounded_share_is_within_a_bound_only_if_the_value_is(value, percent):
    read = float(share(value).removesuffix("%"))
    assert (read <= percent) == (value <= percent / 100 + 1e-9)


def test_reason_is_the_cause_or_how_the_run_ended(found):
    assert judged(found, "not reached").facts.reason == "the cause"
    first = judged(found, "registered").facts.reason
    assert first.startswith("the cause")
    assert share(found.initial_residual) in first
    assert "5%" in found.facts.reason  # the limit of data, which both checks reach
    found = replace(found, verified_residual=math.nan)
    reasons = {
        reason: replace(found, stop_reason=reason).facts.reason
        for reason in (StopReason.GOAL_REACHED, StopReason.NO_PROGRESS, StopReason.ITERATION_LIMIT)
    }
    assert len(set(reasons.values())) == 3
    assert "12 iterations" in reasons[StopReason.ITERATION_LIMIT]
    for reason, start, words in (  # unfinished runs
        (StopReason.CANCELLED, "cancelled (residual 1.3%)", "best field so far"),
        (StopReason.GIVEN, "given field", "Play"),
    ):
        facts = replace(found, stop_reason=reason).facts
        assert facts.headline.startswith(start)
        assert (facts.tone, facts.is_complete) == ("warning", False)
        assert words in facts.reason


def test_unknown_numbers_are_omitted(found, iterations):
    assert residual_text(found) == "1.3%, 3% along flow lines, 0.1% folded"
    assert residual_text(replace(found, verified_residual=math.nan)) == "1.3%, 0.1% folded"
    two = replace(found, fine_velocity=np.concatenate([found.fine_velocity] * 2))
    assert residual_text(two).endswith("0.1% folded, 2 consecutive fields")
    assert numbers_text(two) == f"Residual {residual_text(found)}"
    assert residual_text(replace(found, verified_residual=math.nan, folded=math.nan)) == "1.3%"
    first, one = iterations[0], found.path[-1]
    now, path = (
        replace(first, residual=0.5, path=()),
        (replace(one, residual=0.04, verified_residual=0.14),),
    )
    assert best_text(now, [path]) == ", best step 14%"  # by the larger residual
    assert best_text(replace(now, residual=0.1, path=path), []) == best_text(now, []) == ""
    start = replace(first, vertices=2500, sigma=18.0)
    assert stage_text(start) == "mesh of 2,500 vertices, σ 18, long-range search"
    assert stage_text(replace(start, reach=0.0)) == "mesh of 2,500 vertices, σ 18"


def test_remedies_are_written_as_command_line_options(found):
    remedies = (
        Remedy("Reach further", "a larger reach", {"reach": 0.6, "levels": 0}),
        Remedy("Continue", "resume the match", {}, True),
    )
    verdict = Verdict(Outcome.NOT_REACHED, "why", "a larger reach; or resume the match", remedies)
    match = replace(found, verdict=verdict)
    expected = "reach further (--set reach=0.6 --set levels=0), or continue (--start m.npz)"
    assert advice_in_options(match.verdict, match.facts, "m.npz") == expected
    impossible = judged(found, "impossible")
    assert advice_in_options(impossible.verdict, impossible.facts, "m.npz") == "advice"
    assert replace(match, stop_reason=StopReason.GIVEN).facts.advice == ""
    first, second = map(verdict_words.remedy_tooltip, remedies)
    assert first == "A larger reach.\nStarts a run from a zero field, with reach 0.6, levels 0."
    assert second == "Resume the match.\nStarts a run from the current field."


@pytest.mark.parametrize(
    ("kind", "residual", "by_lines", "expected"),
    [
        ("matched", 0.014, 0.026, "matched (residual 2.6%)"),
        ("nearly", 0.049, 0.0501, "nearly matched (residual 5.1%)"),
        ("nearly", 0.03, math.nan, "nearly matched"),  # folded faces
        ("registered", 0.13, 0.12, "registered (residual 13%)"),
        ("not reached", 0.02, 0.03, "not reached"),  # most of the change is not motion
        ("not reached", 0.4, 0.5, "not reached"),
    ],
)
def test_headline_of_an_interval_is_like_that_of_a_match(kind, residual, by_lines, expected):
    sequence = SimpleNamespace(
        verdicts=[Verdict(Outcome(kind), "", "")],
        residual=np.array([residual]),
        verified_residual=np.array([by_lines]),
        parameters=abfm.Parameters(),
    )
    assert interval_headline(sequence, 0) == expected
