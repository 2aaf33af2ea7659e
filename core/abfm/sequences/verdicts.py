"""What an interval came to, held against what its noise alone would leave."""

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
from abfm.outcome import Facts, Outcome, worse_residual
from abfm.sequences.noise import NOISE_FACTOR, explains_too_little, noise_floor
from abfm.sequences.solving.solve import IntervalMeasures
from abfm.types import FloatArray
from abfm.wording import counted

_NOTHING_BUT_NOISE = 0.85  # of the deviation, which is three quarters of the variance
_FEW_EDGES = 2.0  # what spans less is hardly carried, and looks like noise
_UNSOLVED_VERDICT = Verdict(
    Outcome.NOT_REACHED,
    sentence_of(Cause.NOT_SOLVED),
    ADVICE[Cause.NOT_SOLVED],
    cause=Cause.NOT_SOLVED,
)


NUMBERS = ("residual", "verified_residual", "folded", "motion_share")
"""Measurements of each interval, (T - 1,), but for the last, which is one number of all."""


def outcome_of_intervals(outcomes: Sequence[Outcome]) -> Outcome:
    """Return the outcome of a sequence: good if at least half of its intervals are good.

    It is the most common outcome among its good, or among its other, intervals.
    """
    is_good = 2 * sum(outcome.is_good for outcome in outcomes) >= len(outcomes)
    counts = Counter(outcome for outcome in outcomes if outcome.is_good == is_good)
    return max(counts, key=lambda outcome: (counts[outcome], -outcome.rank))


def facts_of_intervals(verdicts: Sequence[Verdict], *numbers: FloatArray) -> Facts:
    """Return the facts of a sequence by its intervals: verdicts, (T - 1,), and `NUMBERS`.

    The numbers are medians over the intervals in which they are known.
    """
    outcome = outcome_of_intervals([verdict.kind for verdict in verdicts])
    confirmed, count = sum(verdict.kind.is_good for verdict in verdicts), len(verdicts)
    share = f"{confirmed} of {counted(count, 'interval')}"
    solved = [not is_unsolved(verdict) for verdict in verdicts]
    others = [verdict for verdict in verdicts if not verdict.kind.is_good]
    causes = Counter(verdict.why for verdict in others if verdict.why)
    missing, unconfirmed = solved.count(False), len(others) - solved.count(False)
    warnings = [f"{counted(missing, 'interval')} not solved"] if missing else []
    if outcome.is_good and unconfirmed:
        warnings.append(f"{counted(unconfirmed, 'interval')} not confirmed")
    return Facts(
        outcome,
        f"{outcome}: {share} confirmed",
        "; ".join([f"flow lines confirm {share}", *(why for why, _ in causes.most_common(1))]),
        numbers={
            name: float(np.median(known)) if (known := each[np.isfinite(each)]).size else None
            for name, each in zip(NUMBERS, numbers, strict=True)
        },
        warnings=tuple(warnings),
        is_complete=not missing,
    )


def verdict_of(
    problem: Problem, said: IntervalMeasures, levels: FloatArray, found: bool
) -> Verdict:
    """Return what an interval came to: as of any match, but that nothing more is asked of it than
    its noise, of levels (C, V), allows.
    """
    functions = problem.functions
    if not found:
        return _UNSOLVED_VERDICT
    evidence = Evidence(
        said.advected, said.residual, StopReason.NO_PROGRESS, said.verified_residual, said.folded
    )
    told = judge(functions, evidence, problem.parameters)
    left = worse_residual(said.residual, said.verified_residual)
    if functions.norm(levels) > _NOTHING_BUT_NOISE * functions.function_size:
        return told.with_cause(Outcome.NOT_REACHED, Cause.NOISE, noise=_noise(functions))
    if told.cause is Cause.BOTH_CONSTANT:
        return replace(told.with_cause(Outcome.NOT_REACHED, told.cause), advice="")
    if told.cause is Cause.VALUES_DIFFER and _lacks_values(functions, levels):
        return replace(told, advice="", remedies=())
    if left <= NOISE_FACTOR * noise_floor(functions, levels) and not told.kind.is_good:
        told = told.with_cause(Outcome.REGISTERED, Cause.WITHIN_NOISE, noise=_noise(functions))
    if told.kind.is_good and explains_too_little(functions, levels, left):
        cause = _unexplained(functions, levels, said)
        return told.with_cause(Outcome.NOT_REACHED, cause, edges=narrowest(functions))
    return told if told.kind.is_good else replace(told, advice="", remedies=())


def without_determined_motion(verdict: Verdict) -> Verdict:
    """Return the verdict of an interval of frames that determine no motion, by left-out frames."""
    if not verdict.kind.is_good:
        return verdict
    return replace(verdict.with_cause(Outcome.NOT_REACHED, Cause.UNDETERMINED), advice="")


_WITHOUT_MOTION = (
    Cause.UNDETERMINED,
    Cause.NO_MOTION,
    Cause.NO_MOTION_ON_MESH,
    Cause.NOISE,
    Cause.BOTH_CONSTANT,
    Cause.NOT_SOLVED,
)


def determines_motion(verdict: Verdict) -> bool:
    """Return whether an interval may be a motion by its verdict, confirmed or not."""
    return verdict.cause not in _WITHOUT_MOTION


def motion_shares(verdicts: Sequence[Verdict], share: float) -> FloatArray:
    """Return the share of motion between frames of each interval, (T - 1,), see
    `abfm.Sequence.motion_shares`.
    """
    known = [verdict.kind.is_good if math.isnan(share) else share for verdict in verdicts]
    return np.where([determines_motion(verdict) for verdict in verdicts], known, 0.0)


def _lacks_values(functions: FunctionTerm, levels: FloatArray) -> bool:
    """Return whether one of the frames has values that the other lacks, beyond noise of levels
    (C, V).
    """
    sides = (functions, functions.reversed())
    return any(range_bound(side) > NOISE_FACTOR * noise_floor(side, levels) for side in sides)


def _noise(functions: FunctionTerm) -> str:
    """Say what no neighbour knows of a function: noise, but where edges are long, as those of
    needles are, what is bent within one, too.
    """
    is_coarse = narrowest(functions) < _FEW_EDGES
    return "noise, or what is narrower than edges," if is_coarse else "noise"


def _unexplained(functions: FunctionTerm, levels: FloatArray, said: IntervalMeasures) -> Cause:
    """Return why a field explains little by the worse witness: what changes is no motion only where
    the other one has none either, and the mesh could carry it.
    """
    if not explains_too_little(functions, levels, said.residual):
        return Cause.ONLY_DISCRETE_FLOW
    by_lines = said.verified_residual
    if not (math.isnan(by_lines) or explains_too_little(functions, levels, by_lines)):
        return Cause.ONLY_FLOW_LINES
    is_coarse = narrowest(functions) < _FEW_EDGES
    return Cause.NO_MOTION_ON_MESH if is_coarse else Cause.NO_MOTION


def is_unsolved(verdict: Verdict) -> bool:
    """Return whether a run was cancelled before an interval, whose field is 0 for that."""
    return verdict.cause is Cause.NOT_SOLVED
