import numpy as np
import pytest

import abfm
from abfm import Parameters, Problem
from abfm.matching import expected_facts, expected_obstacles, sufficient_smoothing
from abfm.outcome import Outcome
from tests.core.fields import bump
from tests.messages import check_message
from tests.shapes import icosphere

SPHERE = icosphere(3)
COUNT = len(SPHERE.vertices)
SHORT_RUN = Parameters.of(iterations=5, refine=0)


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
OUTCOMES = {
    "higher peak": Outcome.IMPOSSIBLE,
    "vanishing values": Outcome.IMPOSSIBLE,
    "constant": Outcome.IMPOSSIBLE,
    "two constants": Outcome.IMPOSSIBLE,
    "two peaks": Outcome.NEARLY,
    "solvable": None,
    "equal": None,
}


@pytest.mark.parametrize("name", PAIRS)
def test_outcome_is_symmetric(name):
    f, g = PAIRS[name]
    for pair in ((f, g), (g, f)):
        found = expected_facts(Problem(SPHERE, *pair))
        assert (found and found.outcome) == OUTCOMES[name]


@pytest.mark.parametrize("name", [name for name, it in OUTCOMES.items() if it == "impossible"])
def test_verdict_agrees_with_expected_facts(name):
    f, g = PAIRS[name]
    for pair in ((f, g), (g, f)):
        problem = Problem(SPHERE, *pair, SHORT_RUN)
        found = abfm.match(problem)
        assert found.facts.outcome is Outcome.IMPOSSIBLE
        assert found.verdict.why == expected_facts(problem).reason


def test_reason_names_the_direction_of_the_bound():
    z = SPHERE.vertices[:, 2]
    higher, lower = (expected_facts(Problem(SPHERE, *pair)) for pair in ((z, 2 * z), (2 * z, z)))
    # the L2 norm of (2 |z| - 1)+ relative to that of 2 z, exact on the sphere
    bound = higher.numbers["residual_bound"]
    assert bound == lower.numbers["residual_bound"] == pytest.approx(np.sqrt(1 / 8), rel=0.02)
    check_message(higher.reason, "at least 35%")
    check_message(lower.reason, "target to source has a residual of at least 35%")


def test_rounding_errors_are_printed_as_zero():
    found = expected_facts(Problem(SPHERE, at(0, 0.08), 2 * at(30, 0.08)))
    check_message(found.reason, 0, 1)
    assert "e-1" not in found.reason


def test_landmarks_alone_have_no_obstacles():
    assert expected_facts(Problem(SPHERE, None, None, landmarks=[[0, 20]])) is None


def test_all_obstacles_are_listed():
    f, g = at(0), 2 * (at(60) + at(-60)) + 1
    ranges, peaks = expected_obstacles(Problem(SPHERE, f, g))
    assert ranges == expected_facts(Problem(SPHERE, f, g))
    check_message(ranges.reason, "0.0184 to 1", "1.2 to 3.1")
    check_message(peaks.reason, "1 peak and 1 pit", "2 peaks and 1 pit")
    [ranges] = expected_obstacles(Problem(SPHERE, f, 2 * at(60) + 1))
    assert ranges.topics == ("values differ",)


def test_some_missing_values_allow_a_partial_match():
    """The bound is above the goal of 5%, but below the 15% that make a match impossible."""
    problem = Problem(SPHERE, at(0), 1.15 * at(30), SHORT_RUN)
    [found] = expected_obstacles(problem)
    assert found.outcome is Outcome.NEARLY
    assert 0.05 < found.numbers["residual_bound"] < 0.15
    assert abfm.match(problem).verdict.kind is not Outcome.MATCHED


def test_reason_names_a_mask_that_leaves_a_constant():
    mask = SPHERE.vertices[:, 2] > 0
    g = np.where(mask, 0.5, at(180))
    check_message(expected_facts(Problem(SPHERE, at(0), g, mask=mask)).reason, "mask", 0)


def test_sufficient_smoothing_removes_the_difference():
    rough = at(0) + 0.5 * at(90, 0.05)
    problem = Problem(SPHERE, np.stack([at(30), rough], axis=1), np.stack([at(0), at(30)], axis=1))
    check_message(expected_facts(problem).reason, "channel 2", "2 peaks")
    channel, length = sufficient_smoothing(problem)
    assert channel == 1
    f, g = (
        abfm.calculus.smoothing.smoothed(SPHERE, each, length * SPHERE.length_scale)[:, 1]
        for each in (problem.source, problem.target)
    )
    f = (f - f.min()) / np.ptp(f) * np.ptp(g) + g.min()
    assert expected_facts(Problem(SPHERE, f, g)) is None
    assert sufficient_smoothing(Problem(SPHERE, f, g)) is None
    apart = at(90, 0.1) + at(-90, 0.1)
    assert sufficient_smoothing(Problem(SPHERE, at(0, 0.1), apart)) is None
