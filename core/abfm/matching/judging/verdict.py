"""What a match came to, why, and what to try, in plain words."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

from abfm.matching.energy.problem import Problem
from abfm.matching.judging import solvability
from abfm.matching.judging.peaks import Extrema
from abfm.matching.schedule import MATCHED
from abfm.parameters import Parameters
from abfm.types import FloatArray

Kind = Literal["matched", "nearly", "not reached", "impossible"]

NEARLY = 0.15
"""Mismatch, relative to the target, up to which functions are nearly matched."""
CONFIRMED = 2.0
"""Flow lines confirm a mismatch if they leave at most this many times as much: 0.1 of a match, 0.3 of a near one."""
FOLDED = 0.1
"""Share of folded faces beyond which the map of a flow is not to be trusted; an exact flow folds none."""

_RECENT, _FALLING = 10, 0.01  # an energy still falls that has fallen by this share within so many iterations
_FURTHER = 3.0  # how much larger or smaller a parameter is advised
_USUAL_ALPHA = 0.02  # advised in place of 0
_NEAR = 0.1  # the least reach that is advised


@dataclass(frozen=True, eq=False)
class Outcome:
    """What is known of a match that has ended."""

    advected: FloatArray  # source carried to tau, (C, V)
    mismatch: float  # ``||f_tau - g|| / ||g||`` of the discrete flow
    stop_reason: str  # "converged", "iteration limit", "line search failed" or "cancelled"
    verified: float = math.nan  # mismatch where flow lines carry the source; NaN if unknown
    folded: float = math.nan  # share of the faces, 0 to 1, that the flow's map turns over; NaN if unknown
    energies: FloatArray | None = None  # (n,), of the last stage's iterates; None counts as still falling
    unmatched: float = math.nan  # what smooth flows leave along flow lines, if sigma was raised to it; NaN if not


@dataclass(frozen=True)
class Verdict:
    """What a match came to; reason and advice are one line each, without a full stop."""

    kind: Kind  # impossible: no flow would do; not reached: not by this flow, which may still be worth having
    reason: str  # the first and the last mismatch, and what they mean
    advice: str  # what to try, empty where nothing is needed


def advice(problem: Problem, outcome: Outcome, parameters: Parameters) -> Verdict:
    """Say what a match came to, why, and what to do; numbers that are advised start from the parameters it had.

    What no flow can do comes first, whatever the discrete flow has made of it; then whether flow lines confirm the
    mismatch; then its size; and where it is large, the most telling cause.
    """
    case = _Case(problem, outcome, parameters)
    return case.impossible() or case.unconfirmed() or case.by_size() or case.not_reached()


class _Case:
    """A match under the rules, each of which gives a verdict or None."""

    def __init__(self, problem: Problem, outcome: Outcome, parameters: Parameters) -> None:
        self.problem, self.outcome, self.parameters = problem, outcome, parameters
        self.bound = solvability.range_bound(problem)
        self.true_mismatch = max(outcome.mismatch, self.bound)
        self.first = problem.relative_mismatch(problem.source)
        self.known = not math.isnan(outcome.verified)
        self.raised = outcome.unmatched > parameters.sigma

    @cached_property
    def different_peaks(self) -> tuple[int, Extrema, Extrema] | None:
        return solvability.different_peaks(self.problem)

    def impossible(self) -> Verdict | None:
        """Values that the source lacks, or cannot lose; functions that were alike from the start are no such case."""
        if max(self.first, self.outcome.mismatch) <= MATCHED:
            return None
        flat, to_flat = solvability.source_is_constant(self.problem), solvability.target_is_constant(self.problem)
        if flat and not to_flat:
            why = "the source is constant, and no flow changes that"
            return self._verdict("impossible", why, "take a source that has the target's values")
        if to_flat and not flat:
            why = "the target is constant and the source is not, and a flow keeps every value of the source"
            return self._verdict("impossible", why, "take a target that has the source's values in other places")
        if self.bound > NEARLY:
            return self._verdict("impossible", self._missing_values(), "scale or clip one of the functions")
        return None

    def unconfirmed(self) -> Verdict | None:
        """A small mismatch of the discrete flow that is not one of the flow."""
        verified, folded = self.outcome.verified, self.outcome.folded
        if self.true_mismatch > NEARLY:
            return None
        if self.known and verified > CONFIRMED * NEARLY:
            if self.different_peaks:
                return self._of_peaks()
            why = f"the flow lines confirm only {verified:.2g}, so the discrete flow is not one here"
            return self._verdict("not reached", why, self._smoother())
        if folded > FOLDED and not self.known:
            return self._verdict("not reached", f"{self._folds()}, which no flow does", self._smoother())
        return None

    def by_size(self) -> Verdict | None:
        """A mismatch that is small, also by flow lines where they are known."""
        verified = self.outcome.verified / CONFIRMED if self.known else 0.0
        size = max(self.true_mismatch, verified)
        if size > NEARLY:
            return None
        if size <= MATCHED < self.first and not self.known and self.different_peaks:
            return self._of_peaks("nearly")
        if size <= MATCHED:
            advised = f"do not trust its point map, where {self._folds()}" if self.outcome.folded > FOLDED else ""
            return self._verdict("matched", "", advised)
        if self.bound > MATCHED:
            return self._verdict("nearly", self._missing_values(), "scale or clip one of the functions")
        if verified > max(MATCHED, self.outcome.mismatch):
            return self._verdict("nearly", "the flow lines confirm less than the discrete flow shows", self._smoother())
        return self._verdict("nearly", "", self._more_iterations() if self._still_falls() else self._closer())

    def not_reached(self) -> Verdict:
        """The most telling cause of a mismatch that is large."""
        problem, outcome = self.problem, self.outcome
        if solvability.vanished(problem, outcome.advected):
            why = "the flow squeezed the source to nothing instead of moving it, as nothing led it to the target"
            return self._verdict("not reached", why, self._further())
        if outcome.stop_reason == "cancelled":
            return self._verdict("not reached", "it was cancelled", "go on from this field")
        if solvability.stood_still(problem, outcome.advected):
            more = f"; {self._more_iterations()}" if self._still_falls() else ""
            why = "the source hardly moved, as moving costs more smoothness than it gains"
            return self._verdict("not reached", why, f"{self._smaller('sigma')}; or {self._further()}{more}")
        if self.different_peaks:
            return self._of_peaks()
        if self._still_falls():
            return self._verdict("not reached", "it was still falling", self._more_iterations())
        if outcome.stop_reason == "line search failed":
            why = "no step lowers the energy any more, which is often rounding"
            return self._verdict("not reached", why, f"{self._larger('alpha')}, or {self._larger('sigma')}")
        why = "what is left differs, or would cost more smoothness than it gains"
        return self._verdict("not reached", why, self._closer())

    def _verdict(self, kind: Kind, why: str, advised: str) -> Verdict:
        before, after = f"{self.first:.2g}", f"{self.outcome.mismatch:.2g}"
        moved = f"{'fell' if self.outcome.mismatch < self.first else 'rose'} from {before} to"
        change = f"the mismatch {'stayed at' if before == after else moved} {after}"
        if self.known:
            change += f" ({self.outcome.verified:.2g} by flow lines)"
        if self.raised:
            unmatched = f"{self.outcome.unmatched:.2g}"
            change += f" with sigma raised to {unmatched}, which is what smooth flows leave of the functions"
        return Verdict(kind, f"{change}: {why}" if why else change, advised)

    def _of_peaks(self, kind: Kind = "not reached") -> Verdict:
        assert self.different_peaks is not None
        channel, here, there = self.different_peaks
        why = f"{self._of(channel)}the source has {here}, the target {there}, and flows neither split nor join them"
        return self._verdict(kind, why, "expect a match in part, or smooth the function that has more of them")

    def _missing_values(self) -> str:
        channel = solvability.worst_channel(self.problem)
        source, target = self.problem.source[channel], self.problem.target[channel, self.problem.areas > 0]
        return (
            f"{self._of(channel)}the target has values from {target.min():.3g} to {target.max():.3g}, the source from "
            f"{source.min():.3g} to {source.max():.3g}, and no flow changes values: {self.bound:.2g} is the least left"
        )

    def _of(self, channel: int) -> str:
        return f"in channel {channel} " if len(self.problem.source) > 1 else ""

    def _folds(self) -> str:
        return f"{100 * self.outcome.folded:.0f}% of the faces are folded"

    def _still_falls(self) -> bool:
        energies = self.outcome.energies
        if self.outcome.stop_reason != "iteration limit":
            return False
        if energies is None or len(energies) <= _RECENT:
            return True
        return bool(energies[-1] < (1 - _FALLING) * energies[-1 - _RECENT])

    def _more_iterations(self) -> str:
        return f"more iterations, such as {max(2 * self.parameters.iterations, 20)}, or go on from this field"

    def _further(self) -> str:
        """What leads a source to a target that is far away."""
        needed = max(solvability.distance(self.problem), _NEAR)
        if self.parameters.reach < needed:
            return f"a larger reach, such as {needed:.2g} of sqrt(area)"
        return "wider functions that overlap, or targets in between, each match started from the last one's field"

    def _smoother(self) -> str:
        return f"{self._larger('alpha')}, {self._larger('sigma')}, or a finer mesh"

    def _closer(self) -> str:
        alpha = f", or {self._smaller('alpha')}" if self.parameters.alpha else ""
        sigma = self._smaller("sigma")
        if self.raised:
            size = self.outcome.unmatched / _FURTHER * self.problem.function_size
            sigma = f"an absolute sigma, which is never raised, such as {size:.2g}"
        return f"to come closer with a rougher field, {sigma}{alpha}"

    def _larger(self, name: Literal["alpha", "sigma"]) -> str:
        return f"a larger {name}, such as {_FURTHER * self._last(name) or _USUAL_ALPHA:.2g}"

    def _smaller(self, name: Literal["alpha", "sigma"]) -> str:
        return f"a smaller {name}, such as {self._last(name) / _FURTHER:.2g}"

    def _last(self, name: Literal["alpha", "sigma"]) -> float:
        """What the match had in the end."""
        if name == "alpha":
            return self.parameters.alpha
        return self.outcome.unmatched if self.raised else self.parameters.sigma
