"""The course of a match: the target is found on the coarsest mesh, then the match comes close on the others."""

from collections.abc import Callable
from itertools import pairwise, zip_longest

import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.vector_fields import to_ambient, to_frame
from abfm.errors import ParameterError
from abfm.matching.energy.energy import Evaluation, MatchingEnergy, check_fields
from abfm.matching.judging.confirmation import Best, Confirmation, confirmation, is_resolved, is_walked
from abfm.matching.judging.verdict import OUT_OF_MEMORY
from abfm.matching.schedule import MATCHED, REACHED, Stage, finish, gradual, search
from abfm.matching.solving.calming import calmed
from abfm.matching.solving.control import CancelledError, Control
from abfm.matching.solving.descent import Descent, Progress
from abfm.matching.solving.levels import levels
from abfm.matching.solving.record import Iteration, Record
from abfm.real_numbers import real_numbers
from abfm.types import FloatArray

_LOST = 0.3  # mismatch of a given start beyond which the target is looked for again
_MORE = 0.2  # mismatch on the mesh itself, beyond that on the coarsest, up to which meshes between are left out
_UNSTABLE = 1e8  # times the source's values, beyond which squares round off what the target is: nothing leads to it
_ASTRAY = 3.0  # times the mismatch of no flow at all beyond which the way is not looked for from a given start
_UNKNOWN = Confirmation(np.inf, np.inf, np.inf)


class Solver:
    """Decides which stages a match goes through, and what is kept of them."""

    def __init__(
        self, energy: MatchingEnergy, on_iteration: Callable[[Iteration], None] | None, control: Control
    ) -> None:
        self.energy = energy
        record = Record(on_iteration)
        self.history, self.stage_of, self.schedule = record.history, record.stage_of, record.schedule
        self.unmatched = np.nan  # what flow lines of a smooth way leave, in sigmas, where they do not confirm the match
        self._alpha = energy.parameters.alpha  # with which the target was found
        self._held = _UNKNOWN, Progress()  # what flow lines said last where sigma was raised
        self._descent = Descent(energy, record, control)
        self._joined = len(self._descent.levels) > 1  # whether the mesh itself comes twice

    def run(self, start: ArrayLike | None) -> tuple[FloatArray, FloatArray, str]:
        """Fields (N, F, 2) on the mesh, the source carried by them (C, V), and why the solve stopped."""
        descent = self._descent
        fields = None if start is None else _start_fields(self.energy, start)
        try:
            if fields is not None and not self._is_lost(fields):
                self._finish(fields, warm=True)
            else:
                descent.levels = levels(descent.levels, descent.wait)
                self._finish(self._find(fields), warm=False)
        except CancelledError:
            return (*self._on_the_mesh(), "cancelled")
        except MemoryError:
            if not self.history:
                raise
            return (*self._on_the_mesh(), OUT_OF_MEMORY)
        return (*self._on_the_mesh(), descent.reason)

    def _is_lost(self, fields: FloatArray) -> bool:
        """Whether a start is so far from the target that the way there must be looked for."""
        advected, source = self.energy.advected(fields), self.energy.source
        if not np.isfinite(advected).all():
            raise ParameterError("start: the flow of these fields overflows; start from slower ones or from none")
        if self.energy.parameters.reach:
            return self.energy.relative_mismatch(advected) > _LOST
        largest, grown = float(np.abs(source).max()), float(np.abs(advected).max())
        if grown > _UNSTABLE * largest:
            raise ParameterError(
                f"start: the discrete flow of these fields is unstable, as it makes values of up to {grown:.3g} of "
                f"those of up to {largest:.3g}; start from slower fields or from none"
            )
        return False

    def _find(self, fields: FloatArray | None) -> FloatArray:
        """Fields on the coarsest mesh that lead at least near the target, or the best that were found."""
        descent, p = self._descent, self.energy.parameters
        coarsest = descent.levels[0].energy
        x = np.zeros(coarsest.shape)
        if fields is not None:
            given = self._on_the_coarsest(fields)
            mismatch, at_rest = map(coarsest.relative_mismatch, (coarsest.advected(given), coarsest.source))
            x = given if mismatch <= _ASTRAY * at_rest or not p.iterations else x
        best, least, kept = x, np.inf, descent.progress.best
        for way in search(p, len(descent.levels), self._joined):
            if len(self.history) > way.stages[0].until:
                break
            descent.progress = Progress()
            found = x
            try:
                for stage in way.stages:
                    found = descent.minimise(stage, found).x
            except CancelledError:
                self._go_back(kept, least)
                raise
            if descent.mismatch < least:
                best, least, kept = found, descent.mismatch, descent.progress.best
                self._alpha = way.stages[0].alpha
            if descent.mismatch <= way.found:
                break
        worst = max(coarsest.relative_mismatch(coarsest.source), 1.0)  # no flow, or a source squeezed to nothing
        if p.iterations and worst < least < np.inf:
            return np.zeros_like(best)
        return self._more_gradually(kept).x if kept is not None and least <= REACHED else best

    def _on_the_coarsest(self, fields: FloatArray) -> FloatArray:
        meshes = self._descent.levels
        for finer, coarser in zip(meshes[:0:-1], meshes[-2::-1], strict=True):
            fields = coarser.fields_from_finer(to_ambient(finer.energy.mesh, fields))
        return fields

    def _go_back(self, kept: Best | None, mismatch: float) -> None:
        """Return to what an earlier way to the target had found, with this mismatch, where that is better."""
        descent = self._descent
        if descent.progress.best is None or descent.mismatch > mismatch:
            descent.progress = Progress(kept)

    def _more_gradually(self, usual: Best) -> Best:
        """What was found, or what a more gradual way finds where flow lines do not confirm that and do this."""
        descent, p = self._descent, self.energy.parameters
        coarsest, way = descent.levels[0].energy, gradual(p, len(descent.levels), self._joined)
        if not way or len(self.history) > way[0].until or not is_walked(coarsest):
            return usual
        sigma, progress = way[-1].sigma, descent.progress
        confirmed = confirmation(coarsest, descent.at(way[-1], usual.x), sigma, descent.wait)
        if not confirmed.is_doubtful or not is_resolved(coarsest):
            return usual
        descent.progress = Progress()
        found = np.zeros_like(usual.x)
        try:
            for stage in way:
                found = descent.minimise(stage, found).x
            smooth = confirmation(coarsest, descent.best, sigma, descent.wait)
        except CancelledError:
            descent.progress = Progress(usual)
            raise
        if descent.mismatch > REACHED or not smooth.is_as_low(confirmed):
            descent.progress = progress
            return usual
        self._alpha = way[-1].alpha
        if smooth.is_doubtful and p.sigma_unit == "relative":
            self.unmatched = smooth.left
        return descent.best

    def _finish(self, x: FloatArray, warm: bool) -> None:
        """Come close on all meshes; those between are left out where what is found holds on the mesh itself."""
        count, raised = len(self._descent.levels), 0.0 if np.isnan(self.unmatched) else self.unmatched
        plan = finish(self.energy.parameters, count, warm, self._joined, raised, self._alpha)
        top = count - 1 - self._joined
        last = [stage for stage in plan if stage.level >= top]
        x = self._through([stage for stage in plan if stage.level == 0 < top], x)
        between = [stage for stage in plan if 0 < stage.level < top]
        ahead = self._ahead(x, last[0]) if between else None
        if ahead is None:
            x = self._through(between, x)
        self._through(last, x, ahead)

    def _through(self, stages: list[Stage], x: FloatArray, ahead: Best | None = None) -> FloatArray:
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

    def _confirmed(self, stage: Stage, x: FloatArray, known: Evaluation | None, is_end: bool) -> Best:
        """Run a stage where sigma was raised.

        What closing stages find stays where flow lines leave less, or where it matches and they leave about as much;
        else it is undone once it matches or the last one ends.
        """
        descent = self._descent
        energy, is_closing = descent.levels[stage.level].energy, stage.needed_above > 0
        if is_closing and not is_walked(energy):
            return descent.best
        try:
            found = descent.minimise(stage, x, known=known)
            now = confirmation(energy, found, stage.sigma, descent.wait) if is_walked(energy) else _UNKNOWN
        except CancelledError:
            if is_closing:
                descent.progress = self._held[1]
            raise
        before, matches = self._held[0], descent.mismatch <= descent.attainable(MATCHED)
        if not is_closing or now.gains(before) or (matches and now.equals(before)):
            self._held = now, descent.progress
        elif matches or is_end:
            descent.progress = self._held[1]
        return descent.best

    def _ahead(self, x: FloatArray, stage: Stage) -> Best | None:
        """Fields of the coarsest mesh on that of a stage, where they leave little more than they did."""
        descent = self._descent
        descent.wait()
        for level in descent.levels[: stage.level]:
            x = level.fields_to_finer(x)
        found = descent.at(stage, x)
        return found if self.energy.relative_mismatch(found.point.advected) <= descent.mismatch + _MORE else None

    def _on_the_mesh(self) -> tuple[FloatArray, FloatArray]:
        """The best fields on the mesh itself, and the source carried by them."""
        descent = self._descent
        if descent.progress.best is None:
            return np.zeros(self.energy.shape), self.energy.source
        x, advected, mismatch = descent.best.x, descent.best.point.advected, descent.mismatch
        for coarser, finer in pairwise(descent.levels[descent.level :]):

            def carried(fields: FloatArray, on: MatchingEnergy = finer.energy) -> tuple[FloatArray, float]:
                functions = on.advected(fields)
                return functions, on.relative_mismatch(functions)

            x, advected = calmed(finer.energy.mesh, coarser.fields_to_finer(x), mismatch, carried)
        at_rest = self.energy.relative_mismatch(self.energy.source)
        if descent.level < len(descent.levels) - 1 and self.energy.relative_mismatch(advected) > max(at_rest, 1.0):
            return np.zeros_like(x), self.energy.source  # lost on the way to the mesh itself
        return x, advected


def _start_fields(energy: MatchingEnergy, start: ArrayLike) -> FloatArray:
    """Given fields (F, 3) or (M, F, 3) in the input's units as frame coefficients (N, F, 2).

    Those of M segments are averaged over, or repeated in, the N of the energy's parameters.
    """
    given = real_numbers(start, "start", ParameterError)
    count = max(len(given), 1) if given.ndim == 3 else 1
    fields = check_fields(given, (count, *energy.shape[1:]), "start") / energy.length_scale
    return to_frame(energy.mesh, np.tensordot(_averages(count, energy.parameters.segments), fields, 1))


def _averages(given: int, wanted: int) -> FloatArray:
    """Weights (wanted, given) that average over even parts of a time what is constant on other even parts."""
    begins, others = np.arange(wanted)[:, None] * given, np.arange(given) * wanted
    overlaps = np.minimum(begins + given, others + wanted) - np.maximum(begins, others)
    return np.asarray(np.maximum(overlaps, 0) / given)
