"""What is offered after a match: that it is allowed, that it fits, and that it helps."""

import json
import math
from dataclasses import asdict, replace

import numpy as np
import pytest

import abfm
from abfm.errors import ParameterError
from abfm.matching import Remedy
from abfm.matching.judging.verdict import Outcome, Remedies
from abfm.matching.judging.verdict import advice as judged
from abfm.matching.solving.record import StopReason
from abfm.matching.terms.functions import FunctionTerm
from abfm.parameters import LARGEST_ALPHA, MANY, PAPER, SMALLEST, Parameters
from tests.core.fields import bump
from tests.shapes import ellipsoid

EGG = ellipsoid(3, 1.0, 0.7, 0.55)
BLIND = Parameters(**PAPER, alpha=0.02, sigma=1e-3, cooling_factor=10, iterations=150)
"""The paper's course, which looks for nothing far away."""


def at(degrees, width=0.1):
    """A Gaussian on the egg, so far around from its blunt side."""
    angle = np.deg2rad(degrees)
    return bump(EGG, [np.sin(angle), 0, 0.55 * np.cos(angle)], width)


def followed(match, remedy):
    """The match that a remedy leads to."""
    parameters = replace(match.parameters, **remedy.parameters)
    start = match.start_for(parameters) if remedy.goes_on else None
    return abfm.match(match.mesh, match.source[:, 0], match.target[:, 0], parameters, start=start)


@pytest.mark.parametrize(
    ("labels", "degrees", "parameters"),
    [
        (["Reach further"], 150, BLIND),
        (["Reach further"], 150, Parameters(reach=0.0)),
        (["More time", "Continue"], 60, Parameters(iterations=8)),
        (["More time"], 150, Parameters(iterations=8)),
        (["Match closer"], 150, Parameters(sigma=30.0, cooling_stages=1)),
        (["Smoother"], 90, Parameters(order=1, alpha=0.001, balance=0.0)),
    ],
)
def test_each_remedy_lowers_what_flow_lines_leave(labels, degrees, parameters):
    match = abfm.match(EGG, at(0), at(degrees), parameters)
    assert match.verdict.kind in ("nearly", "not reached")
    assert [remedy.label for remedy in match.verdict.remedies] == labels
    for remedy in match.verdict.remedies:
        assert followed(match, remedy).verified_mismatch < match.verified_mismatch, remedy


def test_a_larger_tau_is_a_smaller_sigma():
    """So that there is no remedy of more time in that sense."""
    p = Parameters(sigma=0.1, levels=1, balance=0.0, iterations=20)
    slow, long = (
        abfm.match(EGG, at(0, 0.2), at(60, 0.2), q)
        for q in (replace(p, sigma=0.05), replace(p, tau=4.0))
    )
    np.testing.assert_allclose(
        4 * long.velocity, slow.velocity, atol=1e-6 * np.abs(slow.velocity).max()
    )
    np.testing.assert_allclose(long.energy_history[:, 0], slow.energy_history[:, 0] / 4, rtol=1e-6)


def test_a_remedy_changes_only_what_differs_and_is_plain_for_json():
    problem = FunctionTerm(EGG, at(0), at(120))
    blind = Remedies(problem, BLIND, np.nan).further()
    assert blind.parameters["reach"] == 1.0
    assert {"order", "levels", "sigma", "sigma_unit", "iterations"} <= blind.parameters.keys()
    assert "the course of the defaults" in blind.words
    near = Remedies(problem, Parameters(reach=0.05), np.nan).further()
    assert near.parameters == {"reach": 1.0}
    for remedy in (blind, near):
        assert json.loads(json.dumps(asdict(remedy))) == asdict(remedy)


def test_sigma_that_was_raised_is_lowered_as_an_absolute_one():
    problem, p = FunctionTerm(EGG, at(0), at(60)), Parameters()
    assert Remedies(problem, p, np.nan).closer().parameters == {"sigma": 0.0067}
    raised = Remedies(problem, p, 0.3).closer().parameters
    assert raised["sigma_unit"] == "absolute"
    assert raised["sigma"] == pytest.approx(0.1 * problem.function_size, rel=0.05)


@pytest.mark.parametrize(
    ("parameters", "labels"),
    [
        (Parameters(alpha=0.5), "Match closer"),
        (Parameters(sigma=0.5), "Match closer"),
        (Parameters(alpha=0.001), "Smoother"),
        (Parameters(reach=0.01), "Reach further"),
    ],
)
def test_what_flow_lines_refute_goes_back_towards_the_defaults_first(parameters, labels):
    found = Remedies(FunctionTerm(EGG, at(0, 0.2), at(60, 0.2)), parameters, np.nan).truer()
    assert found is not None
    assert found.label == labels


def test_no_field_is_smooth_enough_for_functions_that_the_mesh_does_not_carry():
    narrow = FunctionTerm(EGG, at(0, 0.01), at(60, 0.01))
    assert Remedies(narrow, Parameters(), np.nan).truer() is None
    for problem, labels in (
        (narrow, []),
        (FunctionTerm(EGG, at(0, 0.2), at(60, 0.2)), ["Smoother"]),
    ):
        refuted = Outcome(problem.target, 0.0, StopReason.CONVERGED, verified=0.5)
        assert [
            remedy.label for remedy in judged(problem, refuted, Parameters()).remedies
        ] == labels
        doubted = judged(problem, replace(refuted, verified=0.2), Parameters())
        assert (doubted.kind, doubted.remedies) == ("nearly", ())


@pytest.mark.parametrize("wrong", [{"sigmma": 1.0}, {"sigma": -1.0}, {"sigma": "small"}])
def test_a_remedy_with_wrong_parameters_is_refused(wrong):
    with pytest.raises(ParameterError, match="sigm"):
        Remedy("Match closer", "a smaller sigma", wrong)


EXTREMES = (
    Parameters(alpha=LARGEST_ALPHA),
    Parameters(sigma=SMALLEST),
    Parameters(iterations=MANY),
)


@pytest.mark.parametrize("parameters", EXTREMES)
@pytest.mark.parametrize("size", [1.0, 1e-29])
def test_parameters_at_their_ends_cost_no_result(parameters, size):
    problem = FunctionTerm(EGG, size * EGG.vertices[:, 0], size * EGG.vertices[:, 1])
    for unmatched in (math.nan, 0.3):
        remedies = Remedies(problem, parameters, unmatched)
        given = (
            remedies.more_time(),
            remedies.smoother(),
            remedies.closer(),
            remedies.colder(),
            remedies.further(),
        )
        for remedy in given:
            replace(parameters, **remedy.parameters)
