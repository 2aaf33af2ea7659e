"""Obstacles to a match that can be found before the first iteration."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from abfm.calculus.smoothing import smoothed
from abfm.matching import solvability
from abfm.matching.judging.cause import ADVICE, Cause, sentence_of
from abfm.matching.problem import Problem
from abfm.matching.terms.functions import FunctionTerm
from abfm.outcome import RESIDUAL_NEARLY, Facts, Outcome
from abfm.wording import value

_LENGTHS = (0.01, 0.02, 0.05, 0.1)  # of a smoothing that is tried, in sqrt(area)


@dataclass(frozen=True)
class Obstacle:
    """A reason why functions cannot match: outcome, cause and details of the sentence about it."""

    outcome: Outcome
    cause: Cause
    details: dict[str, Any]


def expected_facts(problem: Problem) -> Facts | None:
    """Return facts about the first of the `expected_obstacles` of a problem, or None."""
    return next(iter(expected_obstacles(problem)), None)


def expected_obstacles(problem: Problem) -> tuple[Facts, ...]:
    """Return facts about each obstacle that is found before a match is solved.

    The outcome is ``impossible`` if no flow can match f to g, or none can match g to f. It is
    ``nearly`` if other values are missing, or if peaks, pits or boundary values differ. If ranges
    differ, peaks and pits are compared after the source is scaled to the range of the target. If
    the functions already agree within the goal, there is no obstacle.
    """
    functions = problem.functions
    if problem.is_of_landmarks or not functions.weights.any():
        return ()
    initial, found = functions.residual(functions.source), obstacle(functions)
    if initial <= problem.parameters.goal and not (found and found.cause is Cause.BOTH_CONSTANT):
        return ()
    bound = solvability.range_bound(functions)
    if found is None and bound > problem.parameters.goal and not solvability.is_measured(functions):
        found = replace(missing_values(functions), outcome=Outcome.NEARLY)
    obstacles = [found] if found else []
    if found is None or found.cause is Cause.VALUES_DIFFER:
        compared = functions if found is None else _with_equal_ranges(functions)
        other = differing(compared)
        obstacles += [other] if other else []
    numbers = {"initial_residual": initial, "residual_bound": solvability.value_gap(functions)}
    return tuple(
        Facts(
            each.outcome,
            "impossible" if each.outcome is Outcome.IMPOSSIBLE else "may match only in part",
            sentence_of(each.cause, **each.details),
            ADVICE[each.cause],
            numbers,
            topics=(each.cause,),
        )
        for each in obstacles
    )


def sufficient_smoothing(problem: Problem) -> tuple[int, float] | None:
    """Return the channel that no flow can match, and the length of a smoothing that changes this.

    Peaks, pits and boundary values agree after both functions are smoothed over this length, in
    sqrt(area), and scaled to one range. None if this needs more than 0.1 sqrt(area).
    """
    functions = _with_equal_ranges(problem.functions)
    if (found := solvability.first_difference(functions)) is None:
        return None
    mesh, channel = functions.mesh, found[0]
    pair = np.stack([functions.source[channel], functions.target[channel]], axis=1)
    for length in _LENGTHS:
        term = FunctionTerm(mesh, *smoothed(mesh, pair, length * mesh.length_scale).T)
        if solvability.first_difference(_with_equal_ranges(term)) is None:
            return channel, length
    return None


def _with_equal_ranges(functions: FunctionTerm) -> FunctionTerm:
    """Return the functions with each source scaled to the range of its target; constants stay."""
    source, target = functions.source, functions.target
    low, least = (f.min(axis=1, keepdims=True) for f in (source, target))
    spans = [np.ptp(f, axis=1, keepdims=True) for f in (source, target)]
    is_scaled = (spans[0] > 0) & (spans[1] > 0)
    factor = np.where(is_scaled, spans[1] / np.where(is_scaled, spans[0], 1), 1.0)
    scaled = np.where(is_scaled, factor * (source - low) + least, source)
    return functions.with_values(functions.mesh, scaled, target, functions.mask)


def obstacle(functions: FunctionTerm) -> Obstacle | None:
    """Return the obstacle that makes a match impossible; None if there is none."""
    is_source_constant = solvability.source_is_constant(functions)
    is_target_constant = solvability.target_is_constant(functions)
    if is_source_constant and is_target_constant:
        return Obstacle(Outcome.IMPOSSIBLE, Cause.BOTH_CONSTANT, {})
    if is_source_constant or is_target_constant:
        cause = Cause.SOURCE_CONSTANT if is_source_constant else Cause.TARGET_CONSTANT
        where = "" if (functions.areas > 0).all() else "where the mask is above 0, "
        return Obstacle(Outcome.IMPOSSIBLE, cause, {"where": where})
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
            "it can only squeeze the other source values to small areas, and the match from target "
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
