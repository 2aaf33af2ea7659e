"""Facts of a match: headline, reason, advice, numbers and warnings of all reports."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from abfm.matching.judging.cause import Cause, limit_sentence, sentence_of
from abfm.matching.judging.verdict import Evidence, Verdict, sentence_of_bound
from abfm.matching.solving.record import StopReason
from abfm.outcome import Facts, Outcome, WarningTopic, outcome_of, worse_residual
from abfm.parameters import Parameters
from abfm.types import FloatArray
from abfm.wording import counted, factor, farthest_of, share

LOG2_AREA_GOOD = 1.0
"""Largest 95th percentile of ``|log2 J|`` without a warning; 1 is a factor of 2 in area."""
_SHARE_REDUCED = 0.995  # a residual of a larger share of the initial one is not reduced
_UNFINISHED_REASONS = {
    StopReason.CANCELLED: "the run was cancelled; this is the best field so far",
    StopReason.OUT_OF_MEMORY: "memory ran out; this is the best field so far",
    StopReason.GIVEN: (
        "no field was computed yet; Play shows the flow of the given field, Match computes another"
    ),
}
_STOP_SENTENCES = {
    StopReason.CONVERGED: "no change of the field lowers the energy further",
    StopReason.GOAL_REACHED: "the solver stopped as soon as its residual was below the goal",
    StopReason.NO_PROGRESS: "further iterations no longer improved the match",
    StopReason.LINE_SEARCH_FAILED: sentence_of(Cause.LINE_SEARCH_FAILED),
}


@dataclass(frozen=True, eq=False)
class Report:
    """The verdict and measurements of a match, which the method `facts` puts into words."""

    verdict: Verdict
    evidence: Evidence
    parameters: Parameters
    initial_residual: float
    mismatch: float
    is_of_landmarks: bool
    log2_area_95: float = math.nan
    load_warning: str = ""
    choice: str = ""  # the choice of sigma in words, see `abfm.matching.path.choice_text`
    distortion_min: float = 0.0  # least bound of distortion that is surely reached

    def facts(self) -> Facts:
        evidence, verdict = self.evidence, self.verdict
        is_given = evidence.stop_reason is StopReason.GIVEN
        reason, bound = self._reason(), evidence.bound
        if bound and bound.is_satisfied and verdict.cause is not Cause.DISTORTION_LIMITED:
            reason += f"; {sentence_of_bound(bound)}"
        warnings = self._warnings()
        return Facts(
            verdict.kind,
            self._headline(),
            reason,
            "" if is_given else self._advice(),
            self._numbers(),
            tuple(warnings.values()),
            evidence.stop_reason not in _UNFINISHED_REASONS,
            (verdict.topic, *warnings),
            self._headline(is_short=True),
        )

    @property
    def _worse(self) -> float:
        return worse_residual(self.evidence.residual, self.evidence.verified)

    @property
    def _distorts(self) -> bool:
        return bool(distortion_warnings(self.verdict.kind, self.log2_area_95))

    def _headline(self, is_short: bool = False) -> str:
        reason, bound, outcome = self.evidence.stop_reason, self.evidence.bound, self.verdict.kind
        achieved, log2_area = _residual(self._worse, is_short), self.evidence.log2_area
        is_missed = outcome_of(self._worse, self.parameters.goal) is Outcome.NOT_REACHED
        if is_missed and self._worse >= _SHARE_REDUCED * self.initial_residual:
            achieved += ", not reduced"
        has_areas = False
        if reason is StopReason.GIVEN:
            headline = "given field"
        elif self.is_of_landmarks and reason.is_interrupted:
            headline = f"{reason}: {self._landmarks(is_short)}"
        elif self.is_of_landmarks and self.verdict.cause is Cause.INITIAL_MAP:
            headline = f"{outcome} (the initial map may be wrong)"
        elif self.is_of_landmarks:
            headline = f"{outcome}: {self._landmarks(is_short)}"
        elif reason is StopReason.CANCELLED:
            headline = f"cancelled ({achieved})"
        elif outcome is Outcome.NOT_REACHED and is_missed:
            headline = f"{outcome} ({achieved})"
        else:
            headline = headline_of(outcome, self._worse, self.parameters.goal, is_short)
            has_areas = self._distorts or outcome is Outcome.REGISTERED
        if has_areas and not math.isnan(log2_area):
            change = "areas ×" if is_short else "areas change by a factor of "
            headline += f", {change}{factor(log2_area)}"
        if bound and bound.is_satisfied:
            limit = "≤" if is_short else "within "
            headline += f", distortion {limit}{bound.max_distortion:g}"
        return headline

    def _landmarks(self, is_short: bool) -> str:
        errors = self._errors
        farthest = float(errors.max())
        if not math.isfinite(farthest):
            return f"errors of {counted(len(errors), 'landmark')} unknown"
        error = f"{share(farthest, is_short)}{'' if is_short else ' of sqrt(area)'}"
        return f"{farthest_of(len(errors), 'landmark')} {error} away"

    @property
    def _errors(self) -> FloatArray:
        assert self.evidence.landmarks is not None
        return self.evidence.landmarks[1]

    def _reason(self) -> str:
        reason, verdict = self.evidence.stop_reason, self.verdict
        if reason in _UNFINISHED_REASONS:
            return _UNFINISHED_REASONS[reason]
        limit = limit_sentence(self.parameters.solver.iterations)
        stopped = limit if reason is StopReason.ITERATION_LIMIT else _STOP_SENTENCES[reason]
        why = verdict.why or stopped
        if verdict.kind is Outcome.REGISTERED:
            parts = why, f"the initial residual was {share(self.initial_residual)}", self.choice
            return "; ".join(filter(None, parts))
        if verdict.kind is Outcome.MATCHED and self.is_of_landmarks:
            return "flow lines lead every landmark to its target"
        is_known = not math.isnan(self.evidence.verified)
        if verdict.kind is Outcome.MATCHED and is_known and verdict.cause is Cause.NONE:
            goal = share(self.parameters.goal)
            return f"confirmed: both checks have a residual of at most {goal}"
        return why

    def _advice(self) -> str:
        if self.verdict.advice or not self._distorts or self.evidence.bound is not None:
            return self.verdict.advice
        limit = max(LOG2_AREA_GOOD, self.distortion_min)
        if not math.isfinite(limit):
            return ""
        example = f"max_distortion {math.ceil(10 * limit) / 10:g}"
        return (
            f"limit the distortion, for example with {example}; a larger limit allows a smaller "
            "residual"
        )

    def _numbers(self) -> dict[str, float | None]:
        evidence = self.evidence
        numbers = {
            "residual": evidence.residual,
            "verified_residual": evidence.verified,
            "worse_residual": self._worse,
            "initial_residual": self.initial_residual,
            "mismatch": self.mismatch,
            "folded": evidence.folded,
            "log2_area": evidence.log2_area,
            "log2_area_95": self.log2_area_95,
        }
        if evidence.landmarks is not None:
            numbers["landmark_error"] = float(self._errors.max())
        if (bound := evidence.bound) is not None:
            numbers |= {
                "max_distortion": bound.max_distortion,
                "share_within": bound.share,
                "distortion_99": bound.largest,
            }
        return known_numbers(numbers)

    def _warnings(self) -> dict[WarningTopic, str]:
        found = {}
        if self.load_warning:
            found[WarningTopic.RECOMPUTED_VALUES] = self.load_warning
        if (bound := self.evidence.bound) is not None and not bound.is_satisfied:
            within = f"{100 * bound.share:.1f}% of the faces are within the bound"
            exceeded = f"the distortion exceeds the bound of {bound.max_distortion:g}"
            found[WarningTopic.LIMIT_EXCEEDED] = (
                f"{exceeded}: {within}, {counted(bound.folded, 'face')} folded"
            )
        return found | distortion_warnings(self.verdict.kind, self.log2_area_95)


def headline_of(
    outcome: Outcome, residual: float, goal: float = Parameters.goal, is_short: bool = False
) -> str:
    """Return the headline of an outcome, such as ``nearly matched (residual 8%)``.

    The residual is omitted if the outcome is bad, or does not follow from ``residual`` and
    ``goal``.
    """
    phrase = "nearly matched" if outcome is Outcome.NEARLY else str(outcome)
    by_size = outcome is Outcome.REGISTERED or outcome is outcome_of(residual, goal)
    return f"{phrase} ({_residual(residual, is_short)})" if outcome.is_good and by_size else phrase


def _residual(residual: float, is_short: bool) -> str:
    return f"residual {share(residual, is_short)}"


def distortion_warnings(outcome: Outcome, log2_area_95: float) -> dict[WarningTopic, str]:
    """Return the warning, by topic, that the map of a good result changes areas strongly, if so.

    ``log2_area_95`` is the 95th percentile of ``|log2 J|`` over the faces.
    """
    if not (outcome.is_good and log2_area_95 > LOG2_AREA_GOOD):
        return {}
    times = factor(log2_area_95)
    warning = f"5% of the area changes by a factor of {times} or more"
    return {WarningTopic.AREAS_CHANGE: warning}


def known_numbers(numbers: Mapping[str, float]) -> dict[str, float | None]:
    return {name: finite(number) for name, number in numbers.items()}


def finite(number: float) -> float | None:
    return float(number) if math.isfinite(number) else None
