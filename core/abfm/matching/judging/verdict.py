"""The verdict of a match: its outcome and cause, as a sentence, and what to try."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from abfm.maps.distortion import BOUNDED_SHARE, Bound
from abfm.matching import solvability
from abfm.matching.judging.cause import ADVICE, Cause, sentence_of
from abfm.matching.judging.obstacles import Obstacle, differing, missing_values, obstacle
from abfm.matching.judging.remedies import CONTINUE_REMEDY, Remedies, Remedy
from abfm.matching.solving.record import StopReason
from abfm.matching.terms.functions import FunctionTerm
from abfm.matching.terms.landmarks import MATCHED_ERROR, residual_of_errors
from abfm.outcome import RESIDUAL_NEARLY, VERDICTS, Outcome, outcome_of, worse_residual
from abfm.parameters import Parameters
from abfm.types import FloatArray
from abfm.wording import factor, share

RESIDUAL_REGISTERED = 0.95
"""Largest residual of functions that are registered: at 1 they have nothing in common."""
SHARE_REGISTERED = 0.8
"""Largest share of the residual without motion, or of the initial map alone, that is left of
functions that are registered."""
_LOG2_AREA_MAX = 100.0  # of a change of areas that is written
# share of the faces beyond which a map is not to be trusted; an exact flow folds none
FOLDED_SHARE_MAX = 0.1
# an energy still falls if it has fallen by this share within so many iterations
_FALL_SHARE = 0.01
_FALL_ITERATIONS = 10
_LIMIT_REASONS = (StopReason.ITERATION_LIMIT, StopReason.CANCELLED, StopReason.OUT_OF_MEMORY)
_USUAL_GOAL = Parameters().goal


@dataclass(frozen=True)
class Verdict:
    """The outcome of a match and why; reason and advice are one line each, without a full stop."""

    # registered: measured functions, as closely as they allow; impossible: no flow can match them;
    # not reached: not by this flow, which may still be worth having
    kind: Outcome
    reason: str  # the first and the last residual, and what they mean after a colon
    advice: str  # what to try, empty where nothing is needed
    # the same as parameters, as far as they can do it, best first
    remedies: tuple[Remedy, ...] = ()
    cause: Cause = Cause.NONE

    @property
    def why(self) -> str:
        """What the residuals mean; empty if they speak for themselves."""
        return self.reason.partition(": ")[2]

    @property
    def change(self) -> str:
        """The first and the last residual."""
        return self.reason.partition(": ")[0]

    @property
    def texts(self) -> tuple[str, str, str, str]:
        """Outcome, cause, reason and advice, as files hold them."""
        return self.kind, self.cause, self.reason, self.advice

    @classmethod
    def of_texts(cls, texts: Sequence[str], remedies: tuple[Remedy, ...] = ()) -> "Verdict":
        """Return the verdict of `texts`; ValueError if its words are unknown."""
        kind, cause, reason, advice = texts
        if kind not in VERDICTS:
            expected = ", ".join(VERDICTS)
            raise ValueError(f"the verdict is {kind[:40]!r}; expected one of {expected}")
        return cls(Outcome(kind), reason, advice, remedies, Cause(cause))

    def with_cause(self, kind: Outcome, cause: Cause, **details: object) -> "Verdict":
        """Return the verdict of the same residuals with another outcome and cause."""
        reason = f"{self.change}: {sentence_of(cause, **details)}"
        return Verdict(kind, reason, ADVICE.get(cause, ""), (), cause)

    def for_step(self, sigma: float) -> "Verdict":
        """Return the verdict of a step of a path, without why the match ended and what helps."""
        if self.kind in (Outcome.MATCHED, Outcome.IMPOSSIBLE):
            return self
        return self.with_cause(self.kind, Cause.STEP_OF_PATH, sigma=sigma)

    def within(self, bound: Bound) -> "Verdict":
        """Return the verdict of a field that a bound of distortion keeps from coming closer."""
        if self.kind in (Outcome.MATCHED, Outcome.IMPOSSIBLE) or not bound.is_kept:
            return self
        return self.with_cause(self.kind, Cause.BOUNDED, **_bound_details(bound))


def sentence_of_bound(bound: Bound) -> str:
    """Return how a map keeps a bound of distortion."""
    return sentence_of(Cause.BOUNDED, **_bound_details(bound))


def _bound_details(bound: Bound) -> dict[str, float]:
    shares = {"share": 100 * bound.share, "percent": 100 * BOUNDED_SHARE}
    return {"most": bound.max_distortion, "largest": bound.largest, **shares}


@dataclass(frozen=True, eq=False)
class Evidence:
    """What a match is judged by."""

    advected: FloatArray  # source carried to tau, (C, V)
    residual: float  # of the discrete flow
    stop_reason: StopReason
    verified: float = math.nan  # residual where flow lines carry the source; NaN if unknown
    # share of the faces, 0 to 1, that the flow's map turns over; NaN if unknown
    folded: float = math.nan
    # (n,), of the last stage's iterates; None counts as still falling
    energies: FloatArray | None = None
    log2_area: float = math.nan  # mean ``|log2 J|`` of the flow's map; NaN if unknown
    refined: int = 0  # how often the mesh was subdivided
    # how far landmarks were and are off, (L,) each, in sqrt(area); None without any
    landmarks: tuple[FloatArray, FloatArray] | None = None
    held_out: float = math.nan  # `PathStep.held_out`; NaN if nothing was held out
    bound: Bound | None = None  # of distortion, within which the field was sought


def is_registered(residual: float, first: float) -> bool:
    """Return whether a residual is clearly below that without motion, and below that of functions
    with nothing in common.
    """
    return residual < min(SHARE_REGISTERED * first, RESIDUAL_REGISTERED)


def judge(functions: FunctionTerm, evidence: Evidence, parameters: Parameters) -> Verdict:
    """Return the verdict of a match: what no flow can do comes first."""
    case = _Case(functions, evidence, parameters)
    rules = (
        case.impossible,
        case.of_landmarks,
        case.registered,
        case.unconfirmed,
        case.by_size,
        case.not_reached,
    )
    return next(verdict for rule in rules if (verdict := rule()) is not None)


class _Case:
    """A match under the rules, each of which gives a verdict or None."""

    def __init__(self, functions: FunctionTerm, evidence: Evidence, parameters: Parameters) -> None:
        self.functions, self.evidence, self.parameters = functions, evidence, parameters
        self.bound = solvability.range_bound(functions)
        self.residual = max(evidence.residual, self.bound)
        self.outcome = outcome_of(worse_residual(self.residual, evidence.verified), parameters.goal)
        self.first = functions.residual(functions.source)
        self.first_of_functions = self.first
        if evidence.landmarks is not None:
            self.first = max(self.first, residual_of_errors(evidence.landmarks[0]))
        self.known = not math.isnan(evidence.verified)
        self.remedies = Remedies(functions, parameters, evidence.refined)

    @cached_property
    def unmatched(self) -> Obstacle | None:
        return differing(self.functions)

    @cached_property
    def is_measured(self) -> bool:
        return solvability.is_measured(self.functions)

    @property
    def gained(self) -> bool:
        """Whether clearly less is left than without motion, and than functions that differ."""
        left = worse_residual(self.evidence.residual, self.evidence.verified)
        return is_registered(left, self.first_of_functions)

    @property
    def is_narrow(self) -> bool:
        return solvability.narrowest(self.functions) < solvability.RESOLUTION_MIN

    @cached_property
    def squeezed(self) -> bool:
        return solvability.squeezed(self.functions, self.evidence.advected)

    def impossible(self) -> Verdict | None:
        """Values that one of the functions lacks, unless both were alike from the start."""
        found = obstacle(self.functions)
        if found is None or (self.evidence.landmarks is not None and self.functions.is_constant):
            return None
        alike = max(self.first, self.evidence.residual) <= self.parameters.goal
        if alike and found.cause is not Cause.BOTH_CONSTANT:
            return None
        return self._verdict(found.outcome, found.cause, **found.details)

    def of_landmarks(self) -> Verdict | None:
        """Landmarks that end farther from their targets than the goal allows."""
        if self.evidence.landmarks is None:
            return None
        goal, errors = self.parameters.goal, self.evidence.landmarks[1]
        outcome = outcome_of(residual_of_errors(errors), goal)
        if outcome is Outcome.MATCHED:
            return None
        if self.evidence.stop_reason.is_interrupted or self._cut_short():
            return self._of_interruption(outcome)
        far = sum(residual_of_errors(errors[[i]]) > goal for i in range(len(errors)))
        helps = (self.remedies.smaller_landmark_sigma(), self.remedies.finer_mesh())
        return self._verdict(
            outcome,
            Cause.LANDMARKS_FAR,
            *(each for each in helps if each),
            far=far,
            count=len(errors),
            limit=f"{100 * goal * MATCHED_ERROR / _USUAL_GOAL:.2g}%",
        )

    def registered(self) -> Verdict | None:
        """Measured functions, which match as closely as the data support."""
        evidence = self.evidence
        is_sound = self.known and self.gained and not evidence.folded > FOLDED_SHARE_MAX
        if self.outcome is Outcome.MATCHED or not is_sound or evidence.stop_reason.is_interrupted:
            return None
        if not self.is_measured or evidence.held_out >= 1:
            return None
        is_chosen = self.parameters.sigma is None
        return self._verdict(Outcome.REGISTERED, Cause.LIMIT_OF_DATA if is_chosen else Cause.NONE)

    def unconfirmed(self) -> Verdict | None:
        """A small residual of the discrete flow that is not one of the flow."""
        verified, folded = self.evidence.verified, self.evidence.folded
        if self.residual > RESIDUAL_NEARLY:
            return None
        if self.outcome is Outcome.NOT_REACHED:
            if self.unmatched:
                return self._of_obstacle()
            cause, more_consistent = Cause.CHECKS_DISAGREE, self._more_consistent()
            return self._verdict(Outcome.NOT_REACHED, cause, *more_consistent, verified=verified)
        if folded > FOLDED_SHARE_MAX and not self.known:
            return self._verdict(
                Outcome.NOT_REACHED, Cause.FOLDED, *self._more_consistent(), folded=share(folded)
            )
        return None

    def by_size(self) -> Verdict | None:
        if self.outcome is Outcome.NOT_REACHED:
            return None
        if self.outcome is Outcome.MATCHED:
            if self.first > self.parameters.goal and not self.known and self.unmatched:
                return self._of_obstacle(Outcome.NEARLY)
            if self.evidence.folded > FOLDED_SHARE_MAX:
                folds = f"{share(self.evidence.folded)} of the faces are folded"
                return self._verdict(
                    Outcome.MATCHED, advice=f"do not trust its point map, where {folds}"
                )
            return self._verdict(Outcome.MATCHED)
        if self.bound > self.parameters.goal:
            missing = missing_values(self.functions)
            return self._verdict(Outcome.NEARLY, missing.cause, **missing.details)
        if self._cut_short():
            return self._of_interruption(Outcome.NEARLY)
        verified = self.evidence.verified
        if self.known and verified > max(self.parameters.goal, self.evidence.residual):
            return self._verdict(Outcome.NEARLY, Cause.LESS_CONFIRMED, *self._more_consistent())
        return self._verdict(Outcome.NEARLY, Cause.NONE, self.remedies.smaller_sigma())

    def not_reached(self) -> Verdict:
        evidence, remedies = self.evidence, self.remedies
        hardly_began = (
            evidence.stop_reason is StopReason.ITERATION_LIMIT
            and self.parameters.solver.iterations < _FALL_ITERATIONS
        )
        if self.squeezed:
            return self._of_squeezed_source()
        if evidence.stop_reason.is_interrupted:
            return self._of_interruption(Outcome.NOT_REACHED)
        if solvability.stood_still(self.functions, evidence.advected) and not hardly_began:
            larger_reach = (remedies.larger_reach(),) if remedies.is_beyond_reach else ()
            helps = (*larger_reach, remedies.much_smaller_sigma())
            return self._verdict(Outcome.NOT_REACHED, Cause.STOOD_STILL, *helps)
        if self.is_measured and not self.gained:
            return self._verdict(Outcome.NOT_REACHED, Cause.LITTLE_GAINED)
        if self.is_measured and evidence.held_out >= 1:
            return self._verdict(Outcome.NOT_REACHED, Cause.NOT_HELD_OUT)
        if self.unmatched:
            return self._of_obstacle()
        if self._cut_short():
            return self._of_interruption(Outcome.NOT_REACHED)
        if evidence.stop_reason is StopReason.LINE_SEARCH_FAILED:
            larger_alpha = remedies.larger_alpha()
            return self._verdict(Outcome.NOT_REACHED, Cause.LINE_SEARCH_FAILED, larger_alpha)
        finer = remedies.finer_mesh() if self.is_narrow else None
        helps = (finer or remedies.smaller_sigma(),)
        return self._verdict(Outcome.NOT_REACHED, Cause.NEEDS_ROUGHER_FIELD, *helps)

    def _verdict(
        self,
        outcome: Outcome,
        cause: Cause = Cause.NONE,
        *remedies: Remedy,
        advice: str = "",
        **details: object,
    ) -> Verdict:
        change, why = self._change(outcome), sentence_of(cause, **details)
        advice = advice or ("" if remedies else ADVICE.get(cause, ""))
        words = [remedy.words for remedy in remedies] + [advice] * bool(advice)
        if self.evidence.stop_reason.is_interrupted:
            remedies = (*remedies, CONTINUE_REMEDY)
            words.append(CONTINUE_REMEDY.words)
        reason = f"{change}: {why}" if why else change
        return Verdict(outcome, reason, "; or ".join(words), remedies, cause)

    def _change(self, outcome: Outcome) -> str:
        """Return how the residual changed, in words."""
        residual = self.evidence.residual
        before, after = f"{self.first:.2g}", f"{residual:.2g}"
        moved = f"{'fell' if residual < self.first else 'rose'} from {before} to"
        change = f"the residual {'stayed at' if before == after else moved} {after}"
        if self.known:
            change += f" ({self.evidence.verified:.2g} by flow lines)"
        if self.evidence.landmarks is not None:
            change = self._with_landmarks(change)
        if outcome is Outcome.REGISTERED and self.evidence.log2_area < _LOG2_AREA_MAX:
            change += f", and areas change by a factor of {factor(self.evidence.log2_area)}"
        return change

    def _with_landmarks(self, change: str) -> str:
        """Add where the landmarks are, or return that alone if landmarks alone are matched."""
        assert self.evidence.landmarks is not None
        first, last = (100 * float(errors.max()) for errors in self.evidence.landmarks)
        count = len(self.evidence.landmarks[0])
        words = f"{count} landmark{'s' * (count > 1)} within {last:.2g}% of sqrt(area)"
        if self.functions.is_constant:
            return f"{words}, {float(f'{first:.2g}'):g}% before"
        return f"{change}, {words}"

    def _of_obstacle(self, outcome: Outcome = Outcome.NOT_REACHED) -> Verdict:
        assert self.unmatched is not None
        return self._verdict(outcome, self.unmatched.cause, **self.unmatched.details)

    def _of_interruption(self, outcome: Outcome) -> Verdict:
        """Going on helps a match whose energy still falls where flow lines fall with it."""
        remedies, evidence = self.remedies, self.evidence
        if evidence.stop_reason.is_interrupted:
            return self._verdict(outcome, _CAUSES[evidence.stop_reason])
        helps = (
            [remedies.larger_reach()] if remedies.is_beyond_reach else [remedies.more_iterations()]
        )
        confirmed = not self.known or evidence.verified <= 2 * max(
            evidence.residual, self.parameters.goal
        )
        if confirmed and not remedies.is_beyond_reach:
            helps.append(CONTINUE_REMEDY)
        iterations = self.parameters.solver.iterations
        return self._verdict(outcome, Cause.STILL_FALLING, *helps, iterations=iterations)

    def _of_squeezed_source(self) -> Verdict:
        """The source shrank where it was: nothing led it to the target, or not long enough."""
        remedies, reason = self.remedies, self.evidence.stop_reason
        vanished = solvability.vanished(self.functions, self.evidence.advected)
        helps: list[Remedy] = []
        why, advice = "", ""
        if remedies.has_small_reach:
            why, helps = ", as nothing led it to the target", [remedies.larger_reach()]
        elif reason in _LIMIT_REASONS:
            early = sentence_of(
                _CAUSES[reason], iterations=self.parameters.solver.iterations
            ).removesuffix(", still falling")
            why, helps = f", and {early}", [remedies.more_iterations()]
        else:
            helps, advice = (
                [remedies.much_smaller_sigma()] if remedies.has_large_sigma else [],
                ADVICE[Cause.SQUEEZED],
            )
        return self._verdict(
            Outcome.NOT_REACHED,
            Cause.SQUEEZED,
            *helps,
            advice=advice,
            to_nothing="to nothing " * vanished,
            why=why,
        )

    def _cut_short(self) -> bool:
        """Return whether it ended while the energy still fell, and not by squeezing the source."""
        energies, reason = self.evidence.energies, self.evidence.stop_reason
        if reason not in _LIMIT_REASONS or self.squeezed:
            return False
        if reason.is_interrupted or energies is None or len(energies) <= _FALL_ITERATIONS:
            return True
        return bool(energies[-1] < (1 - _FALL_SHARE) * energies[-1 - _FALL_ITERATIONS])

    def _more_consistent(self) -> list[Remedy]:
        """Return what makes flow lines confirm a match. None of it undoes another: a mesh only gets
        finer, a field smoother up to the default, sigma smaller.
        """
        return [
            found
            for found in (self.remedies.more_consistent(), self.remedies.finer_mesh())
            if found
        ]


_CAUSES = {
    StopReason.CANCELLED: Cause.CANCELLED,
    StopReason.OUT_OF_MEMORY: Cause.OUT_OF_MEMORY,
    StopReason.ITERATION_LIMIT: Cause.STILL_FALLING,
}
