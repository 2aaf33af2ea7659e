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
from abfm.matching.objective.matching_energy import MatchingEnergy
from abfm.matching.objective.objective import Evaluation
from abfm.matching.solving.calming import calmed
from abfm.matching.solving.confirmation import (
    Confirmation,
    confirmation,
    is_resolved,
    is_walked,
)
from abfm.matching.solving.descent import Descent
from abfm.matching.solving.incumbent import Candidate, Incumbent, Progress
from abfm.matching.solving.levels import levels
from abfm.matching.solving.record import CallerError, Iteration, Record
from abfm.matching.solving.schedule import MATCHED, REACHED, Found, Stage, finish, gradual, search
from abfm.matching.solving.stop_reason import StopReason
from abfm.types import FloatArray
from abfm.workers.control import CancelledError, checkpoint

_LOST = 0.3  # mismatch of a given start beyond which the target is looked for again
# mismatch on the mesh itself, beyond that on the coarsest, up to which meshes between are left out
_MORE = 0.2
# times the source's values, beyond which squares round off what the target is: nothing leads to it
_UNSTABLE = 1e8
# times the mismatch of no flow at all beyond which the way is not looked for from a given start
_ASTRAY = 3.0
_UNKNOWN = Confirmation(np.inf, np.inf, np.inf)


class Solver:
    """Decides which stages a match goes through, and what is kept of them."""

    def __init__(
        self,
        energy: MatchingEnergy,
        on_iteration: Callable[[Iteration], None] | None,
    ) -> None:
        self.energy = energy
        record = Record(on_iteration)
        self.history, self.stage_of, self.schedule = (
            record.history,
            record.stage_of,
            record.schedule,
        )
        # what flow lines of a smooth way leave, in sigmas, where they do not confirm the match
        self.unmatched = np.nan
        self._alpha = energy.parameters.alpha  # with which the target was found
        self._held = _UNKNOWN, Progress()  # what flow lines said last where sigma was raised
        self._descent = Descent(energy, record)
        self._joined = len(self._descent.levels) > 1  # whether the mesh itself comes twice

    def run(self) -> tuple[FloatArray, FloatArray, StopReason]:
        """Return fields (N, F, 2) on the mesh, what they carry (C, V), and why it stopped."""
        reason = of_caller = None
        try:
            self._descend()
        except CancelledError:
            reason = StopReason.CANCELLED
        except MemoryError:
            if not self.history:
                raise
            reason = StopReason.OUT_OF_MEMORY
        except CallerError as error:
            of_caller = error.raised
        if of_caller is not None:
            try:
                raise of_caller
            finally:
                del (
                    of_caller
                )  # which would keep this frame, and all that it made, for the collector
        # here, where nothing of what was under way takes memory any more
        return (*self._on_the_mesh(), reason or self._descent.reason)

    def _descend(self) -> None:
        descent, start = self._descent, self.energy.problem.start
        fields = None if start is None else _start_fields(self.energy, start)
        if fields is not None and not self._is_lost(fields):
            self._finish(fields, warm=True)
        else:
            descent.levels = levels(descent.levels)
            self._finish(self._find(fields), warm=False)

    def _is_lost(self, fields: FloatArray) -> bool:
        """Tell whether a start is so far from the target that the way there must be looked for."""
        advected, source = self.energy.advected(fields), self.energy.terms.carried
        if not np.isfinite(advected).all():
            raise ParameterError(
                "start: the flow of these fields overflows; start from slower ones or from none"
            )
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

    def _find(self, fields: FloatArray | None) -> FloatArray:
        """Fields on the coarsest mesh that lead at least near the target, or the best that were
        found.
        """
        descent, p = self._descent, self.energy.parameters
        coarsest = descent.levels[0].energy
        x = np.zeros(coarsest.shape)
        if fields is not None:
            given = self._on_the_coarsest(fields)
            at_rest = coarsest.relative_mismatch(coarsest.terms.carried)
            mismatch = coarsest.relative_mismatch(coarsest.advected(given))
            x = given if mismatch <= _ASTRAY * at_rest or not p.iterations else x
        best, least, kept = x, np.inf, descent.progress.best
        for way in search(p, len(descent.levels), self._joined):
            if len(self.history) > way.stages[0].until:
                break
            descent.progress = Progress()
            found = x
            with Incumbent(descent, Progress(kept), least):
                for stage in way.stages:
                    found = descent.minimise(stage, found).x
            if descent.mismatch < least:
                best, least, kept = found, descent.mismatch, descent.progress.best
                self._alpha = way.stages[0].alpha
            if descent.mismatch <= way.found:
                break
        descent.progress = replace(descent.progress, best=kept)
        # no flow, or a source squeezed to nothing
        worst = max(coarsest.relative_mismatch(coarsest.terms.carried), 1.0)
        if p.iterations and worst < least < np.inf:
            return np.zeros_like(best)
        return self._more_gradually(kept).x if kept is not None and least <= REACHED else best

    def _on_the_coarsest(self, fields: FloatArray) -> FloatArray:
        meshes = self._descent.levels
        for finer, coarser in zip(meshes[:0:-1], meshes[-2::-1], strict=True):
            fields = coarser.fields_from_finer(to_ambient(finer.energy.mesh, fields))
        return fields

    def _more_gradually(self, usual: Candidate) -> Candidate:
        """Return what was found, or what a more gradual way finds where flow lines do not confirm
        that and do this.
        """
        descent, p = self._descent, self.energy.parameters
        coarsest, way = descent.levels[0].energy, gradual(p, len(descent.levels), self._joined)
        if not way or len(self.history) > way[0].until or not is_walked(coarsest):
            return usual
        sigma, progress = way[-1].sigma, descent.progress
        confirmed = confirmation(coarsest, descent.at(way[-1], usual.x), sigma)
        if not confirmed.is_doubtful or not is_resolved(coarsest):
            return usual
        descent.progress = Progress()
        found = np.zeros_like(usual.x)
        with Incumbent(descent, Progress(usual)):
            for stage in way:
                found = descent.minimise(stage, found).x
            smooth = confirmation(coarsest, descent.best, sigma)
        if descent.mismatch > REACHED or not smooth.is_as_low(confirmed):
            descent.progress = progress
            return usual
        self._alpha = way[-1].alpha
        if smooth.is_doubtful and p.sigma_unit == "relative":
            self.unmatched = smooth.left
        return descent.best

    def _finish(self, x: FloatArray, warm: bool) -> None:
        """Come close on all meshes; those between are left out where what is found holds on the
        mesh itself.
        """
        count = len(self._descent.levels)
        raised = 0.0 if np.isnan(self.unmatched) else self.unmatched
        found = Found(warm, raised, self._alpha)
        plan = finish(self.energy.parameters, count, found, self._joined)
        top = count - 1 - self._joined
        last = [stage for stage in plan if stage.level >= top]
        x = self._through([stage for stage in plan if stage.level == 0 < top], x)
        between = [stage for stage in plan if 0 < stage.level < top]
        ahead = self._ahead(x, last[0]) if between else None
        if ahead is None:
            x = self._through(between, x)
        self._through(last, x, ahead)

    def _through(
        self, stages: list[Stage], x: FloatArray, ahead: Candidate | None = None
    ) -> FloatArray:
        """Run stages one after the other; the first one may know its beginning."""
        descent = self._descent
        for stage, following in zip_longest(stages, stages[1:]):
            if ahead is None:
                x, known = descent.prolonged(x, stage)
            else:
                x, known, ahead = ahead.x, ahead.point, None
            is_begun = descent.progress.best is not None and descent.level == stage.level
            if is_begun and descent.mismatch <= descent.attainable(stage.needed_above):
                continue
            if stage.balanced:
                x = descent.balance(stage).x
            elif np.isnan(self.unmatched):
                x = descent.minimise(stage, x, known=known).x
            else:
                is_end = following is None or not following.needed_above
                x = self._confirmed(stage, x, known, is_end).x
        return x

    def _confirmed(
        self, stage: Stage, x: FloatArray, known: Evaluation | None, is_end: bool
    ) -> Candidate:
        """Run a stage where sigma was raised.

        What closing stages find stays where flow lines leave less, or where it matches and they
        leave about as much; else it is undone once it matches or the last one ends.
        """
        descent = self._descent
        energy, is_closing = descent.levels[stage.level].energy, stage.needed_above > 0
        if is_closing and not is_walked(energy):
            return descent.best
        is_fallback = is_closing and self._held[1].best is not None
        with Incumbent(descent, self._held[1]) if is_fallback else nullcontext():
            found = descent.minimise(stage, x, known=known)
            now = _UNKNOWN
            if is_walked(energy):
                now = confirmation(energy, found, stage.sigma)
        before, matches = self._held[0], descent.mismatch <= descent.attainable(MATCHED)
        if not is_closing or now.gains(before) or (matches and now.equals(before)):
            self._held = now, descent.progress
        elif matches or is_end:
            descent.progress = self._held[1]
        return descent.best

    def _ahead(self, x: FloatArray, stage: Stage) -> Candidate | None:
        """Fields of the coarsest mesh on that of a stage, where they leave little more than they
        did.
        """
        descent = self._descent
        checkpoint()
        for level in descent.levels[: stage.level]:
            x = level.fields_to_finer(x)
        found = descent.at(stage, x)
        left = self.energy.relative_mismatch(found.point.advected)
        return found if left <= descent.mismatch + _MORE else None

    def _on_the_mesh(self) -> tuple[FloatArray, FloatArray]:
        """The best fields on the mesh itself, and the source carried by them."""
        descent = self._descent
        if descent.progress.best is None:
            return np.zeros(self.energy.shape), self.energy.terms.carried
        x, advected, mismatch = descent.best.x, descent.best.point.advected, descent.mismatch
        for coarser, finer in pairwise(descent.levels[descent.level :]):

            def carried(
                fields: FloatArray, on: MatchingEnergy = finer.energy
            ) -> tuple[FloatArray, float]:
                functions = on.advected(fields)
                return functions, on.relative_mismatch(functions)

            x, advected = calmed(finer.energy.mesh, coarser.fields_to_finer(x), mismatch, carried)
        source, is_coarse = self.energy.terms.carried, descent.level < len(descent.levels) - 1
        worst = max(self.energy.relative_mismatch(source), 1.0)
        if is_coarse and self.energy.relative_mismatch(advected) > worst:
            return np.zeros_like(x), source  # lost on the way to the mesh itself
        return x, advected


def _start_fields(energy: MatchingEnergy, start: FloatArray) -> FloatArray:
    """Return fields (M, F, 3) in the input's units as frame coefficients (N, F, 2).

    Those of M segments are averaged over, or repeated in, the N of the energy's parameters.
    """
    averages = _averages(len(start), energy.parameters.segments)
    return to_frame(energy.mesh, np.tensordot(averages, start / energy.length_scale, 1))


def _averages(given: int, wanted: int) -> FloatArray:
    """Weights (wanted, given) that average over even parts of a time what is constant on other
    even parts.
    """
    begins, others = np.arange(wanted)[:, None] * given, np.arange(given) * wanted
    overlaps = np.minimum(begins + given, others + wanted) - np.maximum(begins, others)
    return np.asarray(np.maximum(overlaps, 0) / given)
