"""What a match came to, why, and what to try, in plain words."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

from abfm.matching.judging import solvability
from abfm.matching.judging.peaks import Extrema
from abfm.matching.judging.remedies import Remedies, Remedy
from abfm.matching.solving.early_warning import stood_still, vanished
from abfm.matching.solving.range_bound import range_bound
from abfm.matching.solving.schedule import MATCHED, NEARLY
from abfm.matching.solving.stop_reason import StopReason
from abfm.matching.terms.functions import CONSTANT, FunctionTerm
from abfm.parameters import Parameters
from abfm.types import FloatArray

Kind = Literal["matched", "nearly", "not reached", "impossible"]

CONFIRMED = 2.0
"""Flow lines confirm a mismatch if they leave at most this many times as much: 0.1 of a match,
0.3 of a near one.
"""


def confirmed_mismatch(mismatch: float, verified: float) -> float:
    """The least mismatch that the discrete flow and flow lines (NaN if unknown) both confirm:
    what is surely left.
    """
    return mismatch if math.isnan(verified) else max(mismatch, verified / CONFIRMED)


def kind_of(confirmed: float) -> Kind:
    """Return what a mismatch is called by its size alone: the larger it is, the worse the word."""
    if confirmed <= MATCHED:
        return "matched"
    return "nearly" if confirmed <= NEARLY else "not reached"


FOLDED = 0.1
"""Share of folded faces beyond which the map of a flow is not to be trusted; an exact flow folds
none.
"""

# an energy still falls that has fallen by this share within so many iterations
_RECENT, _FALLING = 10, 0.01

_EARLY = (StopReason.ITERATION_LIMIT, StopReason.CANCELLED, StopReason.OUT_OF_MEMORY)


@dataclass(frozen=True, eq=False)
class Outcome:
    """What is known of a match that has ended."""

    advected: FloatArray  # source carried to tau, (C, V)
    mismatch: float  # ``||f_tau - g|| / ||g||`` of the discrete flow
    stop_reason: StopReason
    verified: float = math.nan  # mismatch where flow lines carry the source; NaN if unknown
    # share of the faces, 0 to 1, that the flow's map turns over; NaN if unknown
    folded: float = math.nan
    # (n,), of the last stage's iterates; None counts as still falling
    energies: FloatArray | None = None
    # what smooth flows leave along flow lines, if sigma was raised to it; NaN if not
    unmatched: float = math.nan


@dataclass(frozen=True)
class Verdict:
    """What a match came to; reason and advice are one line each, without a full stop."""

    # impossible: no flow would do; not reached: not by this flow, which may still be worth having
    kind: Kind
    reason: str  # the first and the last mismatch, and what they mean after a colon
    advice: str  # what to try, empty where nothing is needed
    # the same as parameters, as far as they can do it, best first
    remedies: tuple[Remedy, ...] = ()

    @property
    def cause(self) -> str:
        """What the mismatches mean; empty where they speak for themselves."""
        return self.reason.partition(": ")[2]


def advice(functions: FunctionTerm, outcome: Outcome, parameters: Parameters) -> Verdict:
    """Say what a match came to, why, and what to do; numbers that are advised start from the
    parameters it had.

    What no flow can do comes first, whatever the discrete flow has made of it; then whether flow
    lines confirm the mismatch; then its size; and where it is large, the most telling cause.
    """
    case = _Case(functions, outcome, parameters)
    return case.impossible() or case.unconfirmed() or case.by_size() or case.not_reached()


class _Case:
    """A match under the rules, each of which gives a verdict or None."""

    def __init__(self, functions: FunctionTerm, outcome: Outcome, parameters: Parameters) -> None:
        self.functions, self.outcome, self.parameters = functions, outcome, parameters
        self.bound = range_bound(functions)
        self.true_mismatch = max(outcome.mismatch, self.bound)
        self.by_size_alone = kind_of(confirmed_mismatch(self.true_mismatch, outcome.verified))
        self.first = functions.relative_mismatch(functions.source)
        self.known = not math.isnan(outcome.verified)
        self.raised = outcome.unmatched > parameters.sigma
        self.remedies = Remedies(functions, parameters, outcome.unmatched)

    @cached_property
    def different_peaks(self) -> tuple[int, Extrema, Extrema] | None:
        return solvability.different_peaks(self.functions)

    @cached_property
    def squeezed(self) -> bool:
        return solvability.squeezed(self.functions, self.outcome.advected)

    def impossible(self) -> Verdict | None:
        """Values that the source lacks, or cannot lose; functions that were alike from the start
        are no such case.
        """
        if max(self.first, self.outcome.mismatch) <= MATCHED:
            return None
        flat, to_flat = (
            solvability.source_is_constant(self.functions),
            solvability.target_is_constant(self.functions),
        )
        if flat and not to_flat:
            why = "the source is constant, and no flow changes that"
            return self._verdict("impossible", why, "take a source that has the target's values")
        if to_flat and not flat:
            why = (
                "the target is constant and the source is not, and a flow keeps every value of "
                "the source"
            )
            return self._verdict(
                "impossible", why, "take a target that has the source's values in other places"
            )
        if self.bound > NEARLY:
            return self._verdict(
                "impossible", self._missing_values(), "scale or clip one of the functions"
            )
        return None

    def unconfirmed(self) -> Verdict | None:
        """A small mismatch of the discrete flow that is not one of the flow."""
        verified, folded = self.outcome.verified, self.outcome.folded
        if self.true_mismatch > NEARLY:
            return None
        if self.by_size_alone == "not reached":
            if self.different_peaks:
                return self._of_peaks()
            why = (
                f"by flow lines the mismatch is {verified:.2g}, so the discrete flow is not one "
                "here"
            )
            return self._verdict("not reached", why, "a finer mesh", *self._truer(or_smoother=True))
        if folded > FOLDED and not self.known:
            why = f"{self._folds()}, which no flow does"
            return self._verdict("not reached", why, "a finer mesh", *self._truer(or_smoother=True))
        return None

    def by_size(self) -> Verdict | None:
        """A mismatch that is small, also by flow lines where they are known."""
        if self.by_size_alone == "not reached":
            return None
        is_matched = self.by_size_alone == "matched"
        if is_matched and self.first > MATCHED and not self.known and self.different_peaks:
            return self._of_peaks("nearly")
        if is_matched and self.functions.is_constant:
            return self._verdict(
                "matched", f"both are constant, up to {CONSTANT:g} of their values", ""
            )
        if is_matched:
            advised = (
                f"do not trust its point map, where {self._folds()}"
                if self.outcome.folded > FOLDED
                else ""
            )
            return self._verdict("matched", "", advised)
        if self.bound > MATCHED:
            return self._verdict(
                "nearly", self._missing_values(), "scale or clip one of the functions"
            )
        if self._cut_short():
            return self._of_an_early_end("nearly")
        if self.known and self.outcome.verified / CONFIRMED > max(MATCHED, self.outcome.mismatch):
            why = "the flow lines confirm less than the discrete flow shows"
            return self._verdict("nearly", why, "a finer mesh", *self._truer())
        return self._verdict("nearly", "", "", self.remedies.closer())

    def not_reached(self) -> Verdict:
        """The most telling cause of a mismatch that is large."""
        outcome, remedies = self.outcome, self.remedies
        if self.squeezed:
            return self._of_squeezing()
        if outcome.stop_reason.is_early:
            return self._of_an_early_end("not reached")
        if stood_still(self.functions, outcome.advected) and not self._hardly_began():
            why = "the source hardly moved, as moving costs more smoothness than it gains"
            further = (remedies.further(),) if remedies.too_far else ()
            return self._verdict("not reached", why, "", *further, remedies.colder())
        if self.different_peaks:
            return self._of_peaks()
        if self._cut_short():
            return self._of_an_early_end("not reached")
        if outcome.stop_reason is StopReason.LINE_SEARCH_FAILED:
            why = "no step lowers the energy any more, which is often rounding"
            return self._verdict("not reached", why, "", remedies.smoother())
        why = "what is left differs, or would cost more smoothness than it gains"
        return self._verdict("not reached", why, "", remedies.closer())

    def _verdict(self, kind: Kind, why: str, advised: str, *remedies: Remedy) -> Verdict:
        before, after = f"{self.first:.2g}", f"{self.outcome.mismatch:.2g}"
        moved = f"{'fell' if self.outcome.mismatch < self.first else 'rose'} from {before} to"
        change = f"the mismatch {'stayed at' if before == after else moved} {after}"
        if self.known:
            change += f" ({self.outcome.verified:.2g} by flow lines)"
        if self.raised:
            unmatched = f"{self.outcome.unmatched:.2g}"
            change += (
                f" with sigma raised to {unmatched}, which is what smooth flows leave of "
                "the "
                "functions"
            )
        words = [remedy.words for remedy in remedies] + [advised] * bool(advised)
        if self.outcome.stop_reason.is_early:
            remedies = (*remedies, self.remedies.go_on())
            words.append(self.remedies.go_on().words)
        return Verdict(kind, f"{change}: {why}" if why else change, "; or ".join(words), remedies)

    def _of_peaks(self, kind: Kind = "not reached") -> Verdict:
        assert self.different_peaks is not None
        channel, here, there = self.different_peaks
        why = f"{self._of(channel)}the source has {here}, the target {there}; no flow changes that"
        return self._verdict(
            kind, why, "smooth the function that has more of them, or expect a match in part"
        )

    def _of_an_early_end(self, kind: Kind) -> Verdict:
        if self.outcome.stop_reason.is_early:
            return self._verdict(kind, self._early_end(), "")
        return self._verdict(
            kind, f"{self._early_end()}, still falling", "", *self._more_iterations()
        )

    def _more_iterations(self) -> list[Remedy]:
        """Return what helps a match whose energy still falls; going on does where flow lines fall
        with it.
        """
        remedies, outcome = self.remedies, self.outcome
        if remedies.too_far:
            return [remedies.further()]
        confirmed = not self.known or outcome.verified <= CONFIRMED * max(outcome.mismatch, MATCHED)
        return [remedies.more_time(), *([remedies.go_on()] if confirmed else [])]

    def _of_squeezing(self) -> Verdict:
        """The source shrank where it was: nothing led it to the target, or not long enough."""
        remedies = self.remedies
        to_nothing = "to nothing " * vanished(self.functions, self.outcome.advected)
        why = f"the flow squeezed the source {to_nothing}instead of moving it"
        if remedies.looks_near:
            return self._verdict(
                "not reached", f"{why}, as nothing led it to the target", "", remedies.further()
            )
        if self.outcome.stop_reason in _EARLY:
            return self._verdict(
                "not reached", f"{why}, and {self._early_end()}", "", remedies.more_time()
            )
        apart = (
            "wider functions that overlap, or targets in between, each match from the last "
            "one's "
            "field"
        )
        return self._verdict(
            "not reached", why, apart, *([remedies.colder()] if remedies.is_warm else [])
        )

    def _missing_values(self) -> str:
        channel = solvability.worst_channel(self.functions)
        source, target = (
            self.functions.source[channel],
            self.functions.target[channel, self.functions.areas > 0],
        )
        return (
            f"{self._of(channel)}the target has values from {target.min():.3g} to "
            f"{target.max():.3g}, the source from "
            f"{source.min():.3g} to {source.max():.3g}, and no flow changes values: "
            f"{self.bound:.2g} is the least left"
        )

    def _of(self, channel: int) -> str:
        count = len(self.functions.source)
        return f"in channel {channel + 1} " if count > 1 else ""

    def _folds(self) -> str:
        return f"{100 * self.outcome.folded:.0f}% of the faces are folded"

    def _cut_short(self) -> bool:
        """Tell whether it ended while the energy still fell, and not by squeezing the source."""
        energies, reason = self.outcome.energies, self.outcome.stop_reason
        if reason not in _EARLY or self.squeezed:
            return False
        if reason.is_early:
            return True
        if energies is None or len(energies) <= _RECENT:
            return True
        return bool(energies[-1] < (1 - _FALLING) * energies[-1 - _RECENT])

    def _hardly_began(self) -> bool:
        """Tell whether it had too few iterations for anything to be said of where it was going."""
        return (
            self.outcome.stop_reason is StopReason.ITERATION_LIMIT
            and self.parameters.iterations < _RECENT
        )

    def _early_end(self) -> str:
        if self.outcome.stop_reason is StopReason.CANCELLED:
            return "it was cancelled"
        if self.outcome.stop_reason is StopReason.OUT_OF_MEMORY:
            return "memory ran out, and the best field so far was kept"
        return f"it stopped after the {self.parameters.iterations} iterations it was given"

    def _truer(self, or_smoother: bool = False) -> list[Remedy]:
        """Return what makes a match hold that flow lines do not confirm; where they refute it, even
        more than the defaults.
        """
        if truer := self.remedies.truer():
            return [truer]
        return [self.remedies.smoother()] if or_smoother and self.remedies.is_carried else []
