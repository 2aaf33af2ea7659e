"""What a match came to, why, and what to try, in plain words and as changes of its parameters."""

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

from abfm.matching import solvability
from abfm.matching.solvability import Counted, range_bound
from abfm.matching.solving.course import NEARLY
from abfm.matching.solving.record import StopReason
from abfm.matching.terms.functions import CONSTANT, FunctionTerm
from abfm.matching.terms.landmarks import NEAR, mismatch_of
from abfm.parameters import FORMER, LARGEST_ALPHA, MANY, MOST_REFINED, SMALLEST, Parameters
from abfm.types import FloatArray

Kind = Literal["matched", "nearly", "registered", "not reached", "impossible"]

_GAINED = 0.03  # of the first mismatch: less is no registration
_GAINED_OF_UNLIKE = 0.1  # the same where as much is left as the functions themselves are
_MOST_LOG2 = 100.0  # of a change of areas that is told
FOLDED = 0.1  # share of the faces beyond which a map is not to be trusted; an exact flow folds none
# an energy still falls that has fallen by this share within so many iterations
_RECENT, _FALLING = 10, 0.01
_EARLY = (StopReason.ITERATION_LIMIT, StopReason.CANCELLED, StopReason.OUT_OF_MEMORY)
_SCALE = "scale or clip one of the functions"

_USUAL = Parameters()
_FURTHER = 3.0  # how much larger or smaller a parameter is advised
_COLDER = 10.0  # the same of sigma where the source did not go to the target at all
_LONGER = 4  # how many times as many iterations
# what a search for a far target needs besides a reach, as by default
_COURSE = (
    "order",
    "levels",
    "sigma",
    "sigma_unit",
    "cooling_stages",
    "cooling_factor",
    "stage_iterations",
)


def confirmed_mismatch(mismatch: float, verified: float) -> float:
    """Return what is left by the worse witness, discrete flow or flow lines (NaN if unknown)."""
    return mismatch if math.isnan(verified) else max(mismatch, verified)


def kind_of(confirmed: float, goal: float = Parameters.goal) -> Kind:
    """Return what a mismatch is called by its size alone: the larger it is, the worse the word."""
    if confirmed <= goal:
        return "matched"
    return "nearly" if confirmed <= max(NEARLY, goal) else "not reached"


@dataclass(frozen=True)
class Remedy:
    """A run that is likely to come closer.

    Its ``words`` are the ``label`` as advice, its ``parameters`` those that change, checked; if it
    ``goes_on`` it starts from the field of the match, not from none.
    """

    label: str
    words: str
    parameters: dict[str, Any] = field(default_factory=dict)
    goes_on: bool = False

    def __post_init__(self) -> None:
        Parameters.from_dict(_USUAL.to_dict() | self.parameters)
        kept = {name: value for name, value in self.parameters.items() if name not in FORMER}
        object.__setattr__(self, "parameters", kept)  # of a file of before


GO_ON = Remedy("Continue", "go on from this field", {}, True)


@dataclass(frozen=True)
class Verdict:
    """What a match came to; reason and advice are one line each, without a full stop."""

    # registered: measured functions, as close as they bear; impossible: no flow would do; not
    # reached: not by this flow, which may still be worth having
    kind: Kind
    reason: str  # the first and the last mismatch, and what they mean after a colon
    advice: str  # what to try, empty where nothing is needed
    # the same as parameters, as far as they can do it, best first
    remedies: tuple[Remedy, ...] = ()

    @property
    def cause(self) -> str:
        """What the mismatches mean; empty where they speak for themselves."""
        return self.reason.partition(": ")[2]

    def of_a_step(self, sigma: float) -> "Verdict":
        """Return it for a step of a path: why the whole ended, and what helps it, is not told."""
        if self.kind in ("matched", "impossible"):
            return self
        change = self.reason.partition(": ")[0]
        return Verdict(self.kind, f"{change}: a step of the path, with sigma {sigma:.3g}", "")


@dataclass(frozen=True, eq=False)
class Outcome:
    advected: FloatArray  # source carried to tau, (C, V)
    mismatch: float  # ``||f_tau - g|| / ||g||`` of the discrete flow
    stop_reason: StopReason
    verified: float = math.nan  # mismatch where flow lines carry the source; NaN if unknown
    # share of the faces, 0 to 1, that the flow's map turns over; NaN if unknown
    folded: float = math.nan
    # (n,), of the last stage's iterates; None counts as still falling
    energies: FloatArray | None = None
    log2_area: float = math.nan  # mean ``|log2 J|`` of the flow's map; NaN if unknown
    refined: int = 0  # how often the mesh was subdivided
    # how far landmarks were and are off, (L,) each, in sqrt(area); None without any
    landmarks: tuple[FloatArray, FloatArray] | None = None


def advice(functions: FunctionTerm, outcome: Outcome, parameters: Parameters) -> Verdict:
    """Say what a match came to, why, and what to do: what no flow can do comes first."""
    case = _Case(functions, outcome, parameters)
    rules = (
        case.impossible,
        case.of_landmarks,
        case.registered,
        case.unconfirmed,
        case.by_size,
        case.not_reached,
    )
    return next(verdict for rule in rules if (verdict := rule()) is not None)


class Remedies:
    """Makes remedies of a match: numbers start from the parameters it had, and the last sigma."""

    def __init__(self, functions: FunctionTerm, parameters: Parameters, refined: int = 0) -> None:
        self._functions, self._parameters = functions, parameters
        self._refined, self._sigma = refined, parameters.last_sigma
        # larger than by default, so that a match is worth little
        relative = parameters.sigma_unit == "relative"
        self.is_warm = relative and parameters.last_sigma > _USUAL.last_sigma

    @property
    def too_far(self) -> bool:
        """Whether the target is farther, straight through space, than the stages reach."""
        return self._parameters.reach < solvability.distance(self._functions)

    @property
    def looks_near(self) -> bool:
        """Whether they reach less far than by default; on the surface it may be farther."""
        return self.too_far or self._parameters.reach < _USUAL.reach

    def more_time(self) -> Remedy:
        """More iterations; those of the defaults at least, as a match ends by itself."""
        count = min(max(_LONGER * self._parameters.iterations, _USUAL.iterations), MANY)
        return Remedy("More time", f"more iterations, such as {count}", {"iterations": count})

    def further(self) -> Remedy:
        p = self._parameters
        needed = _rounded(max(solvability.distance(self._functions), _USUAL.reach))
        wanted = {name: getattr(_USUAL, name) for name in _COURSE} if not p.reach else {}
        if p.sigma_unit == "relative" and p.last_sigma < _USUAL.last_sigma:
            wanted.pop("sigma", None)  # which would undo a closer match
        changed = self._changes(
            wanted | {"reach": needed, "iterations": max(p.iterations, _USUAL.iterations)}
        )
        course = " and the course of the defaults" if len(changed) > 2 else ""
        words = f"a larger reach, such as {needed:g} of sqrt(area){course}"
        return Remedy("Reach further", words, changed)

    def truer(self) -> Remedy | None:
        """Return what makes flow lines confirm more: what strays goes back to the defaults."""
        p = self._parameters
        if self.too_far:
            return self.further()
        if p.order == 1 or p.alpha < _USUAL.alpha:
            alpha = max(p.alpha, _USUAL.alpha)
            changed = self._changes({"order": _USUAL.order, "alpha": alpha})
            values = " and ".join(f"{name} {value:g}" for name, value in changed.items())
            return Remedy("Smoother", f"a smoother field, by {values}", changed)
        return self.colder() if self.is_warm else None

    def refine(self) -> Remedy | None:
        """Return a finer mesh, unless it is as fine as it may be, or the course has none."""
        finer, p = self._refined + 1, self._parameters
        is_fixed = not p.reach or p.stage_iterations
        if finer > MOST_REFINED or is_fixed or p.method == "linearised":
            return None
        return Remedy("Refine", "a finer mesh, from this field", {"refine": finer}, True)

    def smoother(self) -> Remedy:
        """A larger alpha, from no motion: near the present field there is no smoother one."""
        alpha = min(_rounded(_FURTHER * self._parameters.alpha or _USUAL.alpha), LARGEST_ALPHA)
        return Remedy("Smoother", f"a larger alpha, such as {alpha:g}", {"alpha": alpha})

    def closer(self) -> Remedy:
        sigma = max(_rounded(self._sigma / _FURTHER), SMALLEST)
        return Remedy("Match closer", f"a smaller sigma, such as {sigma:g}", {"sigma": sigma}, True)

    def closer_landmarks(self) -> Remedy:
        sigma = max(_rounded(self._parameters.landmark_sigma / _FURTHER), SMALLEST)
        words = f"a smaller landmark_sigma, such as {sigma:g}"
        return Remedy("Landmarks closer", words, {"landmark_sigma": sigma}, True)

    def colder(self) -> Remedy:
        least = _USUAL.last_sigma if self.is_warm else SMALLEST
        sigma = max(_rounded(self._sigma / _COLDER), least)
        return Remedy("Match closer", f"a smaller sigma, such as {sigma:g}", {"sigma": sigma})

    def _changes(self, wanted: dict[str, Any]) -> dict[str, Any]:
        p = self._parameters
        return {name: value for name, value in wanted.items() if value != getattr(p, name)}


def _rounded(value: float) -> float:
    return float(f"{value:.2g}")


class _Case:
    """A match under the rules, each of which gives a verdict or None."""

    def __init__(self, functions: FunctionTerm, outcome: Outcome, parameters: Parameters) -> None:
        self.functions, self.outcome, self.parameters = functions, outcome, parameters
        self.bound = range_bound(functions)
        self.true_mismatch = max(outcome.mismatch, self.bound)
        left = confirmed_mismatch(self.true_mismatch, outcome.verified)
        self.by_size_alone = kind_of(left, parameters.goal)
        self.first = functions.relative_mismatch(functions.source)
        self.first_of_functions = self.first
        if outcome.landmarks is not None:
            self.first = max(self.first, mismatch_of(outcome.landmarks[0]))
        self.known = not math.isnan(outcome.verified)
        self.remedies = Remedies(functions, parameters, outcome.refined)
        self.folds = f"{100 * outcome.folded:.0f}% of the faces are folded"

    @cached_property
    def unmatched(self) -> tuple[int, Counted, Counted] | None:
        return solvability.unmatched(self.functions)

    @property
    def is_narrow(self) -> bool:
        return solvability.narrowest(self.functions) < solvability.RESOLVED

    @cached_property
    def squeezed(self) -> bool:
        return solvability.squeezed(self.functions, self.outcome.advected)

    def impossible(self) -> Verdict | None:
        """Values that the source lacks, or cannot lose, unless both were alike from the start."""
        if max(self.first, self.outcome.mismatch) <= self.parameters.goal:
            return None
        flat = solvability.source_is_constant(self.functions)
        to_flat = solvability.target_is_constant(self.functions)
        if flat and not to_flat:
            why = "the source is constant, and no flow changes that"
            return self._verdict("impossible", why, "take a source that has the target's values")
        if to_flat and not flat:
            why = (
                "the target is constant and the source is not, and a flow keeps every value of "
                "the source"
            )
            advised = "take a target that has the source's values in other places"
            return self._verdict("impossible", why, advised)
        if self.bound > NEARLY:
            return self._verdict("impossible", self._missing_values(), _SCALE)
        return None

    def of_landmarks(self) -> Verdict | None:
        """Landmarks that are left farther off than the goal has it."""
        if self.outcome.landmarks is None:
            return None
        goal, errors = self.parameters.goal, self.outcome.landmarks[1]
        kind = kind_of(mismatch_of(errors), goal)
        if kind == "matched":
            return None
        if self.outcome.stop_reason.is_early or self._cut_short():
            return self._of_an_early_end(kind)
        far = sum(mismatch_of(errors[[i]]) > goal for i in range(len(errors)))
        why = (
            f"{far} of {len(errors)} landmarks {'is' if far == 1 else 'are'} left farther than "
            f"{100 * goal * NEAR / _USUAL.goal:.2g}%"
        )
        helps = (self.remedies.closer_landmarks(), self.remedies.refine())
        return self._verdict(kind, why, "", *(each for each in helps if each))

    def registered(self) -> Verdict | None:
        """Measured functions, which match as far as they are alike."""
        outcome = self.outcome
        left = max(outcome.mismatch, outcome.verified)
        least = _GAINED if left < 1 else _GAINED_OF_UNLIKE
        gained = left < (1 - least) * self.first_of_functions
        is_sound = self.known and gained and not outcome.folded > FOLDED
        if self.by_size_alone == "matched" or not is_sound or outcome.stop_reason.is_early:
            return None
        if not solvability.is_measured(self.functions):
            return None
        kept = "a closer match would not hold where it was not fitted"
        return self._verdict("registered", kept * (self.parameters.sigma is None), "")

    def unconfirmed(self) -> Verdict | None:
        """A small mismatch of the discrete flow that is not one of the flow."""
        verified, folded = self.outcome.verified, self.outcome.folded
        if self.true_mismatch > NEARLY:
            return None
        if self.by_size_alone == "not reached":
            if self.unmatched:
                return self._of_what_stays()
            lines = f"by flow lines the mismatch is {verified:.2g}"
            why = f"{lines}, so the discrete flow is not one here"
            return self._verdict("not reached", why, "", *self._truer())
        if folded > FOLDED and not self.known:
            why = f"{self.folds}, which no flow does"
            return self._verdict("not reached", why, "", *self._truer())
        return None

    def by_size(self) -> Verdict | None:
        if self.by_size_alone == "not reached":
            return None
        if self.by_size_alone == "matched":
            if self.first > self.parameters.goal and not self.known and self.unmatched:
                return self._of_what_stays("nearly")
            if self.functions.is_constant and self.outcome.landmarks is None:
                why = f"both are constant, up to {CONSTANT:g} of their values"
                return self._verdict("matched", why, "")
            advised = f"do not trust its point map, where {self.folds}"
            return self._verdict("matched", "", advised * (self.outcome.folded > FOLDED))
        if self.bound > self.parameters.goal:
            return self._verdict("nearly", self._missing_values(), _SCALE)
        if self._cut_short():
            return self._of_an_early_end("nearly")
        if self.known and self.outcome.verified > max(self.parameters.goal, self.outcome.mismatch):
            why = "the flow lines confirm less than the discrete flow shows"
            return self._verdict("nearly", why, "", *self._truer())
        return self._verdict("nearly", "", "", self.remedies.closer())

    def not_reached(self) -> Verdict:
        outcome, remedies = self.outcome, self.remedies
        hardly_began = (
            outcome.stop_reason is StopReason.ITERATION_LIMIT
            and self.parameters.iterations < _RECENT
        )
        if self.squeezed:
            return self._of_squeezing()
        if outcome.stop_reason.is_early:
            return self._of_an_early_end("not reached")
        if solvability.stood_still(self.functions, outcome.advected) and not hardly_began:
            why = "the source hardly moved, as moving costs more smoothness than it gains"
            further = (remedies.further(),) if remedies.too_far else ()
            return self._verdict("not reached", why, "", *further, remedies.colder())
        if self.unmatched:
            return self._of_what_stays()
        if self._cut_short():
            return self._of_an_early_end("not reached")
        if outcome.stop_reason is StopReason.LINE_SEARCH_FAILED:
            why = "no step lowers the energy any more, which is often rounding"
            return self._verdict("not reached", why, "", remedies.smoother())
        why = "what is left differs, or would cost more smoothness than it gains"
        finer = remedies.refine() if self.is_narrow else None
        return self._verdict("not reached", why, "", finer or remedies.closer())

    def _verdict(self, kind: Kind, why: str, advised: str, *remedies: Remedy) -> Verdict:
        before, after = f"{self.first:.2g}", f"{self.outcome.mismatch:.2g}"
        moved = f"{'fell' if self.outcome.mismatch < self.first else 'rose'} from {before} to"
        change = f"the mismatch {'stayed at' if before == after else moved} {after}"
        if self.known:
            change += f" ({self.outcome.verified:.2g} by flow lines)"
        if self.outcome.landmarks is not None:
            change = self._of_how_far(change)
        if kind == "registered" and self.outcome.log2_area < _MOST_LOG2:
            areas = 100 * (2**self.outcome.log2_area - 1)
            change += f", and areas change by {areas:.0f}% on average"
        words = [remedy.words for remedy in remedies] + [advised] * bool(advised)
        if self.outcome.stop_reason.is_early:
            remedies = (*remedies, GO_ON)
            words.append(GO_ON.words)
        return Verdict(kind, f"{change}: {why}" if why else change, "; or ".join(words), remedies)

    def _of_how_far(self, change: str) -> str:
        """Add where the landmarks are to what changed, or tell that alone if they are alone."""
        assert self.outcome.landmarks is not None
        first, last = (100 * float(errors.max()) for errors in self.outcome.landmarks)
        count = len(self.outcome.landmarks[0])
        words = f"{count} landmark{'s' * (count > 1)} within {last:.2g}% of sqrt(area)"
        if self.functions.is_constant:
            return f"{words}, {float(f'{first:.2g}'):g}% before"
        return f"{change}, {words}"

    def _of_what_stays(self, kind: Kind = "not reached") -> Verdict:
        assert self.unmatched is not None
        channel, here, there = self.unmatched
        why = f"{self._of(channel)}the source has {here}, the target {there}; no flow changes that"
        advised = "smooth the functions, refine the mesh, or expect a match in part"
        return self._verdict(kind, why, advised)

    def _of_an_early_end(self, kind: Kind) -> Verdict:
        """Going on helps a match whose energy still falls where flow lines fall with it."""
        remedies, outcome = self.remedies, self.outcome
        if outcome.stop_reason.is_early:
            return self._verdict(kind, self._early_end(), "")
        helps = [remedies.further()] if remedies.too_far else [remedies.more_time()]
        confirmed = not self.known or outcome.verified <= 2 * max(
            outcome.mismatch, self.parameters.goal
        )
        if confirmed and not remedies.too_far:
            helps.append(GO_ON)
        return self._verdict(kind, f"{self._early_end()}, still falling", "", *helps)

    def _of_squeezing(self) -> Verdict:
        """The source shrank where it was: nothing led it to the target, or not long enough."""
        remedies = self.remedies
        to_nothing = "to nothing " * solvability.vanished(self.functions, self.outcome.advected)
        why = f"the flow squeezed the source {to_nothing}instead of moving it"
        if remedies.looks_near:
            why += ", as nothing led it to the target"
            return self._verdict("not reached", why, "", remedies.further())
        if self.outcome.stop_reason in _EARLY:
            why += f", and {self._early_end()}"
            return self._verdict("not reached", why, "", remedies.more_time())
        apart = (
            "wider functions that overlap, or targets in between, each match from the last one's "
            "field"
        )
        colder = [remedies.colder()] if remedies.is_warm else []
        return self._verdict("not reached", why, apart, *colder)

    def _missing_values(self) -> str:
        channel = solvability.worst_channel(self.functions)
        source = self.functions.source[channel]
        target = self.functions.target[channel, self.functions.areas > 0]
        return (
            f"{self._of(channel)}the target has values from {target.min():.3g} to "
            f"{target.max():.3g}, the source from {source.min():.3g} to {source.max():.3g}, and no "
            f"flow changes values: {self.bound:.2g} is the least left"
        )

    def _of(self, channel: int) -> str:
        return f"in channel {channel + 1} " if len(self.functions.source) > 1 else ""

    def _cut_short(self) -> bool:
        """Tell whether it ended while the energy still fell, and not by squeezing the source."""
        energies, reason = self.outcome.energies, self.outcome.stop_reason
        if reason not in _EARLY or self.squeezed:
            return False
        if reason.is_early or energies is None or len(energies) <= _RECENT:
            return True
        return bool(energies[-1] < (1 - _FALLING) * energies[-1 - _RECENT])

    def _early_end(self) -> str:
        if self.outcome.stop_reason is StopReason.CANCELLED:
            return "it was cancelled"
        if self.outcome.stop_reason is StopReason.OUT_OF_MEMORY:
            return "memory ran out, and the best field so far was kept"
        return f"it stopped after the {self.parameters.iterations} iterations it was given"

    def _truer(self) -> list[Remedy]:
        """Return what makes flow lines confirm a match. None of it undoes another: a mesh only gets
        finer, a field smoother up to the default, sigma smaller.
        """
        return [found for found in (self.remedies.truer(), self.remedies.refine()) if found]
