"""What a match came to, in words."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

import abfm
from abfm.matching.judging.verdict import Verdict
from abfm_viewer.document.verdict_words import explanation, headline, numbers, place
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


def test_a_match_is_told_in_a_line(found):
    assert headline(found) == "matched: mismatch 0.0123, 0.03 by flow lines, 0.1% folded"
    assert explanation(found) == ["The mismatch fell from 1 to 0.012."]


def test_what_is_not_known_is_left_out(found):
    assert numbers(replace(found, verified_mismatch=math.nan)) == "0.0123, 0.1% folded"
    assert numbers(replace(found, verified_mismatch=math.nan, folded=math.nan)) == "0.0123"


def test_advice_follows_the_reason(found):
    poor = replace(found, verdict=Verdict("not reached", "it was still falling", "more iterations"))
    assert headline(poor).startswith("not reached: mismatch ")
    assert explanation(poor) == ["It was still falling.", "To try: more iterations."]


@pytest.mark.parametrize(
    ("reason", "start", "words"),
    [("cancelled", "cancelled: ", "best field so far"), ("given", "field given: ", "press Play")],
)
def test_what_did_not_come_to_its_end_has_words_of_its_own(found, reason, start, words):
    match = replace(found, stop_reason=reason)
    assert headline(match).startswith(start)
    [said] = explanation(match)
    assert words in said


def test_a_place_names_mesh_stage_and_reach(found, iterations):
    assert place(iterations[0]) == "mesh 1/2, stage 1, reach 0.5"
    assert place(replace(iterations[0], levels=1, stage=2, reach=0.0)) == "stage 3"
