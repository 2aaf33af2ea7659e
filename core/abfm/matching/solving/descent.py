"""One stage of a match after the other: down in energy, from one mesh to the next, towards flow
lines.
"""

from dataclasses import replace

import numpy as np

from abfm.errors import FunctionError
from abfm.matching.objective.matching_energy import MatchingEnergy
from abfm.matching.objective.objective import Evaluation
from abfm.matching.solving.balance import ROUND, balanced
from abfm.matching.solving.calming import calmed
from abfm.matching.solving.confirmation import is_walked
from abfm.matching.solving.incumbent import Candidate, Incumbent, Progress
from abfm.matching.solving.levels import on_the_mesh
from abfm.matching.solving.range_bound import range_bound
from abfm.matching.solving.record import Record
from abfm.matching.solving.schedule import Stage
from abfm.matching.solving.stop_reason import StopReason
from abfm.numerics.optimizer import LBFGS, State
from abfm.types import FloatArray
from abfm.workers.control import checkpoint

_TOLERANCE = 1e-7  # of advection in the search, which sees no more; the gradient is exact for any


class Descent:
    """Runs stages; what is to come of them is for the caller to say.

    Attributes
    ----------
    levels : list of Level
        At first those with the mesh itself.
    level : int
        Where the latest stage was.
    progress : Progress
        May be set to what it was before, on the same level, or to ``Progress()`` to begin anew.
    reason : str
        Why the latest stage ended.
    """

    def __init__(self, energy: MatchingEnergy, record: Record) -> None:
        self.levels = on_the_mesh(energy)
        self.level = 0  # that of the latest stage
        # may be set to what it was before on the same level, or to begin anew
        self.progress = Progress()
        self.reason = StopReason.ITERATION_LIMIT  # why the latest stage ended
        self._parameters, self._record = energy.parameters, record
        self._least = range_bound(energy.functions)

    @property
    def best(self) -> Candidate:
        """What is known to be best; there must be something."""
        assert self.progress.best is not None
        return self.progress.best

    @property
    def mismatch(self) -> float:
        """Relative mismatch of the best on its level."""
        return self.mismatch_of(self.best)

    def mismatch_of(self, candidate: Candidate) -> float:
        """Return the relative mismatch of a candidate on the level of the latest stage."""
        return self.levels[self.level].energy.relative_mismatch(candidate.point.advected)

    def attainable(self, goal: float) -> float:
        """A goal, or what the values of source and target leave of it; 0 stays 0."""
        return max(goal, self._least) if goal else 0.0

    def at(self, stage: Stage, x: FloatArray) -> Candidate:
        """Fields of a stage's level as a start that it may begin with."""
        return Candidate(x, self._search(stage).evaluate(x))

    def prolonged(self, x: FloatArray, stage: Stage) -> tuple[FloatArray, Evaluation | None]:
        """Fields of the level that was last on that of a stage, and what is known of them if it
        is another.
        """
        if stage.level == self.level:
            return x, None
        checkpoint()
        energy = self.levels[stage.level].energy
        evaluate = self._search(stage).evaluate

        def mismatch(fields: FloatArray) -> tuple[Evaluation, float]:
            point = evaluate(fields)
            return point, energy.relative_mismatch(point.advected)

        return calmed(
            energy.mesh, self.levels[self.level].fields_to_finer(x), self.mismatch, mismatch
        )

    def minimise(
        self,
        stage: Stage,
        x: FloatArray,
        offset: FloatArray | None = None,
        known: Evaluation | None = None,
    ) -> Candidate:
        """Run a stage to its end, from fields of which something may be known already.

        Only stages without an offset (C, V), which may be left, come into the record's schedule.
        """
        if offset is None:
            self._record.schedule.append(stage)
        search = self._search(stage, offset)
        self._arrive(stage, Candidate(x, known or search.evaluate(x)))
        self.reason = StopReason.GOAL_REACHED
        goal = self.attainable(stage.goal)
        if self.mismatch <= goal:
            return self.best
        current, history = self._first(search, stage), self._record.history
        energies = [current.point.energy]
        left = self.levels[stage.level].affordable(stage.iterations, x)
        until = min(stage.until, len(history) - 1 + left)
        self.reason = StopReason.ITERATION_LIMIT
        while len(history) <= until:
            reason = self._reason_to_stop(stage, goal, energies, search.stop_reason(current))
            if reason is not None:
                self.reason = reason
                break
            current = search.step(current)
            if current.failed:
                continue
            self.progress = Progress(Candidate(current.x, current.point), current, stage)
            energies.append(current.point.energy)
            self._record.add(self.levels, stage, self.best)
        return self.best

    def _reason_to_stop(
        self, stage: Stage, goal: float, energies: list[float], search: str | None
    ) -> StopReason | None:
        """Return why a stage ends at an iterate, for that of the search; None to go on."""
        if search is not None:
            return StopReason(search)
        if self.mismatch <= goal:
            return StopReason.GOAL_REACHED
        return None if stage.pays(energies) else StopReason.NO_PROGRESS

    def balance(self, stage: Stage) -> Candidate:
        """Weigh flow lines against the discrete advection; why the match ended before stays the
        reason.
        """
        energy = self.levels[stage.level].energy
        if not is_walked(energy):
            return self.best
        reason, part = self.reason, replace(stage, iterations=ROUND, patient=True, goal=0.0)
        self._record.schedule.append(stage)

        def go_on(x: FloatArray, offset: FloatArray) -> Candidate | None:
            is_over = len(self._record.history) > stage.until
            return None if is_over else self.minimise(part, x, offset)

        with Incumbent(self, self.progress) as incumbent:
            for best in balanced(energy, self.best, go_on):
                incumbent.progress = replace(self.progress, best=best)
        self.progress = replace(self.progress, best=incumbent.progress.best)
        self.reason = reason
        return self.best

    def _arrive(self, stage: Stage, best: Candidate) -> None:
        """Take fields as the best on a stage's level; where a level begins they are an iterate
        of their own.
        """
        self.progress = replace(self.progress, best=best)
        if stage.level != self.level:  # not before: until then what is known is on the coarser mesh
            self.level, self.progress = stage.level, replace(self.progress, learned=None)
        history = self._record.history
        sizes = best.point.energy, self.levels[-1].energy.functions.function_size
        if not history and not np.isfinite(sizes).all():
            raise FunctionError(
                "the mismatch of source and target overflows; scale both functions down or sigma up"
            )
        is_new = not self._record.ends_on(stage.level)
        if not history or (is_new and len(history) <= self._parameters.iterations):
            self._record.add(self.levels, stage, best)

    def _first(self, search: LBFGS[Evaluation], stage: Stage) -> State[Evaluation]:
        """Return the first iterate; what the stage before has learned is scaled with sigma."""
        before, best, learned = self.progress.before, self.best, self.progress.learned
        self.progress = replace(self.progress, before=stage)
        if before is None or not stage.continues(before):
            return search.init(best.x, best.point)
        return search.init(best.x, best.point, learned, (before.sigma / stage.sigma) ** 2)

    def _search(self, stage: Stage, offset: FloatArray | None = None) -> LBFGS[Evaluation]:
        p, energy = self._parameters, self.levels[stage.level].energy
        objective = energy.objective(
            stage.sigma, stage.reach, alpha=stage.alpha, offset=offset, tolerance=_TOLERANCE
        )
        regularity, step = objective.regularity, energy.step

        def evaluate(x: FloatArray) -> Evaluation:
            checkpoint()
            self._record.evaluations += 1
            return objective.evaluate(x)

        def inverse(gradient: FloatArray) -> FloatArray:
            return np.stack([regularity.inverse(momentum) for momentum in gradient]) / step

        def displacement(fields: FloatArray) -> float:
            return step * float(np.sqrt((fields**2).sum(axis=-1)).max(axis=-1).sum())

        precondition = inverse if p.preconditioner == "hodge" else None
        return LBFGS(
            evaluate, precondition, p.memory, displacement, p.max_displacement, p.tolerance
        )
