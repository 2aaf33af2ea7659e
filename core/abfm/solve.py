"""The stages of a match, one after the other, with their record."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import pairwise, zip_longest

import numpy as np
from numpy.typing import ArrayLike

from abfm.balance import ROUND, balanced
from abfm.calming import calmed
from abfm.confirmation import Best, Confirmation, confirmation, is_resolved, is_walked
from abfm.control import CancelledError, Control
from abfm.energy import Evaluation, MatchingEnergy
from abfm.errors import FunctionError, ParameterError
from abfm.iteration import Iteration
from abfm.levels import levels, on_the_mesh
from abfm.mesh import FloatArray
from abfm.optimizer import LBFGS, State
from abfm.schedule import MATCHED, REACHED, Stage, finish, gradual, search
from abfm.solvability import Problem, range_bound
from abfm.vector_fields import to_ambient
from abfm.warm_start import start_fields

_TOLERANCE = 1e-7  # of advection in the search, which sees no more; the gradient is exact for any
_LOST = 0.3  # mismatch of a given start beyond which the target is looked for again
_MORE = 0.2  # mismatch on the mesh itself, beyond that on the coarsest, up to which meshes between are left out
_ASTRAY = 3.0  # times the mismatch of no flow at all beyond which the way is not looked for from a given start


Kept = tuple[Best | None, State[Evaluation] | None, Stage | None]


class Solver:
    """Runs the stages of a match and keeps their record.

    Attributes
    ----------
    history : list of (total, regularity, mismatch)
        Of every iterate.
    stage_of : list of int
        Stage of every iterate.
    schedule : list of Stage
        The stages that were begun.
    unmatched : float
        What flow lines of a smooth way leave, in the unit of sigma, where they do not confirm the match; else NaN.
    """

    def __init__(
        self, energy: MatchingEnergy, on_iteration: Callable[[Iteration], None] | None, control: Control
    ) -> None:
        self.energy, self.on_iteration, self.control = energy, on_iteration, control
        self.history: list[tuple[float, float, float]] = []
        self.stage_of: list[int] = []
        self.schedule: list[Stage] = []
        self.evaluations = 0
        self.unmatched = np.nan
        self._confirmed: tuple[Confirmation, Kept] = (Confirmation(np.inf, np.inf, np.inf), (None, None, None))
        self._least = range_bound(Problem(energy.mesh, energy.source, energy.target, energy.mask, energy.weights))
        self._levels = on_the_mesh(energy)
        self._joined = len(self._levels) > 1  # whether the mesh itself comes twice
        self._reason = ""
        self._level = 0
        self._best: Best | None = None
        self._learned: State[Evaluation] | None = None
        self._recorded = 0  # level of the latest iterate
        self._before: Stage | None = None

    def run(self, start: ArrayLike | None) -> tuple[FloatArray, FloatArray, str]:
        """Fields (N, F, 2) on the mesh, the source carried by them (C, V), and why the solve stopped."""
        self._reason = "iteration limit"
        fields = None if start is None else start_fields(self.energy, start)
        try:
            if fields is not None and not self._is_lost(fields):
                self._finish(fields, warm=True)
            else:
                self._levels = levels(self._levels, self._pass)
                self._finish(self._find(fields), warm=False)
        except CancelledError:
            self._reason = "cancelled"
        return (*self._on_the_mesh(), self._reason)

    def _find(self, fields: FloatArray | None) -> FloatArray:
        """Fields on the coarsest mesh that lead at least near the target, or the best that were found."""
        coarsest, p = self._levels[0].energy, self.energy.parameters
        x = np.zeros(coarsest.shape)
        if fields is not None:
            given = self._on_the_coarsest(fields)
            mismatch, at_rest = map(coarsest.relative_mismatch, (coarsest.advected(given), coarsest.source))
            x = given if mismatch <= _ASTRAY * at_rest or not p.iterations else x
        best, least, kept = x, np.inf, self._best
        for tried in search(p, len(self._levels), self._joined):
            if len(self.history) > tried[0].until:
                break
            self._best, self._learned, self._before = None, None, None
            found = x
            try:
                for stage in tried:
                    found = self._minimise(stage, found).x
            except CancelledError:
                self._go_back(kept, least)
                raise
            mismatch = coarsest.relative_mismatch(self._known().point.advected) if tried else 0.0
            if mismatch < least:
                best, least, kept = found, mismatch, self._best
            if mismatch <= REACHED:
                break
        worst = max(coarsest.relative_mismatch(coarsest.source), 1.0)  # no flow, or a source squeezed to nothing
        if p.iterations and worst < least < np.inf:
            return np.zeros_like(best)
        return self._more_gradually(kept).x if kept is not None and least <= REACHED else best

    def _more_gradually(self, usual: Best) -> Best:
        """What was found, or what a more gradual way finds where flow lines do not confirm that and do this."""
        coarsest, way = self._levels[0].energy, gradual(self.energy.parameters, len(self._levels), self._joined)
        if not way or len(self.history) > way[0].until or not is_walked(coarsest):
            return usual
        sigma, state = way[-1].sigma, (self._best, self._learned, self._before)
        confirmed = confirmation(coarsest, usual, sigma, self._pass)
        if not confirmed.is_doubtful or not is_resolved(coarsest):
            return usual
        self._best, self._learned, self._before = None, None, None
        found = np.zeros_like(usual.x)
        try:
            for stage in way:
                found = self._minimise(stage, found).x
            smooth = confirmation(coarsest, self._known(), sigma, self._pass)
        except CancelledError:
            self._best = usual
            raise
        missed = coarsest.relative_mismatch(self._known().point.advected) > REACHED
        if missed or smooth.energy >= confirmed.energy:
            self._best, self._learned, self._before = state
            return usual
        if smooth.is_doubtful and self.energy.parameters.sigma_unit == "relative":
            self.unmatched = smooth.left
        return self._known()

    def _go_back(self, kept: Best | None, mismatch: float) -> None:
        """Return to what an earlier way to the target had found, with this mismatch, where that is better."""
        energy = self._levels[0].energy
        if self._best is None or energy.relative_mismatch(self._best.point.advected) > mismatch:
            self._best = kept

    def _finish(self, x: FloatArray, warm: bool) -> None:
        """Come close on all meshes; those between are left out where what is found holds on the mesh itself."""
        count, raised = len(self._levels), 0.0 if np.isnan(self.unmatched) else self.unmatched
        plan = finish(self.energy.parameters, count, warm, self._joined, raised)
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
        for stage, following in zip_longest(stages, stages[1:]):
            if ahead is None:
                x, known = self._prolonged(x, stage)
            else:
                x, known, ahead = ahead.x, ahead.point, None
            if self._best is not None and self._level == stage.level:
                mismatch = self._levels[stage.level].energy.relative_mismatch(self._best.point.advected)
                if mismatch <= self._attainable(stage.needed_above):
                    continue
            if stage.balanced:
                self._balance(stage)
            else:
                self._minimise(stage, x, known=known)
                if not np.isnan(self.unmatched):
                    self._confirm(stage, following)
                x = self._known().x
        return x

    def _confirm(self, stage: Stage, following: Stage | None) -> None:
        """After a stage with a raised sigma: what closing stages found stays if it matches or flow lines confirm it."""
        energy = self._levels[stage.level].energy
        if not is_walked(energy):
            return
        now = (self._best, self._learned, self._before)
        found = confirmation(energy, self._known(), stage.sigma, self._pass)
        matched = energy.relative_mismatch(self._known().point.advected) <= MATCHED
        if not stage.needed_above or found.gains(self._confirmed[0]) or (matched and found.equals(self._confirmed[0])):
            self._confirmed = (found, now)
        elif matched or following is None or following.needed_above == 0 or following.level != stage.level:
            self._best, self._learned, self._before = self._confirmed[1]

    def _ahead(self, x: FloatArray, stage: Stage) -> Best | None:
        """Fields of the coarsest mesh on that of a stage, where they leave little more than they did."""
        self._pass()
        before = self._levels[0].energy.relative_mismatch(self._known().point.advected)
        for level in self._levels[: stage.level]:
            x = level.fields_to_finer(x)
        point = self._search(stage, None).evaluate(x)
        return Best(x, point) if self.energy.relative_mismatch(point.advected) <= before + _MORE else None

    def _known(self) -> Best:
        assert self._best is not None
        return self._best

    def _is_lost(self, fields: FloatArray) -> bool:
        """Whether a start is so far from the target that the way there must be looked for."""
        if not self.energy.parameters.reach:
            return False
        advected = self.energy.advected(fields)
        if not np.isfinite(advected).all():
            raise ParameterError("start: the flow of these fields overflows; start from slower ones or from none")
        return self.energy.relative_mismatch(advected) > _LOST

    def _on_the_coarsest(self, fields: FloatArray) -> FloatArray:
        for finer, coarser in zip(self._levels[:0:-1], self._levels[-2::-1], strict=True):
            fields = coarser.fields_from_finer(to_ambient(finer.energy.mesh, fields))
        return fields

    def _prolonged(self, x: FloatArray, stage: Stage) -> tuple[FloatArray, Evaluation | None]:
        """Fields of the level that was last on that of a stage, and what is known of them if it is another."""
        if stage.level == self._level:
            return x, None
        self._pass()
        coarser, energy = self._levels[self._level], self._levels[stage.level].energy
        evaluate = self._search(stage, None).evaluate

        def mismatch(fields: FloatArray) -> tuple[Evaluation, float]:
            point = evaluate(fields)
            return point, energy.relative_mismatch(point.advected)

        before = coarser.energy.relative_mismatch(self._known().point.advected)
        return calmed(energy.mesh, coarser.fields_to_finer(x), before, mismatch)

    def _minimise(
        self, stage: Stage, x: FloatArray, target: FloatArray | None = None, known: Evaluation | None = None
    ) -> Best:
        """Run a stage to its end, from fields of which something may be known already."""
        if target is None:
            self.schedule.append(stage)
        energy = self._levels[stage.level].energy
        search = self._search(stage, target)
        self._best = Best(x, known or search.evaluate(x))
        if stage.level != self._level:  # not before: until then what is known is on the coarser mesh
            self._level, self._learned = stage.level, None
        if not self.history:
            self._check_start(self._best.point)
        if not self.history or (stage.level != self._recorded and len(self.history) <= energy.parameters.iterations):
            self._record(self._best, stage)
        self._reason = "converged"
        goal = self._attainable(stage.goal)
        if energy.relative_mismatch(self._best.point.advected) <= goal:
            return self._best
        current = self._begin(search, stage)
        energies = [current.point.energy]
        left = self._levels[stage.level].affordable(stage.iterations, x)
        until = min(stage.until, len(self.history) - 1 + left)
        ended = None
        while len(self.history) <= until and (ended := search.stop_reason(current)) is None:
            mismatch = energy.relative_mismatch(current.point.advected)
            if mismatch <= goal or not stage.pays(energies, mismatch):
                ended = "converged"
                break
            current = search.step(current)
            if current.failed:
                continue
            self._best, self._learned = Best(current.x, current.point), current
            energies.append(current.point.energy)
            self._record(self._best, stage, current)
        self._reason = ended or "iteration limit"
        return self._best

    def _attainable(self, goal: float) -> float:
        """A goal, or what the values of source and target leave of it; 0 stays 0."""
        return max(goal, self._least) if goal else 0.0

    def _begin(self, search: LBFGS[Evaluation], stage: Stage) -> State[Evaluation]:
        """The stage's first iterate; what the one before has learned of the energy is scaled with sigma.

        Stages that go on to the end of their iterations learn anew, which on the long way leads further.
        """
        before, best = self._before, self._known()
        self._before = stage
        if before is None or before.level != stage.level or before.reach != stage.reach:
            return search.init(best.x, best.point)
        if stage.patient and before.sigma != stage.sigma:
            return search.init(best.x, best.point)
        return search.init(best.x, best.point, self._learned, (before.sigma / stage.sigma) ** 2)

    def _balance(self, stage: Stage) -> None:
        """Weigh flow lines against the discrete advection; why the match ended before stays the reason."""
        if not is_walked(self.energy):
            return
        reason, part = self._reason, replace(stage, iterations=ROUND, patient=True, goal=0.0)
        self.schedule.append(stage)

        def go_on(x: FloatArray, target: FloatArray) -> Best | None:
            is_over = len(self.history) > self.energy.parameters.iterations
            return None if is_over else self._minimise(part, x, target)

        self._best = balanced(self._levels[stage.level].energy, self._known(), go_on, self._pass)
        self._reason = reason

    def _on_the_mesh(self) -> tuple[FloatArray, FloatArray]:
        """The best fields on the mesh itself, and the source carried by them."""
        here = self._levels[self._level].energy
        if self._best is None:
            return np.zeros(self.energy.shape), self.energy.source
        x, advected = self._best.x, self._best.point.advected
        mismatch = here.relative_mismatch(advected)
        for coarser, finer in pairwise(self._levels[self._level :]):

            def carried(fields: FloatArray, on: MatchingEnergy = finer.energy) -> tuple[FloatArray, float]:
                functions = on.advected(fields)
                return functions, on.relative_mismatch(functions)

            x, advected = calmed(finer.energy.mesh, coarser.fields_to_finer(x), mismatch, carried)
        return x, advected

    def _pass(self) -> None:
        """Wait while paused, end when cancelled; what has nothing to show yet goes on to its first evaluation."""
        if self.history:
            self.control.wait()

    def _search(self, stage: Stage, target: FloatArray | None) -> LBFGS[Evaluation]:
        p, energy = self.energy.parameters, self._levels[stage.level].energy

        def evaluate(x: FloatArray) -> Evaluation:
            if self.evaluations:
                self.control.wait()
            self.evaluations += 1
            return energy.evaluate(x, stage.sigma, stage.reach, target, _TOLERANCE)

        def inverse(gradient: FloatArray) -> FloatArray:
            return np.stack([energy.regularizer.inverse(momentum) for momentum in gradient]) / energy.step

        def displacement(fields: FloatArray) -> float:
            return energy.step * float(np.sqrt((fields**2).sum(axis=-1)).max(axis=-1).sum())

        return LBFGS(
            evaluate,
            inverse if p.preconditioner == "hodge" else None,
            p.memory,
            displacement,
            p.max_displacement,
            p.tolerance,
        )

    def _check_start(self, point: Evaluation) -> None:
        if not np.isfinite([point.energy, self.energy.function_size]).all():
            raise FunctionError("the mismatch of source and target overflows; scale both functions down or sigma up")

    def _record(self, best: Best, stage: Stage, step: State[Evaluation] | None = None) -> None:
        point, self._recorded = best.point, stage.level
        self.history.append((point.energy, point.regularity, point.mismatch))
        self.stage_of.append(len(self.schedule) - 1)
        if self.on_iteration:
            level = self._levels[stage.level]
            self.on_iteration(
                Iteration(
                    iteration=len(self.history) - 1,
                    stage=len(self.schedule) - 1,
                    level=stage.level,
                    levels=len(self._levels),
                    vertices=level.energy.vertex_count,
                    reach=stage.reach,
                    sigma=stage.sigma,
                    energy=point.energy,
                    regularity=point.regularity,
                    mismatch_energy=point.mismatch,
                    mismatch=level.energy.relative_mismatch(point.advected),
                    gradient_norm=step.gradient_norm if step else np.nan,
                    step_length=step.length if step else 0.0,
                    evaluations=self.evaluations,
                    _velocity=partial(self._shown_velocity, stage.level, best.x),
                    _advected=partial(self._shown_functions, stage.level, point.advected),
                )
            )

    def _shown_velocity(self, level: int, x: FloatArray) -> FloatArray:
        for each in self._levels[level:-1]:
            x = each.fields_to_finer(x)
        return to_ambient(self.energy.mesh, x) * self.energy.length_scale

    def _shown_functions(self, level: int, functions: FloatArray) -> FloatArray:
        for each in self._levels[level:-1]:
            functions = each.functions_to_finer(functions)
        return functions.T.copy()
