"""A descent: the minimisation of the energy for one stage on one level.

The functions are `init` (first state), `step` (one iteration), `terminate` and `finish`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeAlias, TypeVar

import numpy as np

from abfm.errors import FunctionError
from abfm.matching.objective.matching_energy import Evaluation, MatchingEnergy
from abfm.matching.objective.regularizer import Regularizer
from abfm.matching.solving.levels import Level, Levels, Subdivision
from abfm.matching.solving.newton import GaussNewton, Inverse, with_landmarks
from abfm.matching.solving.record import Record, StepResult, StopReason
from abfm.matching.solving.schedule import Stage, falls
from abfm.matching.solving.settings import SETTINGS
from abfm.mesh import TriangleMesh
from abfm.numerics.optimizer import LBFGS
from abfm.types import FloatArray
from abfm.workers.control import checkpoint

Point = TypeVar("Point")
Search: TypeAlias = GaussNewton | LBFGS[Evaluation]


@dataclass(frozen=True)
class Progress:
    """The state that one descent passes to the next one."""

    best: Evaluation | None = None
    level: int = 0  # level of the best fields
    before: Stage | None = None  # the latest stage with iterations
    reason: StopReason = StopReason.ITERATION_LIMIT  # reason why the latest descent ended
    # number of matrix row products of all evaluations, counted only if it is limited
    effort: float = 0.0
    effort_max: float = np.inf

    @property
    def point(self) -> Evaluation:
        assert self.best is not None
        return self.best


@dataclass(frozen=True, eq=False)
class Descent:
    """The state of a descent; attributes up to ``at_limit`` are constant."""

    levels: Levels
    stage: Stage
    record: Record
    goal: float  # residual at which the descent ends
    until: int  # total number of iterations at which the descent ends
    at_limit: StopReason  # the stop reason if it ends at ``until``
    search: Search
    current: Any  # current iterate of the search
    last_iterate: Any  # the latest iterate that did not fail, maybe of the stage before
    progress: Progress
    least: Evaluation  # the iterate of least energy
    energies: tuple[float, ...]
    residuals: tuple[float, ...]

    @property
    def level(self) -> Level:
        return self.levels[self.stage.level]


def minimise(
    levels: Levels, stage: Stage, start: FloatArray | Evaluation, before: Progress, record: Record
) -> Progress:
    """Minimise the energy of one stage, from initial fields (N, F, 2) or their evaluation.

    ``before`` is the progress of the previous descent.
    """
    record.schedule.append(stage)
    energy = levels[stage.level].energy
    search = search_of(energy, stage, record.count)
    best = start if isinstance(start, Evaluation) else search.evaluate(start)
    if not record.history:
        _refuse_overflow(best, levels)
    record.begin_stage(levels, stage, best)
    if stage.level != before.level:
        record.last_iterate = None  # the last iterate belongs to another level
    progress = replace(before, best=best, level=stage.level)
    if energy.residual_at(best, stage.shift) <= levels.attainable(stage.goal):
        return replace(progress, reason=StopReason.GOAL_REACHED)
    descent = init(levels, stage, record, progress, search)
    while (reason := terminate(descent)) is None:
        descent = step(descent)
    return finish(descent, reason)


def init(
    levels: Levels, stage: Stage, record: Record, progress: Progress, search: Search
) -> Descent:
    """Return the first state of the descent of a stage, at the best fields of ``progress``."""
    before, best, level = progress.before, progress.point, levels[stage.level]
    # keep no other reference, because the L-BFGS pairs of the iterate take memory
    last_iterate, record.last_iterate = record.last_iterate, None
    current = _first(search, stage, best, last_iterate, before)
    limit = len(record.history) - 1 + level.affordable_iterations(stage.iterations, best.x)
    is_last = stage.until <= limit or stage.fixed
    return Descent(
        levels,
        stage,
        record,
        goal=levels.attainable(stage.goal),
        until=min(stage.until, limit),
        at_limit=StopReason.ITERATION_LIMIT if is_last else StopReason.NO_PROGRESS,
        search=search,
        current=current,
        last_iterate=last_iterate,
        progress=replace(progress, before=stage),
        least=best,
        energies=(current.point.energy,),
        residuals=(level.energy.residual_at(best, stage.shift),),
    )


def step(descent: Descent) -> Descent:
    """Return the state after one iteration; if the line search fails, the fields do not change."""
    current, search, stage, record = descent.current, descent.search, descent.stage, descent.record
    energy, progress = descent.level.energy, descent.progress
    has_landmarks = energy.landmarks is not None and not energy.is_of_landmarks
    if has_landmarks and (len(descent.energies) - 1) % SETTINGS.curvature_iterations == 0:
        search = search_of(energy, stage, record.count, current.x)
        current = search.init(current.x, current.point)
    counted = record.evaluations
    current = search.step(current)
    if progress.effort_max < np.inf:  # products are only counted if needed, as this takes time
        cost = (record.evaluations - counted) * descent.level.cost(progress.point.x)
        progress = replace(progress, effort=progress.effort + cost)
    if current.failed:
        return replace(descent, search=search, current=current, progress=progress)
    best = current.point
    record.add(descent.levels, stage, best)
    return replace(
        descent,
        search=search,
        current=current,
        last_iterate=current,
        progress=replace(progress, best=best),
        least=best if best.energy <= descent.least.energy else descent.least,
        energies=(*descent.energies, min(descent.energies[-1], best.energy)),
        residuals=(*descent.residuals, energy.residual_at(best, stage.shift)),
    )


def terminate(descent: Descent) -> StopReason | None:
    """Return the reason why the descent ends at this iterate, or None."""
    if len(descent.record.history) > descent.until:
        return descent.at_limit
    if (reason := descent.search.stop_reason(descent.current)) is not None:
        return StopReason(reason)
    if descent.residuals[-1] <= descent.goal:
        return StopReason.GOAL_REACHED
    is_worthwhile = descent.stage.is_worthwhile(descent.energies, descent.residuals)
    is_worth = is_worthwhile and descent.progress.effort < descent.progress.effort_max
    return None if is_worth else StopReason.NO_PROGRESS


def finish(descent: Descent, reason: StopReason) -> Progress:
    """Return the progress after a descent, with the iterate of least energy.

    It may not be the last one, as a search for landmarks can also raise the energy.
    """
    best, least, record = descent.progress.point, descent.least, descent.record
    best = least if least.energy < best.energy else best
    record.latest, record.last_iterate = (descent.stage.level, best), descent.last_iterate
    return replace(descent.progress, best=best, reason=reason)


def _first(
    search: Any, stage: Stage, point: Evaluation, last_iterate: Any, before: Stage | None
) -> Any:
    """Return the first iterate; it reuses the curvature of ``last_iterate`` if that is valid."""
    if before is None or not stage.continues(before):
        return search.init(point.x, point)
    return search.init(point.x, point, last_iterate, stage.curvature_ratio(before))


def _refuse_overflow(first: Evaluation, levels: Levels) -> None:
    if not np.isfinite([first.energy, levels[-1].energy.functions.function_size]).all():
        raise FunctionError(
            "the mismatch of source and target overflows; use smaller functions or a larger sigma"
        )


def prolonged(levels: Levels, stage: Stage, origin: StepResult, record: Record) -> Evaluation:
    """Transfer the fields of a coarser level to the level of a stage and evaluate them.

    Fields of a coarser mesh have kinks over its edges, which increase the norm of second order. If
    the finer mesh is a subdivision, or if the user gives sigma, the fields are smoothed as long as
    this lowers the energy.
    """
    energy = levels[stage.level].energy
    evaluate = search_of(energy, stage, record.count).evaluate

    def measured(fields: FloatArray) -> tuple[Evaluation, float]:
        point = evaluate(fields)
        return point, energy.residual_at(point)

    # near slivers, whose vertices form clusters, the discrete residual is unreliable
    residual = float(np.fmin(origin.residual, origin.verified_residual))
    checkpoint()
    x = levels.fields_on(stage.level, origin.x, origin.stage.level)
    found = stabilised(energy.mesh, x, residual, measured)
    p, first = energy.parameters, levels.cheapest(stage.level)
    is_subdivided = isinstance(levels[first - 1].to_finer, Subdivision)
    is_rough = origin.stage.level < first and p.solver.order > 1 and p.sigma is not None
    for edges in SETTINGS.smoothing_edges[1:] if is_subdivided or is_rough else ():
        tried = evaluate(smoothed(energy.mesh, found.x, edges))
        if not tried.energy < found.energy:
            break
        found = tried
    return found


def prolonged_without_gradient(
    levels: Levels, level: int, origin: StepResult
) -> tuple[FloatArray, FloatArray]:
    """Transfer the fields of a coarser level; return them with the functions that they advect.

    Unlike `prolonged`, it computes no gradient, which saves memory.
    """
    energy = levels[level].energy

    def measured(fields: FloatArray) -> tuple[tuple[FloatArray, FloatArray], float]:
        advected = energy.advected(fields)
        return (fields, advected), energy.residual_of(fields, advected)

    checkpoint()
    x = levels.fields_on(level, origin.x, origin.stage.level)
    return stabilised(energy.mesh, x, origin.residual, measured)


def search_of(
    energy: MatchingEnergy,
    stage: Stage,
    count: Callable[[], None] = lambda: None,
    at: FloatArray | None = None,
) -> Search:
    """Return the search that minimises the energy of a stage: L-BFGS or Gauss-Newton.

    Gauss-Newton is used if only landmarks are matched. If functions and landmarks are matched
    together, the curvature of the landmarks at the fields ``at`` (N, F, 2), if given, preconditions
    L-BFGS. The function ``count`` is called at each evaluation.
    """
    p, solver = energy.parameters, energy.parameters.solver
    tolerance = SETTINGS.advection_tolerance
    objective = energy.objective(
        stage.sigma, stage.reach, alpha=stage.alpha, shift=stage.shift, tolerance=tolerance
    )
    objective = replace(objective, landmarks=energy.landmark_misfit(stage.landmark_sigma))
    regularity, tau = objective.regularity, p.tau

    def evaluate(x: FloatArray) -> Evaluation:
        checkpoint()
        count()
        return objective.evaluate(x)

    def inverse(gradient: FloatArray) -> FloatArray:
        found = np.stack([regularity.inverse(momentum) for momentum in gradient])
        return found * len(gradient) / tau

    def displacement(fields: FloatArray) -> float:
        return tau * float(np.sqrt((fields**2).sum(axis=-1)).max(axis=-1).mean())

    precondition: Inverse | None = inverse if p.paper.preconditioner == "hodge" else None
    landmarks = energy.landmarks
    if precondition and landmarks is not None:
        curvature = partial(landmarks.curvature, tau=tau, sigma=stage.landmark_sigma)
        if energy.is_of_landmarks:
            return GaussNewton(evaluate, inverse, curvature, displacement, solver.max_displacement)
        if at is not None and 2 * len(landmarks) * at.size <= SETTINGS.curvature_size_max:
            precondition = with_landmarks(inverse, *curvature(at)[:2])
    limits = solver.max_displacement, solver.tolerance
    return LBFGS(evaluate, precondition, solver.memory, displacement, *limits)


def minimise_fold(
    energy: MatchingEnergy, stage: Stage, x: FloatArray, last_iterate: Any, before: Stage | None
) -> Any:
    """Minimise the energy of one stage in a cross-validation fold, from fields ``x`` (N, F, 2).

    Return the last iterate. The search reuses the L-BFGS pairs of ``last_iterate`` if they are
    still valid after the stage ``before``. It ends when the energy falls by less than a fifth
    within four iterations. Compared with `minimise`, this changes the selected sigma by a few
    percent.
    """
    search: Any = search_of(energy, stage, at=x)
    current = _first(search, stage, search.evaluate(x), last_iterate, before)
    energies = [current.point.energy]
    fall = SETTINGS.fold_fall_min, SETTINGS.fold_iterations
    while len(energies) <= stage.iterations and falls(energies, *fall):
        if search.stop_reason(current) is not None:
            break
        current = search.step(current)
        energies.append(current.point.energy)
    return current


def stabilised(
    mesh: TriangleMesh,
    x: FloatArray,
    residual: float,
    evaluate: Callable[[FloatArray], tuple[Point, float]],
) -> Point:
    """Smooth fields (N, F, 2) from a coarser mesh until their discrete flow is stable.

    The function ``evaluate`` returns the evaluation of fields and its residual. The result is the
    first evaluation with about ``residual``, that of the coarser mesh, or else the best one. If no
    residual is finite, the result is the evaluation of zero fields.
    """
    best, least = None, np.inf
    for edges in SETTINGS.smoothing_edges:
        point, found = evaluate(smoothed(mesh, x, edges))
        if found < least:
            best, least = point, found
        # the comparison is false if the residual is not finite
        if found <= SETTINGS.stable_factor * residual + SETTINGS.stable_residual:
            break
    return evaluate(np.zeros_like(x))[0] if best is None else best


def smoothed(mesh: TriangleMesh, x: FloatArray, edges: float) -> FloatArray:
    """Smooth fields (N, F, 2) over a length of ``edges`` edges, by the norm of first order."""
    if not edges:
        return x
    smooth = Regularizer(mesh, edges**2 / len(mesh.vertices))
    momenta = [(smooth.mass * v.ravel()).reshape(v.shape) for v in x]
    return np.stack([smooth.inverse(momentum) for momentum in momenta])
