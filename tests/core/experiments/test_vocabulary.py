"""What all figures share."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from abfm import Parameters, Problem, match
from abfm.errors import MeshError, ParameterError
from abfm.experiments.vocabulary import Measure, affordable_iterations
from abfm.experiments.witnesses import witnessed
from abfm.matching.judging.verification import Verification
from abfm.matching.result import Match
from tests.shapes import icosphere

SPHERE = icosphere(2)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_cannot_be_measured_is_said(value: float) -> None:
    with pytest.raises(MeshError, match=f"'length, m' came out as {value}"):
        Measure("length, m", value)


def test_fine_meshes_have_fewer_iterations_within_limits() -> None:
    counts = [affordable_iterations(icosphere(level), 300) for level in (2, 5, 6)]
    assert counts[0] == 300
    assert 60 < counts[1] < 300
    assert counts[2] == 60


@pytest.fixture(scope="module")
def found():
    return match(SPHERE, SPHERE.vertices[:, 0], SPHERE.vertices[:, 1], Parameters(iterations=3))


def test_numbers_are_those_of_the_verification(found):
    of = found.verify()
    measures, label, note = witnessed(found)
    assert [measure.value for measure in measures] == [of.flow_lines, of.subdivided, of.folded]
    assert f"{of.flow_lines:.2g} by flow lines" in label
    assert note == ""


def test_what_overflows_is_told_and_no_number(found, monkeypatch):
    of = replace(found.verify(), subdivided=np.inf)
    monkeypatch.setattr(Match, "verify", lambda self: of)
    measures, _, note = witnessed(found)
    assert [measure.value for measure in measures] == [of.flow_lines, of.folded]
    assert "overflows" in note


def test_fields_that_cannot_be_followed_end_no_experiment(found, monkeypatch):
    def refuse(self: Match) -> Verification:
        raise ParameterError("too fast")

    monkeypatch.setattr(Match, "verify", refuse)
    measures, _, note = witnessed(found)
    assert measures == ()
    assert "too fast" in note


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_a_field_that_does_nothing_leaves_what_there_was(found, share):
    problem = Problem(SPHERE, found.source, found.source * (1 + share), found.parameters)
    still = replace(found, problem=problem, velocity=0 * found.velocity)
    assert witnessed(still)[0][0].value == pytest.approx(share / (1 + share), abs=1e-9)
