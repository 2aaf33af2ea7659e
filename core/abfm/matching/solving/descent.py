"""One stage of a match after the other: down in energy, from one mesh to the next."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeAlias, TypeVar

import numpy as np

from abfm.errors import FunctionError
from abfm.matching.objective.matching_energy import Evaluation, MatchingEnergy
from abfm.matching.objective.regularizer import Regularizer
from abfm.matching.solvability import range_bound
from abfm.matching.solving.course import Stage, falls
from abfm.matching.solving.levels import Subdivision, on_the_mesh
from abfm.matching.solving.newton import GaussNewton, Inverse, with_landmarks
from abfm.matching.solving.record import Record, StopReason
from abfm.mesh import TriangleMesh
from abfm.numerics.optimizer import LBFGS
from abfm.types import FloatArray
from abfm.workers.control import checkpoint

_TOLERANCE = 1e-7  # of advection in the search, which sees no more; the gradient is exact for any
# of fields from a coarser mesh: times the mismatch there, and more, which is not the field's doing
_WORSE, _GROWN = 2.0, 0.4
_SCALES = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0)  # edges over which they are smoothed

# iterations after which how landmarks bend the energy is computed anew, beside functions
_ANEW = 10
# a fold goes on while its energy falls by this share within so many iterations
_FOLD_FALL_MIN = 0.2
_FOLD_ITERATIONS = 4
_MOST_BENT = 5e7  # numbers kept of that

Point = TypeVar("Point")
Search: TypeAlias = GaussNewton | LBFGS[Evaluation]


@dataclass(frozen=True)
class Progress:
    best: Evaluation | None = None  # on the level of the latest stage
    learned: Any = None  # the search's state, whose pairs tell how the energy bends there
    before: Stage | None = None  # the latest one that was minimised

    @property
    def fields(self) -> FloatArray:
        """The best fields, (N, F, 2)."""
        assert self.best is not None
        return self.best.x


class Descent:
    """Runs stages; ``progress`` may be set to what it was on the same level, or to begin anew."""

    def __init__(self, energy: MatchingEnergy, record: Record) -> None:
        self.levels = on_the_mesh(energy)
        self.level = 0  # that of the latest stage
        self.progress = Progress()
        self.reason = StopReason.ITERATION_LIMIT  # why the latest stage ended
        self.effort, self.limit = 0.0, np.inf  # of all evaluations so far, and at most, see `cost`
        self._parameters, self._record = energy.parameters, record
        self.own = len(self.levels) - 1  # that of the mesh itself
        self._least = range_bound(energy.functions)

    @property
    def best(self) -> Evaluation:
        assert self.progress.best is not None
        return self.progress.best

    @property
    def residual(self) -> float:
        return self.levels[self.level].energy.left(self.best)

    def cheapest(self, level: int) -> int:
        """Return the first level on the same mesh, with clusters where they are cheaper."""
        return level - (self.levels[level].cheaper is not None)

    def exact(self, level: int) -> int:
        """Return the last level on the same mesh, without clusters."""
        is_clustered = level + 1 < len(self.levels) and self.levels[level + 1].cheaper is not None
        return level + is_clustered

    def error(self, level: int) -> float:
        """Return the discretisation error of a level relative to the mesh itself.

        It is what source or target lose on the level and back, whichever is larger, measured as a
        residual; 0 on the mesh itself.
        """
        if level >= self.own:
            return 0.0
        functions = self.levels[level].energy.functions
        fine = self.levels[self.own].energy.functions
        errors = []
        for coarse, own in ((functions.source, fine.source), (functions.target, fine.target)):
            for between in self.levels[level : self.own]:
                coarse = between.functions_to_finer(coarse)
            errors.append(fine.relative_size(coarse - own))
        return max(errors)

    def attainable(self, goal: float) -> float:
        return max(goal, self._least) if goal else 0.0

    def at(self, stage: Stage, x: FloatArray) -> Evaluation:
        return self._search(stage).evaluate(x)

    def prolonged(self, x: FloatArray, level: int, stage: Stage, residual: float) -> Evaluation:
        """Bring fields (N, F, 2) of a level with this residual to the level of a stage.

        Fields of a coarser mesh have kinks over its edges, which make the norm of second order
        large. Those of a subdivided mesh, or of a given sigma, are smoothed while that lowers the
        energy.
        """
        energy, evaluate = self.levels[stage.level].energy, self._search(stage).evaluate

        def measured(fields: FloatArray) -> tuple[Evaluation, float]:
            point = evaluate(fields)
            return point, energy.left(point)

        found = self._brought(x, level, stage.level, residual, measured)
        p, first = self._parameters, self.cheapest(stage.level)
        is_subdivided = isinstance(self.levels[first - 1].to_finer, Subdivision)
        is_rough = level < first and p.solver.order > 1 and p.sigma is not None
        for edges in _SCALES[1:] if is_subdivided or is_rough else ():
            tried = evaluate(smoothed(energy.mesh, found.x, edges))
            if not tried.energy < found.energy:
                break
            found = tried
        return found

    def kept(
        self, x: FloatArray, level: int, to: int, residual: float
    ) -> tuple[FloatArray, FloatArray]:
        """The same with no gradient, which takes memory; return fields and what they carry."""
        energy = self.levels[to].energy

        def measured(fields: FloatArray) -> tuple[tuple[FloatArray, FloatArray], float]:
            carried = energy.advected(fields)
            return (fields, carried), energy.left_by(fields, carried)

        return self._brought(x, level, to, residual, measured)

    def _brought(
        self,
        x: FloatArray,
        level: int,
        to: int,
        residual: float,
        measured: Callable[[FloatArray], tuple[Point, float]],
    ) -> Point:
        checkpoint()
        for coarser in self.levels[level:to]:
            x = coarser.fields_to_finer(x)
        return calmed(self.levels[to].energy.mesh, x, residual, measured)

    def minimise(self, stage: Stage, start: FloatArray | Evaluation) -> Evaluation:
        """Run a stage to its end."""
        self._record.schedule.append(stage)
        search = self._search(stage)
        self._arrive(stage, start if isinstance(start, Evaluation) else search.evaluate(start))
        self.reason = StopReason.GOAL_REACHED
        goal = self.attainable(stage.goal)
        if self._left(stage) <= goal:
            return self.best
        current, history = self._first(search, stage), self._record.history
        energy = self.levels[stage.level].energy
        has_landmarks = energy.landmarks is not None and not energy.is_of_landmarks
        least = self.best
        energies, residuals = [current.point.energy], [self._left(stage)]
        left = self.levels[stage.level].affordable(stage.iterations, self.best.x)
        until, counted = min(stage.until, len(history) - 1 + left), self._record.evaluations
        is_last = stage.until <= len(history) - 1 + left or stage.fixed
        self.reason = StopReason.ITERATION_LIMIT if is_last else StopReason.NO_PROGRESS
        while len(history) <= until:
            reason = self._reason_to_stop(
                stage, goal, energies, residuals, search.stop_reason(current)
            )
            if reason is not None:
                self.reason = reason
                break
            if has_landmarks and (len(energies) - 1) % _ANEW == 0:
                search = self._search(stage, current.x)
                current = search.init(current.x, current.point)
            current = search.step(current)
            evaluations, counted = self._record.evaluations - counted, self._record.evaluations
            if self.limit < np.inf:  # else nothing depends on it
                self.effort += evaluations * self.cost(stage.level, self.best.x)
            if current.failed:
                continue
            self.progress = Progress(current.point, current, stage)
            energies.append(min(energies[-1], current.point.energy))
            residuals.append(self._left(stage))
            self._record.add(self.levels, self.own, stage, self.best)
            if self.best.energy <= least.energy:
                least = self.best
        if least.energy < self.best.energy:  # of a search that may go up
            self.progress = replace(self.progress, best=least)
        return self.best

    def cost(self, level: int, x: FloatArray) -> float:
        """Return about how many products of rows an evaluation at fields (N, F, 2) costs."""
        energy = self.levels[level].energy
        return energy.discretisation.size * max(energy.flow(x).exponent, 1.0)

    def _reason_to_stop(
        self,
        stage: Stage,
        goal: float,
        energies: list[float],
        residuals: list[float],
        search: str | None,
    ) -> StopReason | None:
        if search is not None:
            return StopReason(search)
        if residuals[-1] <= goal:
            return StopReason.GOAL_REACHED
        pays = stage.pays(energies, residuals) and self.effort < self.limit
        return None if pays else StopReason.NO_PROGRESS

    def _left(self, stage: Stage) -> float:
        return self.levels[stage.level].energy.left(self.best, stage.shift)

    def _arrive(self, stage: Stage, best: Evaluation) -> None:
        """Take fields as the best on a stage's level, and as an iterate where a level begins."""
        self.progress = replace(self.progress, best=best)
        if stage.level != self.level:  # not before: until then what is known is on the coarser mesh
            self.level, self.progress = stage.level, replace(self.progress, learned=None)
        history = self._record.history
        sizes = best.energy, self.levels[-1].energy.functions.function_size
        if not history and not np.isfinite(sizes).all():
            raise FunctionError(
                "the mismatch of source and target overflows; scale both functions down or sigma up"
            )
        is_new = self._record.level != stage.level
        if not history or (is_new and len(history) <= self._parameters.solver.iterations):
            self._record.add(self.levels, self.own, stage, best)

    def _first(self, search: Search, stage: Stage) -> Any:
        before, best, learned = self.progress.before, self.best, self.progress.learned
        self.progress = replace(self.progress, before=stage)
        if before is None or not stage.continues(before):
            return search.init(best.x, best)
        return search.init(best.x, best, learned, stage.steeper(before))

    def _search(self, stage: Stage, at: FloatArray | None = None) -> Search:
        def counted() -> None:
            self._record.evaluations += 1

        return search(self.levels[stage.level].energy, stage, counted, at)


def search(
    energy: MatchingEnergy,
    stage: Stage,
    counted: Callable[[], None] = lambda: None,
    at: FloatArray | None = None,
) -> Search:
    """Return the search of a stage, which tells of each evaluation; beside functions it knows how
    landmarks bend the energy at some fields (N, F, 2).
    """
    p = energy.parameters
    objective = energy.objective(
        stage.sigma,
        stage.reach,
        alpha=stage.alpha,
        shift=stage.shift,
        tolerance=_TOLERANCE,
    )
    close = energy.missed_landmarks(stage.landmark_sigma)
    objective = replace(objective, landmarks=close)
    regularity, tau = objective.regularity, p.tau

    def evaluate(x: FloatArray) -> Evaluation:
        checkpoint()
        counted()
        return objective.evaluate(x)

    def inverse(gradient: FloatArray) -> FloatArray:
        return (
            np.stack([regularity.inverse(momentum) for momentum in gradient]) * len(gradient) / tau
        )

    def displacement(fields: FloatArray) -> float:
        return tau * float(np.sqrt((fields**2).sum(axis=-1)).max(axis=-1).mean())

    precondition: Inverse | None = inverse if p.paper.preconditioner == "hodge" else None
    landmarks = energy.landmarks
    if precondition and landmarks is not None:
        bends = partial(landmarks.bends, tau=tau, sigma=stage.landmark_sigma)
        if energy.is_of_landmarks:
            return GaussNewton(evaluate, inverse, bends, displacement, p.solver.max_displacement)
        if at is not None and 2 * len(landmarks) * at.size <= _MOST_BENT:
            precondition = with_landmarks(inverse, *bends(at)[:2])
    return LBFGS(
        evaluate,
        precondition,
        p.solver.memory,
        displacement,
        p.solver.max_displacement,
        p.solver.tolerance,
    )


def minimum(energy: MatchingEnergy, stage: Stage, x: FloatArray, last: Progress) -> Progress:
    """Minimise a stage of a fold from fields (N, F, 2), without recording iterates.

    It uses the pairs of the last stage, and stops when the energy falls by less than a fifth within
    four iterations: less exactly than `Descent.minimise`, which moves the chosen sigma by a few
    percent.
    """
    found: Any = search(energy, stage, at=x)
    before = last.before
    if before is not None and stage.continues(before):
        current = found.init(x, found.evaluate(x), last.learned, stage.steeper(before))
    else:
        current = found.init(x)
    energies = [current.point.energy]
    while len(energies) <= stage.iterations and falls(energies, _FOLD_FALL_MIN, _FOLD_ITERATIONS):
        if found.stop_reason(current) is not None:
            break
        current = found.step(current)
        energies.append(current.point.energy)
    return Progress(current.point, current, stage)


def calmed(
    mesh: TriangleMesh,
    x: FloatArray,
    residual: float,
    evaluate: Callable[[FloatArray], tuple[Point, float]],
) -> Point:
    """Smooth fields (N, F, 2) from a coarser mesh as little as keeps their discrete flow calm.

    Returns what ``evaluate`` gives, beside the residual, of fields that leave about as
    much as before, or of the best ones tried; of zero where none is finite.
    """
    calm, least = None, np.inf
    for edges in _SCALES:
        point, found = evaluate(smoothed(mesh, x, edges))
        if found < least:
            calm, least = point, found
        if found <= _WORSE * residual + _GROWN:  # false if not finite
            break
    return evaluate(np.zeros_like(x))[0] if calm is None else calm


def smoothed(mesh: TriangleMesh, x: FloatArray, edges: float) -> FloatArray:
    """Return fields (N, F, 2) smoothed by the norm of first order over so many edges."""
    if not edges:
        return x
    smooth = Regularizer(mesh, edges**2 / len(mesh.vertices))
    momenta = [(smooth.mass * v.ravel()).reshape(v.shape) for v in x]
    return np.stack([smooth.inverse(momentum) for momentum in momenta])
