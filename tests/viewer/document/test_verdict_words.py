"""What a match came to, in words."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

import abfm
from abfm.matching import Remedy, Verdict
from abfm_viewer.document.verdict_words import (
    advice,
    advice_in_options,
    changes,
    counted,
    headline,
    numbers,
    place,
    share,
    tone,
    why,
)
from tests.viewer.sessions import SPHERE


@pytest.fixture(scope="module")
def iterations():
    return []


@pytest.fixture(scope="module")
def found(iterations):
    match = abfm.match(
        SPHERE,
        SPHERE.vertices[:, 0],
        SPHERE.vertices[:, 1],
        abfm.Parameters(iterations=12, levels=2, reach=0.5),
        on_iteration=iterations.append,
    )
    verdict = Verdict("matched", "the mismatch fell from 1 to 0.012", "")
    return replace(
        match, mismatch=0.0123, verified_mismatch=0.03, folded=0.001, stop_reason="converged", verdict=verdict
    )


def judged(match, kind, **known):
    return replace(match, verdict=Verdict(kind, "the mismatch fell from 1 to 0.5: the cause", "advice"), **known)


@pytest.mark.parametrize(
    ("kind", "mismatch", "verified", "said", "meant"),
    [
        ("matched", 0.002, 0.007, "matched to 0.7%", "good"),
        ("matched", 0.0123, math.nan, "matched to 1%", "good"),
        ("matched", 0.0, 1e-9, "matched to less than 0.01%", "good"),
        ("nearly", 0.08, 0.07, "nearly: 8% left", "ink"),
        ("not reached", 0.05, 0.333, "not reached: 33% left", "failure"),
        ("not reached", 1.0, 1.41, "not reached: 141% left", "failure"),
        ("impossible", 0.01, 0.01, "impossible", "failure"),
    ],
)
def test_the_headline_says_how_well_by_the_worse_mismatch_and_has_a_colour(
    found, kind, mismatch, verified, said, meant
):
    match = judged(found, kind, mismatch=mismatch, verified_mismatch=verified)
    assert headline(match) == said
    assert tone(match) == meant


def test_percents_have_as_many_digits_as_one_reads():
    values = [1e-5, 1e-4, 0.00094, 0.0096, 0.0149, 0.0996, 0.995]
    assert [share(value) for value in values] == ["less than 0.01%", "0.01%", "0.09%", "1%", "1%", "10%", "100%"]


def test_why_it_stopped_is_the_verdict_s_cause_or_how_it_ended(found):
    assert why(judged(found, "not reached")) == "the cause"
    assert why(found) == "it stopped where going on gained little"
    assert why(replace(found, stop_reason="iteration limit")) == "it stopped after the 12 iterations it was given"


def test_what_is_not_known_is_left_out(found):
    assert numbers(found) == "0.0123, 0.03 by flow lines, 0.1% folded"
    assert numbers(replace(found, verified_mismatch=math.nan)) == "0.0123, 0.1% folded"
    assert numbers(replace(found, verified_mismatch=math.nan, folded=math.nan)) == "0.0123"


def test_remedies_are_options_of_the_command_line_and_else_advice_is_words(found):
    remedies = (
        Remedy("Reach further", "a larger reach", {"reach": 0.6, "levels": 0}),
        Remedy("Continue", "go on", {}, True),
    )
    match = replace(found, verdict=Verdict("not reached", "why", "a larger reach; or go on", remedies))
    assert advice_in_options(match, "m.npz") == "reach further (--reach 0.6 --levels 0), or continue (--start m.npz)"
    assert changes(remedies[0]) == "A larger reach.\nStarts a run from no motion, with reach 0.6, levels 0."
    assert changes(remedies[1]) == "Go on.\nStarts a run from the present field."
    assert advice_in_options(judged(found, "impossible"), "m.npz") == "advice"
    assert advice(replace(match, stop_reason="given")) == ""


@pytest.mark.parametrize(
    ("reason", "start", "words"),
    [("cancelled", "cancelled: 3% left", "best field so far"), ("given", "field given", "Play")],
)
def test_what_did_not_come_to_its_end_has_words_of_its_own(found, reason, start, words):
    match = replace(found, stop_reason=reason)
    assert headline(match) == start
    assert tone(match) == "ink"
    assert words in why(match)


def test_a_place_names_mesh_stage_and_reach(found, iterations):
    assert place(iterations[0]) == "mesh 1/2, stage 1, reach 0.5"
    assert place(replace(iterations[0], levels=1, stage=2, reach=0.0)) == "stage 3"


def test_one_is_no_plural():
    assert [counted(number, "iteration") for number in (0, 1, 2)] == ["0 iterations", "1 iteration", "2 iterations"]
