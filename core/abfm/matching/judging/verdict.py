"""The verdict of a match: outcome, cause, reason and advice."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from abfm.maps.distortion import BOUNDED_SHARE, Bound
from abfm.matching import solvability
from abfm.matching.judging.cause import ADVICE, Cause, limit_sentence, sentence_of
from abfm.matching.judging.obstacles import Obstacle, differing, missing_values, obstacle
from abfm.matching.judging.remedies import CONTINUE_REMEDY, Remedies, Remedy
from abfm.matching.solving.record import StopReason
from abfm.matching.terms.functions import FunctionTerm
from abfm.matching.terms.landmarks import MATCHED_ERROR, residual_of_errors
from abfm.outcome import RESIDUAL_NEARLY, VERDICTS, Outcome, outcome_of, worse_residual
from abfm.parameters import Parameters
from abfm.types import FloatArray
from abfm.wording import factor, farthest_of, share

RESIDUAL_REGISTERED = 0.95
"""Largest residual with the verdict "registered". Unrelated functions have a residual of 1."""
SHARE_REGISTERED = 0.8
"""Largest residual with the verdict "registered", relative to the residual without motion.

For two surfaces, the residual without motion is that of the initial map."""
_LOG2_AREA_MAX = 100.0  # larger changes of area are not reported
# a map with a larger share of folded faces is unreliable; an exact flow folds no face
FOLDED_SHARE_MAX = 0.1
# an energy that fell by this share within this number of iterations is still falling
_FALL_SHARE = 0.01
_FALL_ITERATIONS = 10
_LIMIT_REASONS = (StopReason.ITERATION_LIMIT, StopReason.CANCELLED, StopReason.OUT_OF_MEMORY)
_USUAL_GOAL = Parameters().goal


@dataclass(frozen=True)
class Verdict:
    """The outcome of a match, with its cause and advice.

    Attributes
    ----------
    kind : Outcome
        Outcome of the match, one of ``abfm.outcome.VERDICTS``.
    reason : str
        The first and the last residual and, after a colon, their interpretation. One line without a
        full stop.
    advice : str
        Suggestion for a better match, in one line without a full stop; empty if nothing is needed.
    remedies : tuple of Remedy
        The advice as changes of parameters, the best one first.
    cause : Cause
    """

    kind: Outcome
    reason: str
    advice: str
    remedies: tuple[Remedy, ...] = ()
    cause: Cause = Cause.NONE

    @property
    def why(self) -> str:
        """The interpretation of the residuals (the reason after its colon), or an empty string."""
        return self.reason.partition(": ")[2]

    @property
    def topic(self) -> str:
        """Section of ``abfm.explanations`` on the cause or, without a cause, on the outcome."""
        return str(self.kind if self.cause is Cause.NONE else self.cause)

    @property
    def change(self) -> str:
        """The part of the reason with the first and the last residual (before its colon)."""
        return self.reason.partition(": ")[0]

    @property
    def texts(self) -> tuple[str, str, str, str]:
        """Outcome, cause, reason and advice, as stored in files."""
        return self.kind, self.cause, self.reason, self.advice

    @classmethod
    def of_texts(cls, texts: Sequence[str], remedies: tuple[Remedy, ...] = ()) -> "Verdict":
        """Return the verdict of stored `texts`; ValueError if the outcome or cause is unknown."""
        kind, cause, reason, advice = texts
        if kind not in VERDICTS:
            expected = ", ".join(VERDICTS)
            raise ValueError(f"the verdict is {kind[:40]!r}; expected one of {expected}")
        if cause not in tuple(Cause):
            raise ValueError(f"the cause of the verdict, {cause[:40]!r}, is unknown")
        return cls(Outcome(kind), reason, advice, remedies, Cause(cause))

    def with_cause(self, kind: Outcome, cause: Cause, **details: object) -> "Verdict":
        """Return a verdict with the same residuals but another outcome and cause.

        ``details`` are the values of the placeholders in the sentence of the cause.
        """
        reason = f"{self.change}: {sentence_of(cause, **details)}"
        return Verdict(kind, reason, ADVICE.get(cause, ""), (), cause)

    def for_step(self, sigma: float) -> "Verdict":
        """Return the verdict for one step of the continuation; its reason states ``sigma``.

        Advice and the reason why the match stopped refer to its last step, and are omitted. The
        outcomes ``matched`` and ``impossible`` keep their verdict.
        """
        if self.kind in (Outcome.MATCHED, Outcome.IMPOSSIBLE):
            return self
        return self.with_cause(self.kind, Cause.SELECTED_STEP, sigma=sigma)

    def with_bound(self, bound: Bound) -> "Verdict":
        """Return the verdict of a match whose distortion was limited by a bound.

        If the map satisfies the bound, the bound is the cause. The outcomes ``matched`` and
        ``impossible`` keep their verdict.
        """
        if self.kind in (Outcome.MATCHED, Outcome.IMPOSSIBLE) or not bound.is_satisfied:
            return self
        return self.with_cause(self.kind, Cause.DISTORTION_LIMITED, **_bound_details(bound))


def sentence_of_bound(bound: Bound) -> str:
    """Return the sentence with a bound of distortion and the share of faces within it."""
    return sentence_of(Cause.DISTORTION_LIMITED, **_bound_details(bound))


def _bound_details(bound: Bound) -> dict[str, float]:
    shares = {"share": 100 * bound.share, "percent": 100 * BOUNDED_SHARE}
    return {"most": bound.max_distortion, "largest": bound.largest, **shares}


@dataclass(frozen=True, eq=False)
class Evidence:
    """The measurements from which `judge` decides the verdict."""

    advected: FloatArray  # the source at tau, (C, V)
    residual: float  # residual of the discrete flow
    stop_reason: StopReason
    verified: float = math.nan  # residual along flow lines; NaN if unknown
    folded: float = math.nan  # share of folded faces in the map of the flow, 0 to 1; NaN if unknown
    # energies of the iterates for the last sigma, (n,); if None, the energy counts as falling
    energies: FloatArray | None = None
    log2_area: float = math.nan  # mean ``|log2 J|`` of the map; NaN if unknown
    refined: int = 0  # number of subdivisions of the mesh
    # initial and final errors of the landmarks, (L,) each, in sqrt(area); None without landmarks
    landmarks: tuple[FloatArray, FloatArray] | None = None
    held_out: float = math.nan  # see `PathStep.held_out`
    bound: Bound | None = None  # None without a bound


def is_registered(residual: float, first: float) -> bool:
    """Return whether a residual is small enough compared with ``first``, that without motion."""
    return residual < min(SHARE_REGISTERED * first, RESIDUAL_REGISTERED)


def judge(functions: FunctionTerm, evidence: Evidence, parameters: Parameters) -> Verdict:
    """Return the verdict of a match: that of the first rule of `_Case` that applies."""
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
    """The rules of verdicts for one match; a rule that does not apply returns None."""

    def __init__(self, functions: FunctionTerm, evidence: Evidence, parameters: Parameters) -> None:
        self.functions, self.evidence, self.parameters = functions, evidence, parameters
        self.bound = solvability.range_bound(functions)
        self.residual = max(evidence.residual, self.bound)
        self.outcome = outcome_of(worse_residual(self.residual, evidence.verified), parameters.goal)
        self.first = functions.residual(functions.source)
        self.initial_of_functions = self.first
        if evidence.landmarks is not None:
            self.first = max(self.first, residual_of_errors(evidence.landmarks[0]))
        self.is_verified = not math.isnan(evidence.verified)
        self.remedies = Remedies(functions, parameters, evidence.refined)

    @cached_property
    def different_features(self) -> Obstacle | None:
        return differing(self.functions)

    @cached_property
    def is_measured(self) -> bool:
        return solvability.is_measured(self.functions)

    @property
    def has_improved(self) -> bool:
        worse = worse_residual(self.evidence.residual, self.evidence.verified)
        return is_registered(worse, self.initial_of_functions)

    @property
    def is_narrow(self) -> bool:
        return solvability.narrowest(self.functions) < solvability.RESOLUTION_MIN

    @cached_property
    def squeezed(self) -> bool:
        return solvability.squeezed(self.functions, self.evidence.advected)

    def impossible(self) -> Verdict | None:
        """Return the verdict impossible if no flow can match the functions; None otherwise.

        None also if the functions already agree within the goal, or if only landmarks are matched.
        """
        found = obstacle(self.functions)
        if found is None or (self.evidence.landmarks is not None and self.functions.is_constant):
            return None
        agree = max(self.first, self.evidence.residual) <= self.parameters.goal
        if agree and found.cause is not Cause.BOTH_CONSTANT:
            return None
        return self._verdict(found.outcome, found.cause, **found.details)

    def of_landmarks(self) -> Verdict | None:
        """Return a verdict if landmarks miss their targets by more than the goal; else None."""
        if self.evidence.landmarks is None:
            return None
        goal, errors = self.parameters.goal, self.evidence.landmarks[1]
        outcome = outcome_of(residual_of_errors(errors), goal)
        if outcome is Outcome.MATCHED:
            return None
        if self.evidence.stop_reason.is_interrupted or self._is_cut_short():
            return self._of_interruption(outcome)
        missed = sum(residual_of_errors(errors[[i]]) > goal for i in range(len(errors)))
        suggestions = (self.remedies.smaller_landmark_sigma(), self.remedies.finer_mesh())
        return self._verdict(
            outcome,
            Cause.LANDMARKS_NOT_REACHED,
            *(each for each in suggestions if each),
            missed=missed,
            count=len(errors),
            limit=f"{100 * goal * MATCHED_ERROR / _USUAL_GOAL:.2g}%",
        )

    def registered(self) -> Verdict | None:
        """Return the verdict registered if measured functions match as closely as the data allow.

        None for other functions, interrupted runs, large residuals, and matches within the goal.
        """
        evidence = self.evidence
        is_sound = self.is_verified and self.has_improved and not evidence.folded > FOLDED_SHARE_MAX
        if self.outcome is Outcome.MATCHED or not is_sound or evidence.stop_reason.is_interrupted:
            return None
        if not self.is_measured or evidence.held_out >= 1:
            return None
        is_chosen = self.parameters.sigma is None
        return self._verdict(Outcome.REGISTERED, Cause.LIMIT_OF_DATA if is_chosen else Cause.NONE)

    def unconfirmed(self) -> Verdict | None:
        """Return the verdict not reached if only the residual of the discrete flow is small.

        The residual along flow lines is then large. If it is unknown, a large share of folded faces
        has the same effect. Otherwise return None.
        """
        folded = self.evidence.folded
        if self.residual > RESIDUAL_NEARLY:
            return None
        if self.outcome is Outcome.NOT_REACHED:
            if self.different_features:
                return self._of_obstacle()
            cause, more_consistent = Cause.CHECKS_DISAGREE, self._more_consistent()
            return self._verdict(Outcome.NOT_REACHED, cause, *more_consistent)
        if folded > FOLDED_SHARE_MAX and not self.is_verified:
            return self._verdict(
                Outcome.NOT_REACHED, Cause.FOLDED, *self._more_consistent(), folded=share(folded)
            )
        return None

    def by_size(self) -> Verdict | None:
        """Return the verdict matched or nearly matched if the residual is small; else None.

        If flow lines are unknown, functions whose peaks or pits differ are at most nearly matched.
        """
        if self.outcome is Outcome.NOT_REACHED:
            return None
        if self.outcome is Outcome.MATCHED:
            is_unverified = self.first > self.parameters.goal and not self.is_verified
            if is_unverified and self.different_features:
                return self._of_obstacle(Outcome.NEARLY)
            advice = ""
            if self.evidence.folded > FOLDED_SHARE_MAX:
                folds = f"{share(self.evidence.folded)} of the faces are folded"
                advice = f"do not rely on the point map, as {folds}"
            return self._verdict(Outcome.MATCHED, advice=advice)
        if self.bound > self.parameters.goal:
            missing = missing_values(self.functions)
            return self._verdict(Outcome.NEARLY, missing.cause, **missing.details)
        if self._is_cut_short():
            return self._of_interruption(Outcome.NEARLY)
        verified = self.evidence.verified
        if self.is_verified and verified > max(self.parameters.goal, self.evidence.residual):
            less_smooth = self.remedies.smaller_alpha()
            suggestions = self._more_consistent() or ([less_smooth] if less_smooth else [])
            return self._verdict(Outcome.NEARLY, Cause.PARTLY_CONFIRMED, *suggestions)
        closer = self._closer(self.remedies.smaller_sigma())
        return self._verdict(Outcome.NEARLY, Cause.NONE, *closer)

    def not_reached(self) -> Verdict:
        evidence, remedies = self.evidence, self.remedies
        is_limit = evidence.stop_reason is StopReason.ITERATION_LIMIT
        hardly_began = is_limit and self.parameters.solver.iterations < _FALL_ITERATIONS
        if self.squeezed:
            return self._of_squeezed_source()
        if evidence.stop_reason.is_interrupted:
            return self._of_interruption(Outcome.NOT_REACHED)
        if solvability.hardly_moved(self.functions, evidence.advected) and not hardly_began:
            larger_reach = (remedies.larger_reach(),) if remedies.is_beyond_reach else ()
            suggestions = (*larger_reach, *self._closer(remedies.much_smaller_sigma()))
            return self._verdict(Outcome.NOT_REACHED, Cause.SOURCE_UNMOVED, *suggestions)
        if self.is_measured and not self.has_improved:
            return self._verdict(Outcome.NOT_REACHED, Cause.LITTLE_IMPROVEMENT)
        if self.is_measured and evidence.held_out >= 1:
            return self._verdict(Outcome.NOT_REACHED, Cause.NO_HELD_OUT_IMPROVEMENT)
        if self.different_features:
            return self._of_obstacle()
        if self._is_cut_short():
            return self._of_interruption(Outcome.NOT_REACHED)
        if evidence.stop_reason is StopReason.LINE_SEARCH_FAILED:
            larger_alpha = remedies.larger_alpha()
            return self._verdict(Outcome.NOT_REACHED, Cause.LINE_SEARCH_FAILED, larger_alpha)
        finer = remedies.finer_mesh() if self.is_narrow else None
        suggestions = (remedies.smaller_alpha() or finer or remedies.smaller_sigma(),)
        return self._verdict(Outcome.NOT_REACHED, Cause.NEEDS_ROUGHER_FIELD, *suggestions)

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
        """Return the change of the residual as a phrase: ``the residual fell from 100% to 2%``."""
        residual = self.evidence.residual
        before, after = share(self.first), share(residual)
        moved = f"{'fell' if residual < self.first else 'rose'} from {before} to"
        change = f"the residual {'stayed at' if before == after else moved} {after}"
        if self.is_verified:
            change += f" ({share(self.evidence.verified)} along flow lines)"
        if self.evidence.landmarks is not None:
            change = self._with_landmarks(change)
        if outcome is Outcome.REGISTERED and self.evidence.log2_area < _LOG2_AREA_MAX:
            change += f", and areas change by a factor of {factor(self.evidence.log2_area)}"
        return change

    def _with_landmarks(self, change: str) -> str:
        """Return ``change`` with landmark errors, or only these if no functions are matched."""
        assert self.evidence.landmarks is not None
        first, last = (100 * float(errors.max()) for errors in self.evidence.landmarks)
        farthest = farthest_of(len(self.evidence.landmarks[0]), "landmark")
        words = f"the {farthest} is {last:.2g}% of sqrt(area) from its target"
        if self.functions.is_constant:
            return f"{words}, {float(f'{first:.2g}'):g}% before"
        return f"{change}, {words}"

    def _of_obstacle(self, outcome: Outcome = Outcome.NOT_REACHED) -> Verdict:
        found = self.different_features
        assert found is not None
        return self._verdict(outcome, found.cause, **found.details)

    def _of_interruption(self, outcome: Outcome) -> Verdict:
        """Return the verdict of a match that was interrupted or reached its limit of iterations.

        At the limit, more iterations are advised, or a larger reach if the target lies beyond it.
        The advice to continue from the field requires that flow lines confirm its progress.
        """
        remedies, evidence = self.remedies, self.evidence
        if evidence.stop_reason.is_interrupted:
            return self._verdict(outcome, _CAUSES[evidence.stop_reason])
        confirmed_max = 2 * max(evidence.residual, self.parameters.goal)
        if remedies.is_beyond_reach:
            suggestions = [remedies.larger_reach()]
        else:
            suggestions = [remedies.more_iterations()]
            if not (self.is_verified and evidence.verified > confirmed_max):
                suggestions.append(CONTINUE_REMEDY)
        limit = limit_sentence(self.parameters.solver.iterations)
        return self._verdict(outcome, Cause.ITERATION_LIMIT, *suggestions, limit=limit)

    def _of_squeezed_source(self) -> Verdict:
        """Return the verdict not reached for a flow that shrank the source instead of moving it."""
        remedies, reason = self.remedies, self.evidence.stop_reason
        vanished = solvability.vanished(self.functions, self.evidence.advected)
        suggestions: list[Remedy] = []
        why, advice = "", ""
        if remedies.has_small_reach:
            why, suggestions = ", as the reach is too small", [remedies.larger_reach()]
        elif reason in _LIMIT_REASONS:
            is_limit = reason is StopReason.ITERATION_LIMIT
            limit = limit_sentence(self.parameters.solver.iterations)
            early = limit if is_limit else sentence_of(_CAUSES[reason])
            why, suggestions = f", and {early}", [remedies.more_iterations()]
        else:
            suggestions = [remedies.much_smaller_sigma()] if remedies.has_large_sigma else []
            advice = ADVICE[Cause.SOURCE_SQUEEZED]
        return self._verdict(
            Outcome.NOT_REACHED,
            Cause.SOURCE_SQUEEZED,
            *suggestions,
            advice=advice,
            to_nothing="to nothing " * vanished,
            why=why,
        )

    def _closer(self, smaller_sigma: Remedy) -> list[Remedy]:
        """Return the remedy of a smaller alpha or, if alpha is not large, that of a smaller sigma.

        Empty if held-out patches have chosen sigma, because a smaller one would fit noise.
        """
        if less_smooth := self.remedies.smaller_alpha():
            return [less_smooth]
        return [] if self.is_measured and self.parameters.sigma is None else [smaller_sigma]

    def _is_cut_short(self) -> bool:
        """Return whether the run was interrupted, or reached its limit while its energy still fell.

        False if the source was squeezed, because more iterations would not help.
        """
        energies, reason = self.evidence.energies, self.evidence.stop_reason
        if reason not in _LIMIT_REASONS or self.squeezed:
            return False
        if reason.is_interrupted or energies is None or len(energies) <= _FALL_ITERATIONS:
            return True
        return bool(energies[-1] < (1 - _FALL_SHARE) * energies[-1 - _FALL_ITERATIONS])

    def _more_consistent(self) -> list[Remedy]:
        """Return remedies that are likely to make flow lines confirm the match.

        Each makes the mesh finer, the field smoother (up to the default), or sigma smaller.
        Remedies that are applied one after the other do not undo each other.
        """
        suggestions = (self.remedies.more_consistent(), self.remedies.finer_mesh())
        return [each for each in suggestions if each]


_CAUSES = {
    StopReason.CANCELLED: Cause.CANCELLED,
    StopReason.OUT_OF_MEMORY: Cause.OUT_OF_MEMORY,
    StopReason.ITERATION_LIMIT: Cause.ITERATION_LIMIT,
}
