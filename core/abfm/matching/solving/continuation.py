"""The continuation of a match: steps of decreasing sigma, from the coarsest mesh to the finest.

`init` makes the first state, `step` the next one, `terminate` ends the continuation, and `finish`
selects the result. The function `step` minimises the energy for one sigma, corrects the best
result, or plans the next sweep. A sweep is a list of values of sigma on one level. The `Phase` of a
state determines the plan:

1. Search: on the coarsest mesh, sigma falls until both checks confirm the goal, or until held-out
   patches no longer improve. If this fails, it is tried with another alpha or number of fields.
2. Interpolation: for measured functions, sigma is interpolated between two steps.
3. Prolongation: the best step is continued on the mesh of the problem. Clusters of vertices make
   this cheaper if the mesh has thin triangles.
4. Exact: the result is continued without clusters, if these change it.
5. Refinement: the mesh is subdivided, and the continuation returns to 3.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import Enum, auto

import numpy as np

from abfm.calculus.vector_fields import to_ambient
from abfm.errors import AbfmError
from abfm.matching.objective.matching_energy import Evaluation, MatchingEnergy
from abfm.matching.path import PathStep
from abfm.matching.solvability import RESOLUTION_MIN, first_difference, narrowest
from abfm.matching.solving.descent import Progress, minimise, prolonged, prolonged_without_gradient
from abfm.matching.solving.held_out import HeldOut, best_between
from abfm.matching.solving.levels import Levels, Subdivision
from abfm.matching.solving.measures import advect_along_flow_lines, flow_line_measures
from abfm.matching.solving.outlook import COARSE_SHARE, REFINED_SHARE, SECOND_SHARE, Outlook, Plan
from abfm.matching.solving.record import Record, Score, StepResult, StopReason
from abfm.matching.solving.schedule import Schedule, Stage, Variant
from abfm.matching.solving.settings import SETTINGS
from abfm.matching.solving.start import (
    initial_fields,
    misses_target,
    start_on_coarsest,
    start_on_finer,
)
from abfm.outcome import RESIDUAL_NEARLY
from abfm.parameters import REFINE_MAX
from abfm.types import FloatArray
from abfm.workers.control import CancelledError, Control, controlled
from abfm.workers.progress import phase
from abfm.workers.progress import step as progress_step

_NO_FIELDS = np.empty((1, 0, 3))


class Phase(Enum):
    """The phase of a continuation; it determines the next plan."""

    SEARCH = auto()
    INTERPOLATION = auto()
    PROLONGATION = auto()
    EXACT = auto()
    REFINEMENT = auto()
    DONE = auto()


@dataclass(frozen=True, eq=False)
class Sweep:
    """Values of sigma for which the energy is minimised one after the other on one level."""

    level: int
    sigmas: tuple[float, ...]  # remaining values of sigma
    # initial fields (N, F, 2); None if ``origin`` provides them
    at: FloatArray | Evaluation | None = None
    origin: StepResult | None = None  # coarser step to continue; results have its score
    reach: float = 0.0  # reach of the search; 0 once the target is found
    held_out: HeldOut | None = None
    after: tuple[StepResult, ...] = ()  # later steps of the path, not part of the sweep


@dataclass(frozen=True, eq=False)
class State:
    """The state of a continuation."""

    levels: Levels
    schedule: Schedule
    record: Record
    # results without an iteration: zero fields or a start (N, F, 2), and advected functions (C, V)
    at_rest: tuple[tuple[FloatArray, FloatArray], ...]
    variants: tuple[Variant, ...]  # to be tried in this order
    variant: Variant
    phase: Phase
    start: FloatArray  # fields (N, F, 2) at which the search begins
    sweep: Sweep | None = None
    path: tuple[StepResult, ...] = ()
    tried: tuple[tuple[StepResult, ...], ...] = ()  # paths of the variants so far
    progress: Progress = Progress()
    unrefined: tuple[StepResult, ...] = ()  # the path before the latest subdivision

    @property
    def energy(self) -> MatchingEnergy:
        return self.levels[self.levels.mesh_level].energy

    @property
    def goal(self) -> float:
        return self.levels.attainable(self.energy.parameters.goal)


@dataclass(frozen=True, eq=False)
class Solution:
    """The result of a continuation."""

    path: tuple[PathStep, ...]
    step: int  # index of the selected step
    advected: FloatArray  # the advected source (C, V), on the mesh of the problem
    reason: StopReason


def solve(energy: MatchingEnergy, record: Record) -> Solution:
    """Run a continuation and return its best result, also if it is cancelled or memory runs out."""
    state, reason = init(energy, record), None
    with phase("match") as report:
        record.outlook = Outlook(report, state.levels.all[0].energy.discretisation.size)
        try:
            while not terminate(state):
                record.outlook.plan(_outlook(state))
                state = step(state)
        except CancelledError:
            reason = StopReason.CANCELLED
        except MemoryError:
            if not record.history or record.is_calling:
                raise
            reason = StopReason.OUT_OF_MEMORY
    record.outlook = None
    # after the exception handlers, so that the memory of the interrupted step is free
    with controlled(Control()):  # finishes even if cancelled
        return finish(state, reason)


def init(energy: MatchingEnergy, record: Record) -> State:
    """Return the first state: it continues a usable start of the problem, or begins a search."""
    p, levels, start = energy.parameters, Levels.of_mesh(energy), initial_fields(energy)
    at_rest = [(np.zeros(energy.shape), energy.terms.sources)]
    variant, schedule = Variant(p.alpha, energy.shape[0]), _schedule(levels)
    finer, is_missed = None, True
    if start is not None:
        at_rest.append((start, energy.advected(start)))
        variant = variant._replace(fields=len(start))
        finer = start_on_finer(energy, levels)
        is_missed = finer is None and misses_target(energy, *at_rest[-1])
    if schedule.is_measured and p.solver.iterations:
        # a start is not used, as it was fitted to the held-out values
        start, finer, is_missed = None, None, True
    sweep: Sweep | None = None
    variants: tuple[Variant, ...] = (variant,)
    if finer is not None:
        levels, x = finer
        sweep = Sweep(len(levels) - 1, tuple(schedule.sigmas[-1:]), x)
    elif start is not None and not is_missed:
        x = start
        sweep = Sweep(levels.cheapest(levels.mesh_level), tuple(schedule.sigmas[-1:]), x)
    else:
        levels = levels.with_coarser()
        schedule = _schedule(levels)
        x = start_on_coarsest(levels, start, not p.solver.iterations)
        variants = tuple(schedule.variants(len(x)))
    return State(
        levels,
        schedule=schedule,
        record=record,
        at_rest=tuple(at_rest),
        start=x,
        variants=variants,
        variant=variant,
        phase=Phase.PROLONGATION if sweep else Phase.SEARCH,
        sweep=sweep,
    )


def _schedule(levels: Levels) -> Schedule:
    energy = levels[levels.mesh_level].energy
    meshes, has_landmarks = levels.cheapest(levels.mesh_level) + 1, energy.landmarks is not None
    return Schedule(energy.parameters, energy.functions, meshes, has_landmarks)


def terminate(state: State) -> bool:
    return state.phase is Phase.DONE


def _outlook(state: State) -> Plan:
    levels, schedule, p = state.levels, state.schedule, state.energy.parameters
    sizes = [len(level.energy.mesh.vertices) for level in levels.all]
    level = 0 if state.sweep is None else state.sweep.level
    is_first, is_search = not state.tried, state.phase is Phase.SEARCH
    attempts = len(state.variants) - len(state.tried) - 1 if is_search else 0
    refined = sum(isinstance(each.to_finer, Subdivision) for each in levels.all)
    finer, size = list[int](), sizes[-1]
    most = np.inf if p.refine else SETTINGS.refined_vertices_max
    if p.refine or (p.refine is None and schedule.is_free and p.solver.iterations):
        while refined + len(finer) < (p.refine or REFINE_MAX) and (size := 4 * size) <= most:
            finer.append(size)
    is_reached = bool(_finest(state)) and state.path[_end(state)].worse <= state.goal
    may_succeed = is_first and is_search and bool(attempts)
    share = SECOND_SHARE if may_succeed else REFINED_SHARE
    first = levels.cheapest(levels.mesh_level)
    share = 1.0 if p.refine else share * (COARSE_SHARE if first and not refined else 1.0)
    return Plan(
        state.variant.fields,
        steps=len(state.sweep.sigmas) if is_search and state.sweep is not None else 0,
        has_given_end=schedule.has_given_end,
        is_clustered=levels.exact(level) != level,
        is_exact=levels[level].cheaper is not None,
        attempts=attempts * (1.0 if schedule.is_measured else SECOND_SHARE),
        sizes=(sizes[levels.mesh_level],) if level < first else (),
        refined=refined,
        finer=tuple(finer),
        finer_share=0.0 if is_reached else share,
    )


def step(state: State) -> State:
    """Minimise the energy for the next sigma, end the sweep, or plan the next one."""
    if state.sweep is None:
        return _PLANS[state.phase](state)
    return _minimised(state, state.sweep) if state.sweep.sigmas else _ended(state, state.sweep)


def _minimised(state: State, sweep: Sweep) -> State:
    schedule, levels, record = state.schedule, state.levels, state.record
    sigma, is_search = sweep.sigmas[0], state.phase is Phase.SEARCH
    if is_search:
        is_last = len(state.tried) == len(state.variants) - 1 and sigma == schedule.sigmas[-1]
        record.is_provisional = not (is_last or schedule.is_fixed)
    error = levels.error(sweep.level) if is_search else 0.0
    at, reach, progress, stages = sweep.at, sweep.reach, state.progress, list[Stage]()
    if reach:
        assert at is not None
        stages.append(schedule.stage(sweep.level, sigma, state.variant, reach, error))
        progress = minimise(levels, stages[-1], at, progress, record)
        is_found = schedule.is_found(levels[sweep.level].energy.residual_at(progress.point))
        reach = 0.0 if is_found or sigma == schedule.sigmas[-1] else reach
        at = progress.point.x
    if not reach:
        stages.append(schedule.stage(sweep.level, sigma, state.variant, error=error))
        if at is None:
            assert sweep.origin is not None
            at = prolonged(levels, stages[-1], sweep.origin, record)
        progress = minimise(levels, stages[-1], at, progress, record)
    result, held_out = _verified(state, stages[-1], progress.point), sweep.held_out
    if held_out is not None:
        held_out = held_out.follow(stages)
        result = replace(result, score=held_out.score(result.measures.get("log2_area", np.nan)))
    elif sweep.origin is not None:
        result = replace(result, score=sweep.origin.score)
    state = _with_path(replace(state, progress=progress), (*state.path, result))
    is_spent = is_search and len(record.history) > stages[-1].until
    is_over = is_spent or _is_over(state) or not (is_search or _gains(state))
    sigmas = () if is_over else sweep.sigmas[1:]
    at = progress.point.x
    sweep = replace(sweep, sigmas=sigmas, at=at, reach=reach, held_out=held_out)
    return replace(state, sweep=sweep)


def _ended(state: State, sweep: Sweep) -> State:
    """Return the state after a sweep, with its best step corrected."""
    state = _corrected(state, sweep.level)
    state = replace(state, sweep=None, path=(*state.path, *sweep.after))
    if state.phase is Phase.SEARCH:
        return replace(state, tried=(*state.tried, state.path))
    return state


def _corrected(state: State, level: int) -> State:
    """Apply a defect correction [Stetter 1978] to the best step of a level if this improves it.

    A descent minimises the mismatch of the discrete flow only. The correction shifts the advected
    functions to the mean of the discrete flow and of flow lines. The shift is constant during the
    descent. The corrected step replaces the best one if the larger residual of its two checks is
    smaller. Up to four corrections confirm no more of 41 problems, in 248 instead of 220 s.
    """
    there = [i for i, result in enumerate(state.path) if result.stage.level == level]
    if not state.schedule.is_free or not there:
        return state
    index = there[_best(state, [state.path[i] for i in there])]
    result, progress = state.path[index], state.progress
    most = SETTINGS.correction_factor_max * state.goal
    is_near = result.residual <= most and np.isfinite(result.verified_residual)
    if result.worse <= state.goal or not is_near:
        return state
    stage = state.schedule.stage(level, result.stage.sigma, state.variant)
    stage = replace(stage, goal=0.0, shift=_defect(state.levels, result))
    corrected = minimise(state.levels, stage, result.x, progress, state.record)
    found = _verified(state, stage, corrected.point)
    state = replace(state, progress=replace(corrected, reason=progress.reason))
    if not found.worse < result.worse:
        return state
    return _with_path(state, (*state.path[:index], found, *state.path[index + 1 :]))


def _defect(levels: Levels, result: StepResult) -> FloatArray:
    """Return half the difference of both checks: the discrete flow minus flow lines, (C, V).

    The values are those of the advected functions of all data terms at the end of a step.
    """
    energy = levels[result.stage.level].energy
    count = len(energy.functions.source)
    mean = result.advected.copy()
    with progress_step("checking by flow lines", len(energy.mesh.vertices)):
        mean[:count] += 0.5 * (advect_along_flow_lines(energy, result.x) - result.advected[:count])
    return energy.advected(result.x) - mean


def _verified(state: State, stage: Stage, point: Evaluation) -> StepResult:
    """Return the result of a step, measured by both checks (discrete flow and flow lines)."""
    levels, x = state.levels, point.x
    energy = levels.exact_energy(stage.level)
    is_exact = levels.exact(stage.level) == stage.level
    advected = point.advected if is_exact else energy.advected(x)
    measures = {}
    if not state.schedule.is_fixed and energy.parameters.paper.method != "linearised":
        checking = progress_step("checking by flow lines", len(energy.mesh.vertices))
        with suppress(MemoryError), checking:
            measures = flow_line_measures(energy, to_ambient(energy.mesh, x))
    return StepResult(stage, x, advected, energy.residual_of(x, advected), measures)


def _with_path(state: State, path: tuple[StepResult, ...]) -> State:
    state.record.path = tuple(result.step(_NO_FIELDS) for result in path)
    return replace(state, path=path)


def _is_over(state: State) -> bool:
    """Return whether the path ends at its latest step, before the last sigma of the schedule."""
    schedule, path = state.schedule, state.path
    if schedule.has_given_end:
        return False
    if schedule.is_measured:
        return _has_last_landmarks(state, path[-1]) and _best(state, path) < len(path) - 1
    # a smaller sigma is not tried after a stage that reached its goal
    is_reached = state.progress.reason is StopReason.GOAL_REACHED
    return is_reached or path[-1].worse <= state.goal


def _gains(state: State) -> bool:
    """Return whether the latest step has a smaller residual than the step before.

    True also for the first step on a mesh, and if the last step is always the result.
    """
    if state.schedule.has_given_end or len(state.path) < 2:
        return True
    before, last = state.path[-2:]
    return before.stage.level != last.stage.level or last.worse < before.worse


def _best(state: State, path: Sequence[StepResult]) -> int:
    if state.schedule.has_given_end:
        return len(path) - 1
    scores = np.array([_score(state, result) for result in path])
    if not np.isfinite(scores).any():
        return len(path) - 1
    # a step on a finer mesh has the score of the coarser step from which it was continued
    least = np.flatnonzero(scores == np.nanmin(scores)).tolist()
    return max(least, key=lambda index: path[index].stage.level)


def _score(state: State, result: StepResult) -> float:
    if not state.schedule.is_measured:
        return result.worse
    # before the last landmark_sigma, landmarks still improve, whatever the functions do
    return result.score.value if _has_last_landmarks(state, result) else np.inf


def _has_last_landmarks(state: State, result: StepResult) -> bool:
    return result.stage.landmark_sigma <= state.energy.parameters.landmark_sigma


def _value(state: State, path: Sequence[StepResult]) -> float:
    value = _score(state, path[_best(state, path)])
    return value if np.isfinite(value) else np.inf


def _finest(state: State) -> list[int]:
    """Return the indices of the steps on the finest mesh so far.

    Steps on meshes coarser than that of the problem do not count, so the list may be empty.
    """
    finest = max((result.stage.level for result in state.path), default=0)
    least = state.levels.cheapest(max(finest, state.levels.mesh_level))
    return [i for i, result in enumerate(state.path) if result.stage.level >= least]


def _end(state: State) -> int:
    finest = _finest(state)
    return finest[_best(state, [state.path[i] for i in finest])]


def _search(state: State) -> State:
    """Plan a path with the next variant (alpha, number of fields), or select the best path.

    A path is selected if all variants were tried, or if the latest residual is small enough.
    """
    schedule, number, reach = state.schedule, len(state.tried), state.schedule.first_reach
    is_enough = False
    if state.tried:
        residual = _value(state, state.path)
        # the residual on a coarse mesh is known only up to its discretisation error
        nearly = RESIDUAL_NEARLY + state.levels.error(0)
        enough = state.goal if schedule.is_free else nearly
        is_enough = not schedule.is_measured and residual <= enough
        reach = schedule.reach(residual)
    if number < len(state.variants) and not is_enough:
        variant = state.variants[number]
        x = np.repeat(state.start, variant.fields // len(state.start), axis=0)
        held_out = HeldOut.at(state.levels[0].energy, x) if schedule.is_measured else None
        sweep = Sweep(0, tuple(schedule.sigmas), x, reach=reach, held_out=held_out)
        state.record.begin(number + 1, len(state.variants))
        return replace(state, variant=variant, path=(), progress=Progress(), sweep=sweep)
    best = int(np.argmin([_value(state, path) for path in state.tried]))
    state.record.is_provisional, state.record.attempt = False, best + 1
    phase = Phase.INTERPOLATION if schedule.is_measured else Phase.PROLONGATION
    return _with_path(replace(state, variant=state.variants[best], phase=phase), state.tried[best])


def _interpolation(state: State) -> State:
    """Add a step to the path, with sigma interpolated between the best step and its neighbours.

    The path does not change if the score has no minimum between them, or after too many iterations.
    """
    state = replace(state, phase=Phase.PROLONGATION)
    index, levels = _best(state, state.path), state.levels
    three = state.path[index - 1 : index + 2] if index else ()
    if len(three) < 3:
        return state
    scores = [_score(state, result) for result in three]
    found = best_between([result.stage.sigma for result in three], scores)
    if found is None:
        return state
    sigma, weights = found
    after = index + (sigma < three[1].stage.sigma)
    stage = state.schedule.stage(0, sigma, state.variant)
    if len(state.record.history) > stage.until:
        return state
    at = state.path[after - 1].x
    progress = minimise(levels, stage, at, state.progress, state.record)
    held_out = float(weights @ [each.score.held_out for each in three])
    score = Score(float(weights @ scores), held_out, three[1].score.unmoved)
    result = replace(_verified(state, stage, progress.point), score=score)
    path = (*state.path[:after], result, *state.path[after:])
    return _with_path(replace(state, progress=progress), path)


def _prolongation(state: State) -> State:
    """Plan to continue the best step on the finest mesh, unless it is there already.

    For measured functions, only the sigma of this step is minimised there; otherwise, smaller ones
    follow.
    """
    state, top = replace(state, phase=Phase.EXACT), state.levels.cheapest(len(state.levels) - 1)
    if state.path[-1].stage.level >= top:
        return state
    index = _best(state, state.path)
    after = state.path[index + 1 :] if state.schedule.is_measured else ()
    sweep = replace(_sweep_from(state, state.path[index], top), after=after)
    return replace(state, path=state.path[:index], sweep=sweep)


def _exact(state: State) -> State:
    """Plan to continue the best step without clusters of vertices, unless they have little effect.

    They have little effect if the residual is within the goal. After defect corrections, this is
    also true if the residual of the discrete flow is at most that of flow lines.
    """
    state, result = replace(state, phase=Phase.REFINEMENT), state.path[_end(state)]
    is_corrected = state.schedule.is_free and result.residual <= result.verified_residual
    last = len(state.levels) - 1
    if result.stage.level < last and result.residual > state.goal and not is_corrected:
        return replace(state, sweep=_sweep_from(state, result, last))
    return state


def _sweep_from(state: State, result: StepResult, level: int) -> Sweep:
    sigma, schedule = result.stage.sigma, state.schedule
    sigmas = [sigma] if schedule.is_measured else [s for s in schedule.sigmas if s <= sigma]
    return Sweep(level, tuple(sigmas), origin=result)


def _refinement(state: State) -> State:
    """Plan to continue the best step on the midpoint subdivision, if it may reach the goal there.

    The number of matrix products on all finer meshes together is limited. If the latest subdivision
    did not reduce the residual, its steps are discarded and the continuation ends.
    """
    done = replace(state, phase=Phase.DONE)
    is_requested = state.energy.parameters.refine is not None
    if not _has_gained(state):
        return replace(done, path=state.unrefined)
    if not _may_refine(state):
        return done
    try:
        levels = state.levels.subdivided()
    except AbfmError:  # there are faces without area, or a term cannot be subdivided
        return done
    coarse, fine = (level.energy.functions for level in levels.all[-2:])
    # a finer mesh does not resolve jumps
    if not is_requested and not narrowest(fine) > narrowest(coarse):
        return done
    levels, result = levels.clustered(), state.path[_end(state)]
    progress, first = state.progress, levels.cheapest(len(levels) - 1)
    x = levels.fields_on(first, result.x, result.stage.level)
    # the effort has to allow some iterations, and one evaluation without clusters
    costs = SETTINGS.refinement_iterations_min * levels[first].cost(x), levels[-1].cost(x)
    effort_max = np.inf if is_requested else SETTINGS.refinement_effort_max
    if progress.effort + max(costs) > effort_max:
        return done
    return replace(
        state,
        levels=levels,
        phase=Phase.PROLONGATION,
        sweep=_sweep_from(state, result, first),
        unrefined=state.path,
        progress=replace(progress, effort_max=effort_max),
    )


def _has_gained(state: State) -> bool:
    """Return whether the latest subdivision reduced the residual; True if there was none."""
    if not state.unrefined:
        return True
    before = replace(state, path=state.unrefined)
    after = state.path[len(before.path) :]
    worse = min((result.worse for result in after), default=np.inf)
    return worse < before.path[_end(before)].worse


def _may_refine(state: State) -> bool:
    """Return whether a finer mesh may reduce the larger residual of the two checks."""
    p, schedule, finest = state.energy.parameters, state.schedule, state.levels.all[-1].energy
    if p.refine == 0 or not p.solver.iterations or schedule.is_fixed or not _finest(state):
        return False
    times = sum(isinstance(level.to_finer, Subdivision) for level in state.levels.all)
    result = state.path[_end(state)]
    if result.worse <= state.goal or times >= (REFINE_MAX if p.refine is None else p.refine):
        return False
    if p.refine is not None:
        return True
    count = len(finest.mesh.vertices) + len(finest.mesh.edges)
    # after all iterations, a finer mesh is only worthwhile for a nearly matched result
    is_vain = result.worse > RESIDUAL_NEARLY and len(state.record.history) > p.solver.iterations
    is_fine = count > SETTINGS.refined_vertices_max
    ends = schedule.is_measured or schedule.has_given_sigma
    return not (ends or is_fine or is_vain or _is_resolved(state.levels, result))


def _is_resolved(levels: Levels, result: StepResult) -> bool:
    """Return whether the mesh resolves the functions, so that a finer one would not help.

    The match nevertheless fails: the discrete flow has a large residual, or the peaks differ.
    """
    functions = levels[result.stage.level].energy.functions
    if not result.worse > RESIDUAL_NEARLY or narrowest(functions) < RESOLUTION_MIN:
        return False
    return result.residual > RESIDUAL_NEARLY or first_difference(functions) is not None


_PLANS = {
    Phase.SEARCH: _search,
    Phase.INTERPOLATION: _interpolation,
    Phase.PROLONGATION: _prolongation,
    Phase.EXACT: _exact,
    Phase.REFINEMENT: _refinement,
}


def finish(state: State, interruption: StopReason | None = None) -> Solution:
    """Return the solution: the best step, unless no motion and the start are both better.

    Then it is the better of these two. ``interruption`` is the stop reason of an interrupted run.
    """
    if interruption is not None:
        state = replace(state, path=_with_latest(state))
        state = state if _has_gained(state) else replace(state, path=state.unrefined)
    levels, energy, path = state.levels, state.energy, state.path
    number, residual = 0, np.inf
    if _finest(state):
        number = _end(state)
        residual = path[number].residual
    rest = [energy.residual_of(x, advected) for x, advected in state.at_rest]
    if not residual <= max(rest):
        x, advected = state.at_rest[int(np.argmin(rest))]
        if path:
            x = np.repeat(x, len(path[0].x) // len(x), axis=0)
        stage = state.schedule.stage(levels.mesh_level, state.schedule.sigmas[0], state.variant)
        number, path = 0, (StepResult(stage, x, advected, min(rest)), *path)
    shape = len(energy.functions.source), len(energy.mesh.vertices)
    steps = tuple(_path_step(levels, result) for result in path)
    advected = np.ascontiguousarray(path[number].advected[: shape[0], : shape[1]])
    return Solution(steps, number, advected, interruption or state.progress.reason)


def _with_latest(state: State) -> tuple[StepResult, ...]:
    """Return the path with the best step so far; append the latest iterate if it is better."""
    levels, least, record = state.levels, state.levels.mesh_level, state.record
    paths = [path for path in (*state.tried, state.path) if path]
    results = [result for path in paths for result in path]
    if record.latest is not None:
        level, point = record.latest
        residual = levels[level].energy.residual_at(point)
        results.append(StepResult(record.schedule[-1], point.x, point.advected, residual))
    if not results:
        return state.path
    on_mesh = [result for result in results if result.stage.level >= least]
    best = min(on_mesh or results, key=lambda result: result.worse)
    path = next((path for path in paths if best in path), state.path)
    if best in path and on_mesh:
        return path
    level = levels.exact(max(best.stage.level, least))
    x, advected = prolonged_without_gradient(levels, level, best)
    stage = replace(best.stage, level=level)
    residual = levels[level].energy.residual_of(x, advected)
    return (*path, StepResult(stage, x, advected, residual))


def _path_step(levels: Levels, result: StepResult) -> PathStep:
    """Return a result as a step of the path, in the unit of the input mesh.

    Fields of a coarser level are transferred to the mesh of the problem.
    """
    level = max(result.stage.level, levels.mesh_level)
    mesh, unit = levels[level].energy.mesh, levels[levels.mesh_level].energy.length_scale
    x = levels.fields_on(levels.mesh_level, result.x, result.stage.level)
    functions = levels.exact_energy(result.stage.level).functions
    mismatch = functions.mismatch(result.advected[: len(functions.source)])
    return result.step(to_ambient(mesh, x) * unit, mismatch)
