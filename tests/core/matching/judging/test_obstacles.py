"""Obstacles to a match that are known before the first iteration."""

import numpy as np
import pytest

import abfm
from abfm import Parameters, Problem
from abfm.matching import expected_facts
from abfm.outcome import Outcome
from abfm.wording import share
from tests.core.fields import bump
from tests.messages import check_message
from tests.shapes import icosphere

SPHERE = icosphere(3)
COUNT = len(SPHERE.vertices)
SHORT = Parameters.of(iterations=5, refine=0)


def at(degrees, width=0.2):
    angle = np.deg2rad(degrees)
    return bump(SPHERE, [0, np.sin(angle), np.cos(angle)], width)


PAIRS = {
    "higher peak": (at(0), 2 * at(30)),
    "vanishing values": (at(0) - at(180), at(30)),
    "constant": (at(0), np.full(COUNT, 0.5)),
    "two constants": (np.ones(COUNT), np.ones(COUNT)),
    "two peaks": (at(0), at(60) + at(-60)),
    "solvable": (at(0), at(30)),
    "equal": (at(0), at(0)),
}
# the outcomes of the match from the first function to the second, and of the reverse match
OUTCOMES = {
    "higher peak": (Outcome.IMPOSSIBLE, Outcome.NEARLY),
    "vanishing values": (Outcome.NEARLY, Outcome.IMPOSSIBLE),
    "constant": (Outcome.IMPOSSIBLE, Outcome.IMPOSSIBLE),
    "two constants": (Outcome.IMPOSSIBLE, Outcome.IMPOSSIBLE),
    "two peaks": (Outcome.NEARLY, Outcome.NEARLY),
    "solvable": (None, None),
    "equal": (None, None),
}


@pytest.mark.parametrize("name", PAIRS)
def test_only_missing_target_values_are_impossible(name):
    """Values that only the source has make a match partial, because a flow can squeeze them."""
    f, g = PAIRS[name]
    for pair, outcome in zip(((f, g), (g, f)), OUTCOMES[name], strict=True):
        found = expected_facts(Problem(SPHERE, *pair))
        assert (found and found.outcome) == outcome


@pytest.mark.parametrize("name", ["higher peak", "vanishing values", "constant", "two constants"])
def test_verdict_agrees_with_expected_facts(name):
    f, g = PAIRS[name]
    for pair, outcome in zip(((f, g), (g, f)), OUTCOMES[name], strict=True):
        problem = Problem(SPHERE, *pair, SHORT)
        found = abfm.match(problem)
        assert (found.facts.outcome is Outcome.IMPOSSIBLE) == (outcome is Outcome.IMPOSSIBLE)
        assert found.verdict.why == expected_facts(problem).reason


def test_expected_bound_is_that_of_the_match():
    z = SPHERE.vertices[:, 2]
    higher, lower = (expected_facts(Problem(SPHERE, *pair)) for pair in ((z, 2 * z), (2 * z, z)))
    # the L2 norm of (2 |z| - 1)+ relative to that of 2 z, exact on the sphere
    bound = higher.numbers["residual_bound"]
    assert bound == pytest.approx(np.sqrt(1 / 8), rel=0.02)
    assert lower.numbers["residual_bound"] == 0
    check_message(higher.reason, share(bound))
    check_message(lower.reason, share(bound), "target to source")


def test_rounding_errors_are_printed_as_zero():
    found = expected_facts(Problem(SPHERE, at(0, 0.08), 2 * at(30, 0.08)))
    check_message(found.reason, 0, 1)
    assert "e-1" not in found.reason


def test_landmarks_alone_have_no_obstacles():
    assert expected_facts(Problem(SPHERE, None, None, landmarks=[[0, 20]])) is None
