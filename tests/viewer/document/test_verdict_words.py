"""What a match came to, in words."""

import math
import re
from dataclasses import replace
from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import abfm
from abfm import StopReason
from abfm.matching import Remedy, Verdict
from abfm.matching.judging.verdict import Kind
from abfm.wording import capital, counted, sentence, share
from abfm_viewer.cli.match import Outcome
from abfm_viewer.document import verdict_words
from abfm_viewer.document.verdict_words import numbers, place
from tests.viewer.sessions import SPHERE

KINDS = get_args(Kind)  # the better ones first
MISMATCH = st.floats(0, 2) | st.sampled_from([0.05, 0.1, 0.15, 0.3])


@pytest.fixture(scope="module")
def iterations():
    return []


@pytest.fixture(scope="module")
def found(iterations):
    x, y, _ = SPHERE.vertices.T
    parameters = abfm.Parameters(iterations=12, levels=2, reach=0.5, refine=0)
    match = abfm.match(SPHERE, x, y, parameters, on_iteration=iterations.append)
    verdict = Verdict("matched", "the mismatch fell from 1 to 0.012", "")
    known = {"mismatch": 0.0123, "verified_residual": 0.03, "folded": 0.001}
    return replace(match, **known, stop_reason="converged", verdict=verdict)


def judged(match, kind, **known):
    verdict = Verdict(kind, "the mismatch fell from 1 to 0.5: the cause", "advice")
    return replace(match, verdict=verdict, **known)


@pytest.mark.parametrize(
    "case",
    [
        ("matched", 0.002, 0.0062, "matched to 0.7%", "good"),
        ("matched", 0.05, 0.049, "matched to 5%", "good"),
        ("matched", 0.0123, math.nan, "matched to 1.3%", "good"),
        ("matched", 0.0, 1e-9, "matched to less than 0.01%", "good"),
        ("nearly", 0.08, 0.07, "nearly: 8% left", "ink"),
        ("nearly", 0.049, 0.0501, "nearly: 5.1% left", "ink"),
        ("nearly", 0.049, 0.12, "nearly: 12% left", "ink"),
        ("nearly", 0.03, math.nan, "nearly", "ink"),  # as their peaks differ
        ("registered", 0.41, 0.42, "registered: 42% left, areas change by 16%", "good"),
        ("not reached", 0.05, 0.326, "not reached: 33% left", "failure"),
        ("not reached", 0.05, math.nan, "not reached", "failure"),  # as faces are folded
        ("not reached", 0.996, 1.3, "not reached: little gained", "failure"),
        ("not reached", 1.05, math.nan, "not reached: little gained", "failure"),
        ("not reached", 1.0, 1.41, "not reached: nothing gained", "failure"),
        ("not reached", 1.6, 0.1, "not reached: nothing gained", "failure"),
        ("impossible", 0.01, 0.01, "impossible", "failure"),
    ],
)
def test_the_headline_says_how_well_by_what_is_confirmed_and_has_a_colour(found, case):
    kind, mismatch, verified, said, meant = case
    match = judged(found, kind, mismatch=mismatch, verified_residual=verified)
    match = replace(match, path=(replace(match.path[match.step], log2_area=0.21),), step=0)
    assert (match.facts.headline, match.facts.tone) == (said, meant)


@settings(deadline=None)
@given(pairs=st.lists(st.tuples(MISMATCH, MISMATCH | st.just(math.nan)), min_size=2, max_size=2))
def test_a_smaller_share_never_has_a_worse_word_nor_a_worse_exit_status(found, pairs):
    matches = []
    for mismatch, verified in pairs:
        one = replace(found, mismatch=mismatch, verified_residual=verified)
        kind = abfm.matching.outcome_of(one.worse_residual, one.parameters.goal)
        matches.append(judged(one, kind))
    better, worse = sorted(matches, key=shown_share)
    if shown_share(better) < shown_share(worse):
        assert KINDS.index(better.verdict.kind) <= KINDS.index(worse.verdict.kind)
        assert Outcome(better, 1.0, (), False).status <= Outcome(worse, 1.0, (), False).status


@settings(deadline=None)
@given(mismatch=MISMATCH, verified=MISMATCH | st.just(math.nan), kind=st.sampled_from(KINDS))
def test_a_share_is_only_told_with_its_word_and_is_never_below_what_a_witness_leaves(
    found, mismatch, verified, kind
):
    match = judged(found, kind, mismatch=mismatch, verified_residual=verified)
    said = match.facts.headline
    if "%" in said.split(",")[0]:
        assert kind in (abfm.matching.outcome_of(match.worse_residual), "registered")
        assert shown_share(match) >= 100 * np.nanmax([mismatch, verified]) - 1e-4
    assert said.startswith(kind)


def shown_share(match):
    """The share in a match's headline, in percent; endless where it says so in words."""
    words = match.facts.headline
    if words.endswith("gained"):
        return math.inf
    return float(re.findall(r"([0-9.]+)%", words)[0])


def test_percents_have_as_many_digits_as_one_reads_sentences_a_capital_and_one_is_no_plural():
    values = [1e-5, 1e-4, 0.00085, 0.0096, 0.0101, 0.026, 0.034, 0.07, 0.0996, 0.1001, 0.995]
    said = ["less than 0.01%", "0.01%", "0.09%", "1%", "1.1%", "2.6%", "3.4%", "7%"]
    said += ["10%", "11%", "100%"]
    assert [share(value) for value in values] == said
    counts = [counted(number, "iteration") for number in (0, 1, 2)]
    assert counts == ["0 iterations", "1 iteration", "2 iterations"]
    assert capital("opening Bear.OFF") == "Opening Bear.OFF"
    assert sentence("the target is ||g|| = 0") == "The target is ||g|| = 0."
    assert capital("") == ""


@given(value=st.floats(1e-4, 1), percent=st.sampled_from([1, 2.5, 5, 7.5, 10, 15, 30]))
def test_a_share_reads_as_within_a_bound_exactly_where_it_is(value, percent):
    read = float(share(value).removesuffix("%"))
    assert (read <= percent) == (value <= percent / 100 + 1e-9)


def test_why_it_stopped_is_the_verdict_s_cause_or_how_it_ended(found):
    assert judged(found, "not reached").facts.reason == "the cause"
    assert re.fullmatch(
        r"the cause; at first \d+% was left", judged(found, "registered").facts.reason
    )
    assert found.facts.reason == "the discrete flow and flow lines both leave at most 5%"
    found = replace(found, verified_residual=math.nan)
    for reason, told in (
        (StopReason.GOAL_REACHED, "the mismatch came well below the goal"),
        (StopReason.NO_PROGRESS, "it stopped where going on gained little"),
        ("iteration limit", "it stopped after the 12 iterations it was given"),
    ):
        assert replace(found, stop_reason=reason).facts.reason == told
    for reason, start, words in (  # of what did not come to its end
        ("cancelled", "cancelled: 1.3% left", "best field so far"),
        ("given", "field given", "Play"),
    ):
        match = replace(found, stop_reason=reason)
        assert (match.facts.headline, match.facts.tone) == (start, "ink")
        assert words in match.facts.reason


def test_numbers_that_are_not_known_and_places_that_need_no_word_are_left_out(found, iterations):
    assert numbers(found) == "0.0123, 0.03 by flow lines, 0.1% folded"
    assert numbers(replace(found, verified_residual=math.nan)) == "0.0123, 0.1% folded"
    two = replace(found, fine_velocity=np.concatenate([found.fine_velocity] * 2))
    assert numbers(two).endswith("0.1% folded, 2 fields in a row")
    assert numbers(replace(found, verified_residual=math.nan, folded=math.nan)) == "0.0123"
    assert place(iterations[0]) == "mesh 1/2, stage 1, reach 0.5"
    assert place(replace(iterations[0], levels=1, stage=2, reach=0.0)) == "stage 3"


def test_remedies_are_options_of_the_command_line_and_else_advice_is_words(found):
    remedies = (
        Remedy("Reach further", "a larger reach", {"reach": 0.6, "levels": 0}),
        Remedy("Continue", "go on", {}, True),
    )
    verdict = Verdict("not reached", "why", "a larger reach; or go on", remedies)
    match = replace(found, verdict=verdict)
    told = "reach further (--reach 0.6 --levels 0), or continue (--start m.npz)"
    assert verdict_words.advice_in_options(match, "m.npz") == told
    assert verdict_words.advice_in_options(judged(found, "impossible"), "m.npz") == "advice"
    assert verdict_words.advice(replace(match, stop_reason="given")) == ""
    first, second = map(verdict_words.changes, remedies)
    assert first == "A larger reach.\nStarts a run from no motion, with reach 0.6, levels 0."
    assert second == "Go on.\nStarts a run from the present field."


@pytest.mark.parametrize(
    ("kind", "left", "by_lines", "said"),
    [
        ("matched", 0.014, 0.026, "matched to 2.6%"),
        ("nearly", 0.049, 0.0501, "nearly: 5.1% left"),
        ("nearly", 0.03, math.nan, "nearly"),  # as faces are folded
        ("registered", 0.13, 0.12, "registered: 13% left"),
        ("not reached", 0.02, 0.03, "not reached"),  # as most of it is no motion
        ("not reached", 0.4, 0.5, "not reached"),
    ],
)
def test_an_interval_of_a_film_is_told_as_a_match_is(kind, left, by_lines, said):
    sequence = SimpleNamespace(
        verdicts=[Verdict(kind, "", "")],
        mismatch=np.array([left]),
        verified_residual=np.array([by_lines]),
        parameters=abfm.Parameters(),
    )
    assert verdict_words.of_interval(sequence, 0) == said


def test_of_landmarks_alone_it_is_told_how_far_they_are_left():
    mesh = SPHERE
    found = abfm.match(abfm.Problem(mesh, None, None, landmarks=[[0, 20], [50, 60]]))
    assert re.fullmatch(
        r"matched: 2 landmarks within 0\.\d+% of sqrt\(area\)", found.facts.headline
    )
    assert found.facts.reason == "flow lines bring every landmark to where it belongs"
