"""The course of a match: the target is found on the coarsest mesh, then the match comes close on
the others.
"""

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from itertools import pairwise, zip_longest

import numpy as np

from abfm.calculus.vector_fields import to_ambient, to_frame
from abfm.errors import ParameterError
from abfm.matching.objective.matching_energy import Evaluation, MatchingEnergy
from abfm.matching.solvability import narrowest
from abfm.matching.solving import schedule
from abfm.matching.solving.descent import (
    Confirmation,
    Descent,
    Incumbent,
    Progress,
    calmed,
    confirmation,
    is_walked,
)
from abfm.matching.solving.levels import levels
from abfm.matching.solving.record import CallerError, Iteration, Record, StopReason
from abfm.matching.solving.schedule import MATCHED, NEARLY, REACHED, Found, Stage
from abfm.types import FloatArray
from abfm.workers.control import CancelledError, checkpoint

_LOST = 0.3  # mismatch of a given start beyond which the target is looked for again
# mismatch on the mesh itself, beyond that on the coarsest, up to which meshes between are left out
_MORE = 0.2
# times the source's values, beyond which squares round off what the target is: nothing leads to it
_UNSTABLE = 1e8
# times the mismatch of no flow at all beyond which no search begins at a given start
_ASTRAY = 3.0
# edges that a function's features span at least where flow lines tell what cannot be matched: where
# the mesh does not carry the functions, they leave much in any case
_RESOLVED = 3.0
_PAYING = 0.03  # of what flow lines leave: what a colder stage must gain
# of the same: what a stage that matches may lose; and of an energy: what a gradual search may lose,
# as what two searches come to is the least
_ALIKE = 0.1

Carried = tuple[FloatArray, FloatArray]  # fields (N, F, 2) on the mesh, what they carry (C, V)


class Solver:
    def __init__(
        self, energy: MatchingEnergy, on_iteration: Callable[[Iteration], None] | None
    ) -> None:
        self.energy, self.record = energy, Record(on_iteration)
        # what flow lines of a smooth flow leave, in sigmas, where they do not confirm the match
        self.unmatched = np.nan
        self._alpha = energy.parameters.alpha  # with which the target was found
        # what flow lines confirmed last where sigma was raised, and of which descent
        self._confirmed = Confirmation(), Progress()
        self._descent = Descent(energy, self.record)
        self._clustered = len(self._descent.levels) > 1  # whether the mesh itself comes twice
        # what does not move: no field, and the one that was given
        self._at_rest: list[Carried] = [(np.zeros(energy.shape), energy.terms.carried)]

    def run(self) -> tuple[FloatArray, FloatArray, StopReason]:
        """Return fields (N, F, 2) on the mesh, what they carry (C, V), and why it stopped."""
        reason = of_caller = None
        try:
            self._descend()
        except CancelledError:
            reason = StopReason.CANCELLED
        except MemoryError:
            if not self.record.history:
                raise
            reason = StopReason.OUT_OF_MEMORY
        except CallerError as error:
            of_caller = error.raised
        if of_caller is not None:
            try:
                raise of_caller
            finally:
                # which would keep this frame, and all that it made, for the collector
                del of_caller
        # here, where nothing of what was under way takes memory any more
        return (*self._on_the_mesh(), reason or self._descent.reason)

    def _descend(self) -> None:
        descent, start = self._descent, self._start()
        if start is not None and not self._is_lost(start):
            self._finish(start, warm=True)
        else:
            descent.levels = levels(descent.levels)
            self._finish(self._find(start), warm=False)

    def _start(self) -> FloatArray | None:
        start, wanted = self.energy.problem.start, self.energy.parameters.segments
        if start is None:
            return None
        given = len(start)
        begins, others = np.arange(wanted)[:, None] * given, np.arange(given) * wanted
        overlaps = np.minimum(begins + given, others + wanted) - np.maximum(begins, others)
        averages = np.maximum(overlaps, 0) / given
        fields = np.tensordot(averages, start / self.energy.length_scale, 1)
        return to_frame(self.energy.mesh, fields)

    def _is_lost(self, x: FloatArray) -> bool:
        advected, source = self.energy.advected(x), self.energy.terms.carried
        if not np.isfinite(advected).all():
            raise ParameterError(
                "start: the flow of these fields overflows; start from slower ones or from none"
            )
        self._at_rest.append((x, advected))
        if self.energy.parameters.reach:
            return self.energy.relative_mismatch(advected) > _LOST
        largest, grown = float(np.abs(source).max()), float(np.abs(advected).max())
        if grown > _UNSTABLE * largest:
            raise ParameterError(
                "start: the discrete flow of these fields is unstable, as it makes values of up "
                f"to {grown:.3g} of those of up to {largest:.3g}; start from slower fields or from "
                "none"
            )
        return False

    def _find(self, start: FloatArray | None) -> FloatArray:
        """Return the fields on the coarsest mesh that lead to the target, or the best ones."""
        descent, p = self._descent, self.energy.parameters
        coarsest = descent.levels[0].energy
        at_rest = coarsest.relative_mismatch(coarsest.terms.carried)
        x = np.zeros(coarsest.shape)
        if start is not None:
            for finer, coarser in zip(descent.levels[:0:-1], descent.levels[-2::-1], strict=True):
                start = coarser.fields_from_finer(to_ambient(finer.energy.mesh, start))
            mismatch = coarsest.relative_mismatch(coarsest.advected(start))
            x = start if mismatch <= _ASTRAY * at_rest or not p.iterations else x
        best, least, kept = x, np.inf, descent.progress.best
        for attempt in schedule.search(p, len(descent.levels), self._clustered):
            if len(self.record.history) > attempt.stages[0].until:
                break
            descent.progress = Progress()
            found = x
            with Incumbent(descent, Progress(kept), least):
                for stage in attempt.stages:
                    found = descent.minimise(stage, found).x
            if descent.mismatch < least:
                best, least, kept = found, descent.mismatch, descent.progress.best
                self._alpha = attempt.stages[0].alpha
            if descent.mismatch <= attempt.found:
                break
        descent.progress = replace(descent.progress, best=kept)
        # no flow, or a source squeezed to nothing
        if p.iterations and max(at_rest, 1.0) < least < np.inf:
            return np.zeros_like(best)
        return self._more_gradually(kept).x if kept is not None and least <= REACHED else best

    def _more_gradually(self, usual: Evaluation) -> Evaluation:
        """Return what was found, or what a gradual search finds if only this is confirmed."""
        descent, p = self._descent, self.energy.parameters
        coarsest = descent.levels[0].energy
        stages = schedule.gradual(p, len(descent.levels), self._clustered)
        if not stages or len(self.record.history) > stages[0].until or not is_walked(coarsest):
            return usual
        sigma, progress = stages[-1].sigma, descent.progress
        confirmed = confirmation(coarsest, descent.at(stages[-1], usual.x), sigma)
        if confirmed.mismatch <= NEARLY or narrowest(coarsest.functions) < _RESOLVED:
            return usual
        descent.progress = Progress()
        found = np.zeros_like(usual.x)
        with Incumbent(descent, Progress(usual)):
            for stage in stages:
                found = descent.minimise(stage, found).x
            smooth = confirmation(coarsest, descent.best, sigma)
        if descent.mismatch > REACHED or smooth.energy >= (1 + _ALIKE) * confirmed.energy:
            descent.progress = progress
            return usual
        self._alpha = stages[-1].alpha
        if smooth.mismatch > NEARLY and p.sigma_unit == "relative":
            self.unmatched = smooth.left
        return descent.best

    def _finish(self, x: FloatArray, warm: bool) -> None:
        """Come close on all meshes, or not on those between where the mesh itself is as close."""
        count = len(self._descent.levels)
        found = Found(warm, 0.0 if np.isnan(self.unmatched) else self.unmatched, self._alpha)
        plan = schedule.finish(self.energy.parameters, count, found, self._clustered)
        top = count - 1 - self._clustered
        last = [stage for stage in plan if stage.level >= top]
        x = self._through([stage for stage in plan if stage.level == 0 < top], x)
        between = [stage for stage in plan if 0 < stage.level < top]
        ahead = self._ahead(x, last[0]) if between else None
        self._through(last, self._through(between, x) if ahead is None else ahead)

    def _through(self, stages: list[Stage], x: FloatArray | Evaluation) -> FloatArray:
        descent = self._descent
        for stage, following in zip_longest(stages, stages[1:]):
            x = descent.prolonged(x, stage)
            is_begun = descent.progress.best is not None and descent.level == stage.level
            if is_begun and descent.mismatch <= descent.attainable(stage.needed_above):
                continue
            if stage.balanced:
                x = descent.balance(stage).x
            elif np.isnan(self.unmatched):
                x = descent.minimise(stage, x).x
            else:
                is_end = following is None or not following.needed_above
                x = self._confirming(stage, x, is_end).x
        return x.x if isinstance(x, Evaluation) else x

    def _confirming(self, stage: Stage, start: FloatArray | Evaluation, is_end: bool) -> Evaluation:
        """Run a stage where sigma was raised; what closing stages find stays where flow lines leave
        less, or it matches and they leave about as much, else it is undone.
        """
        descent, (before, progress) = self._descent, self._confirmed
        energy, is_closing = descent.levels[stage.level].energy, stage.needed_above > 0
        if is_closing and not is_walked(energy):
            return descent.best
        is_fallback = is_closing and progress.best is not None
        with Incumbent(descent, progress) if is_fallback else nullcontext():
            found, now = descent.minimise(stage, start), Confirmation()
            if is_walked(energy):
                now = confirmation(energy, found, stage.sigma)
        matches = descent.mismatch <= descent.attainable(MATCHED)
        gains = now.mismatch < (1 - _PAYING) * before.mismatch
        alike = now.mismatch <= (1 + _ALIKE) * before.mismatch
        if not is_closing or gains or (matches and alike):
            self._confirmed = now, descent.progress
        elif matches or is_end:
            descent.progress = progress
        return descent.best

    def _ahead(self, x: FloatArray, stage: Stage) -> Evaluation | None:
        descent = self._descent
        checkpoint()
        for level in descent.levels[: stage.level]:
            x = level.fields_to_finer(x)
        found = descent.at(stage, x)
        left = self.energy.relative_mismatch(found.advected)
        return found if left <= descent.mismatch + _MORE else None

    def _on_the_mesh(self) -> Carried:
        """Return the best fields on the mesh itself: never worse than what does not move."""
        descent, mismatch = self._descent, self.energy.relative_mismatch
        if descent.progress.best is None:
            return self._at_rest[0]
        found, before = (descent.best.x, descent.best.advected), descent.mismatch
        for coarser, finer in pairwise(descent.levels[descent.level :]):

            def measured(x: FloatArray, on: MatchingEnergy = finer.energy) -> tuple[Carried, float]:
                functions = on.advected(x)
                return (x, functions), on.relative_mismatch(functions)

            found = calmed(finer.energy.mesh, coarser.fields_to_finer(found[0]), before, measured)
        left = [mismatch(advected) for _, advected in self._at_rest]
        if mismatch(found[1]) <= max(left):
            return found
        return self._at_rest[int(np.argmin(left))]
