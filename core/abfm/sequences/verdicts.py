"""Verdicts of intervals, with the noise of the frames taken into account."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from abfm.matching.judging.cause import ADVICE, Cause, sentence_of
from abfm.matching.judging.verdict import Evidence, Verdict, judge
from abfm.matching.problem import Problem
from abfm.matching.solvability import narrowest, range_bound
from abfm.matching.solving.record import StopReason
from abfm.matching.terms.functions import FunctionTerm
from abfm.outcome import Facts, Outcome, WarningTopic, worse_residual
from abfm.sequences.noise import NOISE_FACTOR, explains_too_little, noise_floor
from abfm.sequences.solving.solve import IntervalMeasures
from abfm.types import FloatArray
from abfm.wording import counted

# noise with a larger share of the standard deviation (three quarters of the variance) is pure noise
_NOISE_SHARE_MAX = 0.85
# structures across fewer edges are hardly advected, and look like noise
_RESOLVED_EDGES_MIN = 2.0
_UNSOLVED_VERDICT = Verdict(
    Outcome.NOT_REACHED,
    sentence_of(Cause.NOT_SOLVED),
    ADVICE[Cause.NOT_SOLVED],
    cause=Cause.NOT_SOLVED,
)
_CONFIRMED = "each frame is advected to the next one, also along flow lines"

NUMBERS = ("residual", "verified_residual", "folded", "motion_share")
"""Measurements of each interval, (T - 1,), except the last, which is one number for all."""


def outcome_of_intervals(outcomes: Sequence[Outcome]) -> Outcome:
    """Return the outcome of a sequence: good if at least half of its intervals are good.

    The outcome is the most common one among the good intervals, or else among the other intervals.
    """
    is_good = 2 * sum(outcome.is_good for outcome in outcomes) >= len(outcomes)
    counts = Counter(outcome for outcome in outcomes if outcome.is_good == is_good)
    return max(counts, key=lambda outcome: (counts[outcome], -outcome.rank))


def facts_of_intervals(verdicts: Sequence[Verdict], *numbers: FloatArray) -> Facts:
    """Return the facts of a sequence from the verdicts (T - 1,) and numbers of its intervals.

    ``numbers`` are those of `NUMBERS`, of which the facts have the medians.
    """
    outcome = outcome_of_intervals([verdict.kind for verdict in verdicts])
    confirmed, count = sum(verdict.kind.is_good for verdict in verdicts), len(verdicts)
    share = f"{confirmed} of {counted(count, 'interval')}"
    solved = [not is_unsolved(verdict) for verdict in verdicts]
    others = [verdict for verdict in verdicts if not verdict.kind.is_good]
    causes = Counter(verdict.why or verdict.reason for verdict in others)
    missing, unconfirmed = solved.count(False), len(others) - solved.count(False)
    warnings = [f"{counted(missing, 'interval')} not solved"] if missing else []
    if outcome.is_good and unconfirmed:
        warnings.append(f"{counted(unconfirmed, 'interval')} not confirmed")
    topics = Counter(verdict.topic for verdict in verdicts if verdict.kind is outcome)
    return Facts(
        outcome,
        f"{'nearly matched' if outcome is Outcome.NEARLY else outcome}: {share} confirmed",
        causes.most_common(1)[0][0] if causes else _CONFIRMED,
        numbers={
            name: float(np.median(known)) if (known := each[np.isfinite(each)]).size else None
            for name, each in zip(NUMBERS, numbers, strict=True)
        },
        warnings=tuple(warnings),
        is_complete=not missing,
        topics=(
            topics.most_common(1)[0][0],
            *([Cause.NOT_SOLVED] if missing else []),
            *([WarningTopic.NOT_CONFIRMED] if outcome.is_good and unconfirmed else []),
        ),
    )


def verdict_of(
    problem: Problem, measures: IntervalMeasures, levels: FloatArray, found: bool
) -> Verdict:
    """Return the verdict of an interval; ``found`` is false if the interval is not solved.

    It is that of a match, except that a residual within the noise is accepted. The standard
    deviations of the noise are ``levels`` (C, V).
    """
    functions = problem.functions
    if not found:
        return _UNSOLVED_VERDICT
    by_lines = measures.verified_residual
    evidence = Evidence(
        measures.advected, measures.residual, StopReason.NO_PROGRESS, by_lines, measures.folded
    )
    verdict = judge(functions, evidence, problem.parameters)
    residual = worse_residual(measures.residual, by_lines)
    if functions.norm(levels) > _NOISE_SHARE_MAX * functions.function_size:
        return verdict.with_cause(Outcome.NOT_REACHED, Cause.NOISE, noise=_noise(functions))
    if verdict.cause is Cause.BOTH_CONSTANT:
        return replace(verdict.with_cause(Outcome.NOT_REACHED, verdict.cause), advice="")
    if verdict.cause is Cause.VALUES_DIFFER and _lacks_values(functions, levels):
        return replace(verdict, advice="", remedies=())
    if residual <= NOISE_FACTOR * noise_floor(functions, levels) and not verdict.kind.is_good:
        noise = _noise(functions)
        verdict = verdict.with_cause(Outcome.REGISTERED, Cause.WITHIN_NOISE, noise=noise)
    if verdict.kind.is_good and explains_too_little(functions, levels, residual):
        cause = _unexplained(functions, levels, measures)
        return verdict.with_cause(Outcome.NOT_REACHED, cause, edges=narrowest(functions))
    return verdict if verdict.kind.is_good else replace(verdict, advice="", remedies=())


def without_determined_motion(verdict: Verdict) -> Verdict:
    """Return "not reached" for a good verdict, if held-out frames do not confirm the motion."""
    if not verdict.kind.is_good:
        return verdict
    return replace(verdict.with_cause(Outcome.NOT_REACHED, Cause.UNDETERMINED), advice="")


_WITHOUT_MOTION = (
    *(Cause.UNDETERMINED, Cause.NO_MOTION, Cause.NO_MOTION_ON_MESH),
    *(Cause.NOISE, Cause.BOTH_CONSTANT, Cause.NOT_SOLVED),
)


def allows_motion(verdict: Verdict) -> bool:
    """Return whether the verdict of an interval allows its field to be a motion."""
    return verdict.cause not in _WITHOUT_MOTION


def motion_shares(verdicts: Sequence[Verdict], share: float) -> FloatArray:
    """Return `abfm.Sequence.motion_shares`, (T - 1,); ``share`` is NaN if it is unknown."""
    known = [verdict.kind.is_good if math.isnan(share) else share for verdict in verdicts]
    return np.where([allows_motion(verdict) for verdict in verdicts], known, 0.0)


def _lacks_values(functions: FunctionTerm, levels: FloatArray) -> bool:
    """Return whether one frame has values that the other frame lacks, beyond noise."""
    sides = (functions, functions.reversed())
    return any(range_bound(side) > NOISE_FACTOR * noise_floor(side, levels) for side in sides)


def _noise(functions: FunctionTerm) -> str:
    """Return the cause of a residual: noise, or also narrow details if the mesh has long edges."""
    is_coarse = narrowest(functions) < _RESOLVED_EDGES_MIN
    return "noise or details narrower than edges" if is_coarse else "noise"


def _unexplained(functions: FunctionTerm, levels: FloatArray, measures: IntervalMeasures) -> Cause:
    """Return the reason why a field explains little of the change between frames.

    The change is not a motion only if both checks explain little and the mesh resolves the
    functions.
    """
    if not explains_too_little(functions, levels, measures.residual):
        return Cause.ONLY_DISCRETE_FLOW
    by_lines = measures.verified_residual
    if not (math.isnan(by_lines) or explains_too_little(functions, levels, by_lines)):
        return Cause.ONLY_FLOW_LINES
    is_coarse = narrowest(functions) < _RESOLVED_EDGES_MIN
    return Cause.NO_MOTION_ON_MESH if is_coarse else Cause.NO_MOTION


def is_unsolved(verdict: Verdict) -> bool:
    """Return whether a run was cancelled before it solved an interval; its field is then 0."""
    return verdict.cause is Cause.NOT_SOLVED
