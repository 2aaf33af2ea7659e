"""One stage of a match after the other: down in energy, from one mesh to the next, towards flow lines."""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from abfm.errors import FunctionError
from abfm.matching.energy.energy import Evaluation, MatchingEnergy
from abfm.matching.judging.confirmation import Best, is_walked
from abfm.matching.judging.solvability import range_bound
from abfm.matching.schedule import Stage
from abfm.matching.solving.balance import ROUND, balanced
from abfm.matching.solving.calming import calmed
from abfm.matching.solving.control import Control
from abfm.matching.solving.levels import on_the_mesh
from abfm.matching.solving.record import Record
from abfm.numerics.optimizer import LBFGS, State
from abfm.types import FloatArray

_TOLERANCE = 1e-7  # of advection in the search, which sees no more; the gradient is exact for any


@dataclass(frozen=True)
class Progress:
    """What a descent goes on from.

    Attributes
    ----------
    best : Best, optional
        On the level of the latest stage.
    learned : State, optional
        The iterate whose pairs tell how the energy bends there.
    before : Stage, optional
        The latest one that was minimised.
    """

    best: Best | None = None
    learned: State[Evaluation] | None = None
    before: Stage | None = None


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
    wait : callable
        Waits while paused, ends when cancelled; what has nothing to show yet goes on to its first evaluation.
    """

    def __init__(self, energy: MatchingEnergy, record: Record, control: Control) -> None:
        self.levels = on_the_mesh(energy)
        self.level = 0  # that of the latest stage
        self.progress = Progress()  # may be set to what it was before on the same level, or to begin anew
        self.reason = "iteration limit"  # why the latest stage ended
        self.wait = partial(_wait, record, control)  # not of this descent: evaluations keep it, and it keeps them
        self._parameters, self._record, self._control = energy.parameters, record, control
        self._least = range_bound(energy)

    @property
    def best(self) -> Best:
        """What is known to be best; there must be something."""
        assert self.progress.best is not None
        return self.progress.best

    @property
    def mismatch(self) -> float:
        """Relative mismatch of the best on its level."""
        return self.levels[self.level].energy.relative_mismatch(self.best.point.advected)

    def attainable(self, goal: float) -> float:
        """A goal, or what the values of source and target leave of it; 0 stays 0."""
        return max(goal, self._least) if goal else 0.0

    def at(self, stage: Stage, x: FloatArray) -> Best:
        """Fields of a stage's level as a start that it may begin with."""
        return Best(x, self._search(stage, None).evaluate(x))

    def prolonged(self, x: FloatArray, stage: Stage) -> tuple[FloatArray, Evaluation | None]:
        """Fields of the level that was last on that of a stage, and what is known of them if it is another."""
        if stage.level == self.level:
            return x, None
        self.wait()
        energy = self.levels[stage.level].energy
        evaluate = self._search(stage, None).evaluate

        def mismatch(fields: FloatArray) -> tuple[Evaluation, float]:
            point = evaluate(fields)
            return point, energy.relative_mismatch(point.advected)

        return calmed(energy.mesh, self.levels[self.level].fields_to_finer(x), self.mismatch, mismatch)

    def minimise(
        self, stage: Stage, x: FloatArray, target: FloatArray | None = None, known: Evaluation | None = None
    ) -> Best:
        """Run a stage to its end, from fields of which something may be known already; towards g, or a target (C, V).

        Only stages towards g come into the record's schedule.
        """
        if target is None:
            self._record.schedule.append(stage)
        search = self._search(stage, target)
        self._arrive(stage, Best(x, known or search.evaluate(x)))
        self.reason = "converged"
        goal = self.attainable(stage.goal)
        if self.mismatch <= goal:
            return self.best
        current, history = self._first(search, stage), self._record.history
        energies = [current.point.energy]
        left = self.levels[stage.level].affordable(stage.iterations, x)
        until = min(stage.until, len(history) - 1 + left)
        ended = None
        while len(history) <= until and (ended := search.stop_reason(current)) is None:
            if self.mismatch <= goal or not stage.pays(energies):
                ended = "converged"
                break
            current = search.step(current)
            if current.failed:
                continue
            self.progress = Progress(Best(current.x, current.point), current, stage)
            energies.append(current.point.energy)
            self._record.add(self.levels, stage, self.best)
        self.reason = ended or "iteration limit"
        return self.best

    def balance(self, stage: Stage) -> Best:
        """Weigh flow lines against the discrete advection; why the match ended before stays the reason."""
        energy = self.levels[stage.level].energy
        if not is_walked(energy):
            return self.best
        reason, part = self.reason, replace(stage, iterations=ROUND, patient=True, goal=0.0)
        self._record.schedule.append(stage)

        def go_on(x: FloatArray, target: FloatArray) -> Best | None:
            is_over = len(self._record.history) > stage.until
            return None if is_over else self.minimise(part, x, target)

        self.progress = replace(self.progress, best=balanced(energy, self.best, go_on, self.wait))
        self.reason = reason
        return self.best

    def _arrive(self, stage: Stage, best: Best) -> None:
        """Take fields as the best on a stage's level; where a level begins they are an iterate of their own."""
        self.progress = replace(self.progress, best=best)
        if stage.level != self.level:  # not before: until then what is known is on the coarser mesh
            self.level, self.progress = stage.level, replace(self.progress, learned=None)
        history = self._record.history
        if not history and not np.isfinite([best.point.energy, self.levels[-1].energy.function_size]).all():
            raise FunctionError("the mismatch of source and target overflows; scale both functions down or sigma up")
        if not history or (not self._record.ends_on(stage.level) and len(history) <= self._parameters.iterations):
            self._record.add(self.levels, stage, best)

    def _first(self, search: LBFGS[Evaluation], stage: Stage) -> State[Evaluation]:
        """The stage's first iterate; what the one before has learned of the energy is scaled with sigma.

        Stages that go on to the end of their iterations learn anew, which on the long way leads further.
        """
        before, best, learned = self.progress.before, self.best, self.progress.learned
        self.progress = replace(self.progress, before=stage)
        if before is None or (before.level, before.reach, before.alpha) != (stage.level, stage.reach, stage.alpha):
            return search.init(best.x, best.point)
        if stage.patient and before.sigma != stage.sigma:
            return search.init(best.x, best.point)
        return search.init(best.x, best.point, learned, (before.sigma / stage.sigma) ** 2)

    def _search(self, stage: Stage, target: FloatArray | None) -> LBFGS[Evaluation]:
        p, energy = self._parameters, self.levels[stage.level].energy
        regularizer = energy.regularizer(stage.alpha)

        def evaluate(x: FloatArray) -> Evaluation:
            if self._record.evaluations:
                self._control.wait()
            self._record.evaluations += 1
            return energy.evaluate(x, stage.sigma, stage.reach, target, _TOLERANCE, stage.alpha, self.wait)

        def inverse(gradient: FloatArray) -> FloatArray:
            return np.stack([regularizer.inverse(momentum) for momentum in gradient]) / energy.step

        def displacement(fields: FloatArray) -> float:
            return energy.step * float(np.sqrt((fields**2).sum(axis=-1)).max(axis=-1).sum())

        precondition = inverse if p.preconditioner == "hodge" else None
        return LBFGS(evaluate, precondition, p.memory, displacement, p.max_displacement, p.tolerance)


def _wait(record: Record, control: Control) -> None:
    if record.history:
        control.wait()
