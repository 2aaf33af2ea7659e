"""Obstacles to a match that can be found before the first iteration."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from abfm.matching import solvability
from abfm.matching.judging.cause import ADVICE, Cause, sentence_of
from abfm.matching.problem import Problem
from abfm.matching.terms.functions import FunctionTerm
from abfm.outcome import RESIDUAL_NEARLY, Facts, Outcome
from abfm.wording import value


@dataclass(frozen=True)
class Obstacle:
    """A reason why functions cannot match: outcome, cause and details of the sentence about it."""

    outcome: Outcome
    cause: Cause
    details: dict[str, Any]


def expected_facts(problem: Problem) -> Facts | None:
    """Return facts about an obstacle that is found before a match is solved, or None.

    The outcome is ``impossible`` if no flow can match f to g, or none can match g to f. It is
    ``nearly`` if peaks, pits or boundary values differ. If the functions already agree within the
    goal, there is no obstacle.
    """
    functions = problem.functions
    if problem.is_of_landmarks or not functions.weights.any():
        return None
    initial = functions.residual(functions.source)
    found = obstacle(functions)
    if found is None or found.cause is not Cause.BOTH_CONSTANT:
        if initial <= problem.parameters.goal:
            return None
        found = found or differing(functions)
    if found is None:
        return None
    return Facts(
        found.outcome,
        "impossible" if found.outcome is Outcome.IMPOSSIBLE else "may match only in part",
        sentence_of(found.cause, **found.details),
        ADVICE[found.cause],
        {"initial_residual": initial, "residual_bound": solvability.value_gap(functions)},
        topics=(found.cause,),
    )


def obstacle(functions: FunctionTerm) -> Obstacle | None:
    """Return the obstacle that makes a match impossible; None if there is none."""
    is_source_constant = solvability.source_is_constant(functions)
    is_target_constant = solvability.target_is_constant(functions)
    if is_source_constant and is_target_constant:
        return Obstacle(Outcome.IMPOSSIBLE, Cause.BOTH_CONSTANT, {})
    if is_source_constant or is_target_constant:
        cause = Cause.SOURCE_CONSTANT if is_source_constant else Cause.TARGET_CONSTANT
        return Obstacle(Outcome.IMPOSSIBLE, cause, {})
    if solvability.value_gap(functions) > RESIDUAL_NEARLY:
        return missing_values(functions)
    return None


def missing_values(functions: FunctionTerm) -> Obstacle:
    """Return the obstacle that a function has values outside the range of the other function."""
    channel = solvability.worst_channel(functions)
    bound = solvability.range_bound(functions)
    bound_of_reverse = solvability.range_bound(functions.reversed())
    if bound >= bound_of_reverse:
        consequence = f"every exact flow has a residual of at least {_at_least(bound)}"
    else:
        consequence = (
            "it can only squeeze the other source values to small areas; the match from target "
            f"to source has a residual of at least {_at_least(bound_of_reverse)}"
        )
    known = functions.areas > 0
    values = [side[channel, known] for side in (functions.source, functions.target)]
    span = max(float(np.ptp(each)) for each in values)
    source, target = (f"{value(v.min(), span)} to {value(v.max(), span)}" for v in values)
    details = {"channel": _channel(functions, channel), "source": source, "target": target}
    details["consequence"] = consequence
    return Obstacle(Outcome.IMPOSSIBLE, Cause.VALUES_DIFFER, details)


def _at_least(bound: float) -> str:
    return f"{math.floor(100 * bound)}%"


def differing(functions: FunctionTerm) -> Obstacle | None:
    """Return the obstacle that peaks, pits or boundary values differ; None if they seem equal."""
    found = solvability.first_difference(functions)
    if found is None:
        return None
    channel, here, there = found
    details = {"channel": _channel(functions, channel), "here": here, "there": there}
    return Obstacle(Outcome.NEARLY, Cause.EXTREMA_DIFFER, details)


def _channel(functions: FunctionTerm, channel: int) -> str:
    return f"in channel {channel + 1} " if len(functions.source) > 1 else ""
