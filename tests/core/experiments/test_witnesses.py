"""What witnesses say of an experiment's match."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from abfm import Parameters, match
from abfm.errors import ParameterError
from abfm.experiments.witnesses import witnessed
from abfm.matching.judging.verification import Verification
from abfm.matching.result import Match
from tests.shapes import icosphere

SPHERE = icosphere(2)


@pytest.fixture(scope="module")
def found():
    return match(SPHERE, SPHERE.vertices[:, 0], SPHERE.vertices[:, 1], Parameters(iterations=3))


def test_numbers_are_those_of_the_verification(found):
    of = found.verify()
    seen = witnessed(found)
    assert [measure.value for measure in seen.measures] == [of.flow_lines, of.subdivided, of.folded]
    assert f"{of.flow_lines:.2g} by flow lines" in seen.label
    assert seen.note == ""


def test_what_overflows_is_told_and_no_number(found, monkeypatch):
    of = replace(found.verify(), subdivided=np.inf)
    monkeypatch.setattr(Match, "verify", lambda self: of)
    seen = witnessed(found)
    assert [measure.value for measure in seen.measures] == [of.flow_lines, of.folded]
    assert "overflows" in seen.note


def test_fields_that_cannot_be_followed_end_no_experiment(found, monkeypatch):
    def refuse(self: Match) -> Verification:
        raise ParameterError("too fast")

    monkeypatch.setattr(Match, "verify", refuse)
    seen = witnessed(found)
    assert seen.measures == ()
    assert "too fast" in seen.note


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_a_field_that_does_nothing_leaves_what_there_was(found, share):
    still = replace(found, velocity=0 * found.velocity, target=found.source * (1 + share))
    assert witnessed(still).measures[0].value == pytest.approx(share / (1 + share), abs=1e-9)
