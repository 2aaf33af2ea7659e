"""The way of a match from smooth to close: sigma falls from step to step, each warm from the last,
and each is held against flow lines; found on the coarsest mesh, it ends on the mesh itself, or on
finer ones.
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

import numpy as np

from abfm.calculus.vector_fields import to_ambient
from abfm.errors import AbfmError
from abfm.matching.objective.matching_energy import Evaluation, MatchingEnergy
from abfm.matching.path import PathStep
from abfm.matching.solvability import RESOLVED, narrowest, unmatched
from abfm.matching.solving.course import Course, Stage, Way
from abfm.matching.solving.descent import Descent, Progress
from abfm.matching.solving.held_out import HeldOut, best_between
from abfm.matching.solving.levels import (
    Subdivision,
    fits,
    levels,
    on_the_mesh,
    subdivided,
)
from abfm.matching.solving.measures import carried_along, measured
from abfm.matching.solving.record import CallerError, Iteration, Mark, Record, StopReason
from abfm.matching.solving.start import given, is_lost, on_finer, where_it_begins
from abfm.outcome import RESIDUAL_NEARLY
from abfm.parameters import MOST_REFINED
from abfm.types import FloatArray
from abfm.workers.control import CancelledError, Control, controlled
from abfm.workers.progress import step

_OFF = 1.6  # times the goal by the discrete flow, up to which a correction gains
_FINEST = 60_000  # vertices of the finest mesh that is made without being asked for
_MOST = 5e9  # products of rows that finer meshes are worth: about a minute
_LEAST = 20  # iterations on one, which have to be within that
_LATER = np.empty((1, 0, 3))  # instead of fields


class Solver:
    """Finds the fields of a problem; ``way`` has its steps, ``step`` says which is the end."""

    def __init__(
        self, energy: MatchingEnergy, on_iteration: Callable[[Iteration], object] | None
    ) -> None:
        self.energy, self.record = energy, Record(on_iteration)
        self.way: list[Mark] = []
        self._with = Way(energy.parameters.alpha, energy.shape[0])
        self.step = 0
        self._earlier: list[list[Mark]] = []  # ways that were given up
        self._unmoved = np.nan  # residual of held-out patches without motion
        self._course = self._course_on(1)
        self._descent = Descent(energy, self.record)
        self._home = self._descent.own  # the level where it ends: the mesh itself, or a finer one
        # what does not move: no field, and the one that was given
        self._at_rest: list[tuple[FloatArray, FloatArray]] = [
            (np.zeros(energy.shape), energy.terms.carried)
        ]

    def run(self) -> StopReason:
        """Go the way, and return why it ended."""
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
        with controlled(Control()):  # what was found is kept though it was cancelled
            self._end(reason is not None)
        return reason or self._descent.reason

    def _course_on(self, meshes: int) -> Course:
        energy = self.energy
        return Course(energy.parameters, energy.functions, meshes, energy.landmarks is not None)

    def _descend(self) -> None:
        descent, p = self._descent, self.energy.parameters
        start, finer, lost = given(self.energy), None, True
        if start is not None:
            self._at_rest.append((start, self.energy.advected(start)))
            self._with = self._with._replace(fields=len(start))
            finer = on_finer(self.energy, descent.levels)
            lost = finer is None and is_lost(self.energy, *self._at_rest[-1])
        if self._course.is_measured and p.solver.iterations:
            # what is held out would not be new to a field that has seen it
            start, finer, lost = None, None, True
        if finer is not None:
            descent.levels, x = finer
            self._home = len(descent.levels) - 1
            self._come_close(x, self._home, self._course.sigmas[-1:])
        elif start is not None and not lost:
            self._come_close(start, descent.cheapest(self._home), self._course.sigmas[-1:])
        else:
            descent.levels = levels(descent.levels)
            descent.own = self._home = len(descent.levels) - 1
            self._course = self._course_on(descent.cheapest(descent.own) + 1)
            self._find(start)
        self._rise()
        self._refine()

    def _find(self, start: FloatArray | None) -> None:
        """Walk the ways on the first mesh; that which comes closest stays."""
        iterations, descent = self.energy.parameters.solver.iterations, self._descent
        x = where_it_begins(descent.levels, start, not iterations)
        ways, reach = self._course.ways(len(x)), self._course.first_reach
        for number, way in enumerate(ways):
            descent.progress, self.way, self._with = Progress(), [], way
            is_last = number == len(ways) - 1
            self._walk(np.repeat(x, way.fields // len(x), axis=0), reach, is_last)
            self._correct()
            self._earlier.append(self.way)
            left = self._value(self.way)
            # the residual on a coarse mesh is known only up to its discretisation error
            nearly = RESIDUAL_NEARLY + descent.error(0)
            enough = self._goal if self._course.is_free else nearly
            if not self._course.is_measured and left <= enough:
                break
            reach = self._course.reach(left)
        best = int(np.argmin([self._value(way) for way in self._earlier]))
        self.way, self._with = self._earlier[best], ways[best]
        self.record.is_trying = False
        if self._course.is_measured:
            self._solve_between()

    def _walk(self, x: FloatArray, reach: float, is_last_way: bool) -> None:
        course, descent = self._course, self._descent
        error = descent.error(0)
        held = HeldOut(descent.levels[0].energy, x) if course.is_measured else None
        self._unmoved = np.nan if held is None else held.unmoved
        for sigma in course.sigmas:
            is_last = is_last_way and sigma == course.sigmas[-1]
            self.record.is_trying = not (is_last or course.is_fixed)
            stages = []
            if reach:
                stages.append(course.stage(0, sigma, self._with, reach, error))
                x = descent.minimise(stages[-1], x).x
                if course.is_found(descent.residual) or sigma == course.sigmas[-1]:
                    reach = 0.0
            if not reach:
                stages.append(course.stage(0, sigma, self._with, error=error))
                x = descent.minimise(stages[-1], x).x
            mark = self._judged(stages[-1])
            if held is not None:
                left = held.follow(stages)
                mark = replace(mark, held_out=left.discrete, score=left.score(mark.log2_area))
            self._keep([*self.way, mark])
            if self._is_over() or len(self.record.history) > stages[-1].until:
                break

    def _solve_between(self) -> None:
        """Add the step whose sigma is interpolated between the best step and its neighbours."""
        index = self._best(self.way)
        three = self.way[index - 1 : index + 2] if index else []
        if len(three) < 3:
            return
        scores = [self._score(mark) for mark in three]
        found = best_between([mark.stage.sigma for mark in three], scores)
        if found is None:
            return
        sigma, weights = found
        after = index + (sigma < three[1].stage.sigma)
        stage = self._course.stage(0, sigma, self._with)
        if len(self.record.history) > stage.until:
            return
        self._descent.minimise(stage, self.way[after - 1].x)
        mark = replace(
            self._judged(stage),
            held_out=float(weights @ [each.held_out for each in three]),
            score=float(weights @ scores),
        )
        self._keep([*self.way[:after], mark, *self.way[after:]])

    def _rise(self) -> None:
        """Take the end of the way to its mesh, first with clusters where they are cheaper."""
        top = self._descent.cheapest(self._home)
        if self.way[-1].stage.level < top:
            index = self._best(self.way)
            mark, after = self.way[index], self.way[index + 1 :]
            self.way = self.way[:index]
            self._bring(mark, top)
            if self._course.is_measured:
                self.way += after
        mark = self.way[self._end_so_far()]
        corrected = self._course.is_free and mark.residual <= mark.verified_residual
        if mark.stage.level < self._home and mark.residual > self._goal and not corrected:
            self._bring(mark, self._home)

    def _bring(self, mark: Mark, level: int) -> None:
        """Take a step to a finer level, and on from there."""
        course, descent, sigma = self._course, self._descent, mark.stage.sigma
        stage = course.stage(level, sigma, self._with)
        # beside needles, which clusters hold together, the mesh as it is may leave anything
        left = float(np.fmin(mark.residual, mark.verified_residual))
        at = descent.prolonged(mark.x, mark.stage.level, stage, left)
        sigmas = [sigma] if course.is_measured else [s for s in course.sigmas if s <= sigma]
        self._come_close(at, level, sigmas, mark)

    def _come_close(
        self,
        at: FloatArray | Evaluation,
        level: int,
        sigmas: list[float],
        coarse: Mark | None = None,
    ) -> None:
        """Minimise steps on a level, from fields there; these keep the score of a coarser one."""
        for sigma in sigmas:
            stage = self._course.stage(level, sigma, self._with)
            at = self._descent.minimise(stage, at).x
            mark = self._judged(stage)
            if coarse is not None:
                mark = replace(mark, held_out=coarse.held_out, score=coarse.score)
            self._keep([*self.way, mark])
            if self._is_over() or not self._gains():
                break
        self._correct()

    def _correct(self) -> None:
        """Bring the mean of both witnesses towards the target, if the worse one gains by it.

        A minimisation sees the discrete flow alone. So what this carries more than the mean is
        taken off, and the rest held against the target: a defect correction [Stetter 1978].
        """
        course, descent = self._course, self._descent
        there = [i for i, mark in enumerate(self.way) if mark.stage.level == descent.level]
        if not course.is_free or not there:
            return
        index = there[self._best([self.way[i] for i in there])]
        mark, reason = self.way[index], descent.reason
        near = mark.residual <= _OFF * self._goal and np.isfinite(mark.verified_residual)
        if mark.worse <= self._goal or not near:
            return
        stage = course.stage(descent.level, mark.stage.sigma, self._with)
        descent.minimise(replace(stage, goal=0.0, shift=self._defect(mark)), mark.x)
        found = self._judged(stage)
        if found.worse < mark.worse:
            self._keep([*self.way[:index], found, *self.way[index + 1 :]])
        descent.reason = reason

    def _defect(self, mark: Mark) -> FloatArray:
        """Return what a step's level carries more than the mean of its mesh and of flow lines."""
        energy = self._descent.levels[mark.stage.level].energy
        count = len(energy.functions.source)
        mean = mark.carried.copy()
        with step("checking by flow lines", len(energy.mesh.vertices)):
            mean[:count] += 0.5 * (carried_along(energy, mark.x) - mark.carried[:count])
        return energy.advected(mark.x) - mean

    def _refine(self) -> None:
        """Go on on finer meshes while a witness leaves more than the goal, and it pays."""
        p, course, descent = self.energy.parameters, self._course, self._descent
        ends = course.is_measured or course.is_given
        never = p.refine == 0 or not p.solver.iterations or course.is_fixed
        if never or (p.refine is None and ends):
            return
        most = MOST_REFINED if p.refine is None else p.refine
        end = descent.effort + _MOST if p.refine is None else np.inf
        while True:
            times = sum(isinstance(level.to_finer, Subdivision) for level in descent.levels)
            if times >= most or not self._there():
                return
            mark = self.way[self._end_so_far()]
            is_fine = not fits(descent.levels[-1].energy.mesh, _FINEST)
            if mark.worse <= self._goal:
                return
            # what is nearly there may be there where fields are smoother
            is_vain = (
                mark.worse > RESIDUAL_NEARLY and len(self.record.history) > p.solver.iterations
            )
            if p.refine is None and (is_fine or is_vain or self._is_resolved(mark)):
                return
            try:
                coarse, fine = subdivided(descent.levels[-1])
            except AbfmError:  # of faces without area, or of a term that has no place there
                return
            jumps = not narrowest(fine.energy.functions) > narrowest(coarse.energy.functions)
            if p.refine is None and jumps:  # which no mesh resolves
                return
            descent.levels[-1:] = [coarse, *on_the_mesh(fine.energy)]
            self._home, before = len(descent.levels) - 1, len(self.way)
            if descent.effort + self._least_effort(mark) > end:
                return
            descent.limit = end
            self._bring(mark, descent.cheapest(self._home))
            self._rise()
            descent.limit = np.inf
            left = min((mark.worse for mark in self.way[before:]), default=np.inf)
            if not left < mark.worse:
                self.way = self.way[:before]
                return

    def _is_resolved(self, mark: Mark) -> bool:
        """Tell whether what a step leaves is not the mesh's doing."""
        functions = self._descent.levels[mark.stage.level].energy.functions
        if not mark.worse > RESIDUAL_NEARLY or narrowest(functions) < RESOLVED:
            return False
        return mark.residual > RESIDUAL_NEARLY or unmatched(functions) is not None

    def _least_effort(self, mark: Mark) -> float:
        """Return what going on on a finer mesh takes at least: some iterations, and one flow
        without clusters, which beside needles may be anything.
        """
        descent, x = self._descent, mark.x
        first = descent.cheapest(self._home)
        for level in descent.levels[mark.stage.level : first]:
            x = level.fields_to_finer(x)
        return max(_LEAST * descent.cost(first, x), descent.cost(self._home, x))

    def _gains(self) -> bool:
        """Tell whether the last step on its mesh left less than the one before, if it has to."""
        if self._course.is_given or self._course.is_fixed or len(self.way) < 2:
            return True
        before, last = self.way[-2:]
        same = before.stage.level == last.stage.level
        return not same or last.worse < before.worse

    def _there(self) -> list[int]:
        """Return which steps are on the finest mesh so far, the mesh itself at least."""
        finest = max((mark.stage.level for mark in self.way), default=0)
        least = self._descent.cheapest(max(finest, self._descent.own))
        return [i for i, mark in enumerate(self.way) if mark.stage.level >= least]

    def _end_so_far(self) -> int:
        there = self._there()
        return there[self._best([self.way[i] for i in there])]

    @property
    def _goal(self) -> float:
        return self._descent.attainable(self.energy.parameters.goal)

    def _keep(self, way: list[Mark]) -> None:
        self.way, self.record.path = way, tuple(mark.step(_LATER) for mark in way)

    def _judged(self, stage: Stage) -> Mark:
        """Return what a step came to, by all witnesses."""
        descent = self._descent
        x, exact = descent.best.x, descent.exact(stage.level)
        energy = descent.levels[exact].energy
        carried = descent.best.advected if exact == stage.level else energy.advected(x)
        said = {}
        if not self._course.is_fixed and energy.parameters.paper.method != "linearised":
            with (
                suppress(MemoryError),
                step("checking by flow lines", len(energy.mesh.vertices)),
            ):
                said = measured(energy, to_ambient(energy.mesh, x))
        residual = energy.left_by(x, carried)
        return Mark(stage, x, carried, residual, unmoved=self._unmoved, **said)

    def _is_over(self) -> bool:
        """Tell whether the way has come to its end before the last sigma."""
        course = self._course
        if course.is_given or course.is_fixed:
            return False
        if course.is_measured:
            if self.way[-1].stage.landmark_sigma > self.energy.parameters.landmark_sigma:
                return False
            return self._best(self.way) < len(self.way) - 1
        # less than the stage's goal is not sought with a smaller sigma either
        is_done = self._descent.reason is StopReason.GOAL_REACHED
        return is_done or self.way[-1].worse <= self._goal

    def _best(self, way: list[Mark]) -> int:
        """Return which step of a way is its end."""
        if self._course.is_given or self._course.is_fixed:
            return len(way) - 1
        scores = np.array([self._score(mark) for mark in way])
        if not np.isfinite(scores).any():
            return len(way) - 1
        # a step on a finer mesh has the score with which it was chosen on a coarser one
        least = np.flatnonzero(scores == np.nanmin(scores))
        return int(max(least, key=lambda index: way[index].stage.level))

    def _score(self, mark: Mark) -> float:
        if self._course.is_measured:
            if mark.stage.landmark_sigma > self.energy.parameters.landmark_sigma:
                return np.inf  # whatever functions say: landmarks come closer
            return mark.score
        return mark.worse

    def _value(self, way: list[Mark]) -> float:
        value = self._score(way[self._best(way)])
        return value if np.isfinite(value) else np.inf

    def _end(self, early: bool) -> None:
        """Choose the step that the match is: what moves nothing where no other leaves less."""
        own = self._descent.own
        if early:
            self._keep_the_latest()
        left = np.inf
        if self._there():
            self.step = self._end_so_far()
            left = self.way[self.step].residual
        rest = [self.energy.left_by(x, carried) for x, carried in self._at_rest]
        if not left <= max(rest):
            x, carried = self._at_rest[int(np.argmin(rest))]
            if self.way:
                x = np.repeat(x, len(self.way[0].x) // len(x), axis=0)
            stage = self._course.stage(own, self._course.sigmas[0], self._with)
            self.way.insert(0, Mark(stage, x, carried, min(rest)))
            self.step = 0

    def _keep_the_latest(self) -> None:
        """Make a step of the iterate at which it was broken off, or of the best step before."""
        descent, own = self._descent, self._descent.own
        ways = [way for way in (*self._earlier, self.way) if way]
        marks = [mark for way in ways for mark in way]
        if descent.progress.best is not None:
            stage, point = self.record.schedule[-1], descent.best
            marks.append(Mark(stage, point.x, point.advected, descent.residual))
        if not marks:
            return
        on_the_mesh = [mark for mark in marks if mark.stage.level >= own]
        best = min(on_the_mesh or marks, key=lambda mark: mark.residual)
        self.way = next((way for way in ways if best in way), self.way)
        if best in self.way and on_the_mesh:
            return
        level = descent.exact(max(best.stage.level, own))
        x, carried = descent.kept(best.x, best.stage.level, level, best.residual)
        energy, on = descent.levels[level].energy, replace(best.stage, level=level)
        self.way = [*self.way, Mark(on, x, carried, energy.left_by(x, carried))]

    def path(self) -> tuple[PathStep, ...]:
        """Return the way, with its fields on the mesh itself or on finer ones, in its units."""
        return tuple(
            replace(mark.step(self._velocity(mark)), mismatch=self._mismatch(mark))
            for mark in self.way
        )

    def _mismatch(self, mark: Mark) -> float:
        functions = self._descent.levels[self._descent.exact(mark.stage.level)].energy.functions
        return functions.mismatch(mark.carried[: len(functions.source)])

    def _velocity(self, mark: Mark) -> FloatArray:
        x, descent, level = mark.x, self._descent, mark.stage.level
        for coarser in descent.levels[level : descent.own]:
            x = coarser.fields_to_finer(x)
        mesh = descent.levels[max(level, descent.own)].energy.mesh
        return to_ambient(mesh, x) * self.energy.length_scale
