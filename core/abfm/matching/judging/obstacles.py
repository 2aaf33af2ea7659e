"""What prevents a match and is known of the functions before the first iteration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from abfm.matching import solvability
from abfm.matching.judging.cause import ADVICE, Cause, sentence_of
from abfm.matching.problem import Problem
from abfm.matching.terms.functions import FunctionTerm
from abfm.outcome import RESIDUAL_NEARLY, Facts, Outcome
from abfm.wording import share, value


@dataclass(frozen=True)
class Obstacle:
    """A reason why functions do not match: its outcome, cause and details of the sentence."""

    outcome: Outcome
    cause: Cause
    details: dict[str, Any]


def expected_facts(problem: Problem) -> Facts | None:
    """Return what is known of a match before it is solved.

    The outcome is impossible if no flow can match the functions, and nearly if they have other
    peaks or pits, near which a flow cannot match them. The check is symmetric: exchanging source
    and target gives the same outcome. None if nothing is in the way, or if the functions agree
    already within the goal.
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
        "impossible" if found.outcome is Outcome.IMPOSSIBLE else "a part may not match",
        sentence_of(found.cause, **found.details),
        ADVICE[found.cause],
        {"initial_residual": initial, "residual_bound": solvability.value_gap(functions)},
    )


def obstacle(functions: FunctionTerm) -> Obstacle | None:
    """Return why no flow can match functions; None if one may."""
    flat = solvability.source_is_constant(functions)
    to_flat = solvability.target_is_constant(functions)
    if flat or to_flat:
        both = Cause.BOTH_CONSTANT if to_flat else Cause.SOURCE_CONSTANT
        return Obstacle(Outcome.IMPOSSIBLE, both if flat else Cause.TARGET_CONSTANT, {})
    if solvability.value_gap(functions) > RESIDUAL_NEARLY:
        return missing_values(functions)
    return None


def missing_values(functions: FunctionTerm) -> Obstacle:
    """Return the obstacle that one of the functions has values which the other lacks."""
    channel = solvability.worst_channel(functions)
    known = functions.areas > 0
    values = [side[channel, known] for side in (functions.source, functions.target)]
    span = max(float(np.ptp(each)) for each in values)
    source, target = (f"{value(v.min(), span)} to {value(v.max(), span)}" for v in values)
    return Obstacle(
        Outcome.IMPOSSIBLE,
        Cause.VALUES_DIFFER,
        {
            "channel": _channel(functions, channel),
            "source": source,
            "target": target,
            "bound": share(solvability.value_gap(functions)),
        },
    )


def differing(functions: FunctionTerm) -> Obstacle | None:
    """Return the obstacle of peaks, pits and boundary values that differ; None if there is none."""
    found = solvability.first_difference(functions)
    if found is None:
        return None
    channel, here, there = found
    details = {"channel": _channel(functions, channel), "here": here, "there": there}
    return Obstacle(Outcome.NEARLY, Cause.EXTREMA_DIFFER, details)


def _channel(functions: FunctionTerm, channel: int) -> str:
    return f"in channel {channel + 1} " if len(functions.source) > 1 else ""
