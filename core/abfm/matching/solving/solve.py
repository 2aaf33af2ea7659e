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
from abfm.matching.solvability import RESOLVED, narrowest
from abfm.matching.solving.course import NEARLY, Course, Stage, Way
from abfm.matching.solving.descent import Descent, Progress
from abfm.matching.solving.held_out import PRICE, HeldOut
from abfm.matching.solving.levels import (
    Subdivision,
    fits,
    levels,
    on_the_mesh,
    resolving,
    subdivided,
)
from abfm.matching.solving.measures import measured
from abfm.matching.solving.record import CallerError, Iteration, Mark, Record, StopReason
from abfm.matching.solving.start import given, is_lost, on_finer, where_it_begins
from abfm.parameters import MOST_REFINED
from abfm.types import FloatArray
from abfm.workers.control import CancelledError, Control, controlled
from abfm.workers.progress import step

_GAIN = 0.03  # of what is left by the worse witness: what a smaller sigma or a finer mesh must gain
_NEAR = 1.2  # times the goal: what is left at the end of a way and is mended on the mesh itself
_CLOSER = 0.6, 0.4  # of the goal, as close as it comes where flow lines leave more than that
_FINEST = 60_000  # vertices of the finest mesh that is made without being asked for
_WALKED = 16_000  # the same of one that is walked on
_EFFORT, _LEAST = 2.0, 20  # times what was spent before, for a finer mesh; and iterations on it
_FREE = 1e9  # products of rows that a finer mesh is worth in any case: seconds
_LATER = np.empty((1, 0, 3))  # instead of fields
_PATIENCE = 2  # steps after the best one, before a measured way ends


class Solver:
    """Finds the fields of a problem; ``way`` has its steps, ``step`` says which is the end."""

    def __init__(
        self, energy: MatchingEnergy, on_iteration: Callable[[Iteration], None] | None
    ) -> None:
        self.energy, self.record = energy, Record(on_iteration)
        self.way: list[Mark] = []
        self._with = Way(energy.parameters.alpha, energy.shape[0], energy.parameters.reach)
        self.step = 0
        self._earlier: list[list[Mark]] = []  # ways that were given up
        p, functions = energy.parameters, energy.functions
        self._course = Course(p, functions, 1)
        self._descent = Descent(energy, self.record)
        self._first = 0  # the level on which ways are walked
        self._home = self._descent.own  # that where they end: the mesh itself, or a finer one
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

    def _descend(self) -> None:
        descent, p = self._descent, self.energy.parameters
        start, finer, lost = given(self.energy), None, True
        if start is not None:
            self._at_rest.append((start, self.energy.advected(start)))
            self._with = self._with._replace(fields=len(start))
            finer = on_finer(self.energy, descent.levels)
            lost = finer is None and is_lost(self.energy, self._at_rest[-1][1])
        if self._course.is_measured and p.iterations:
            # what is held out would not be new to a field that has seen it
            start, finer, lost = None, None, True
        if finer is not None:
            descent.levels, x = finer
            last = self._course.sigmas[-1]
            stage = self._course.stage(len(descent.levels) - 1, last, self._with)
            descent.minimise(stage, x)
            self._mark(stage)
        elif start is not None and not lost:
            self._come_close(start, descent.own, self._course.sigmas[-1:])
        else:
            descent.levels = levels(descent.levels)
            descent.own = len(descent.levels) - 1
            cheapest = descent.cheapest(descent.own)
            self._course = Course(p, self.energy.functions, cheapest + 1)
            if self._course.is_free and p.iterations:
                descent.levels[-1:] = resolving(descent.levels[-1], self._most_refined, _WALKED)
            self._home = len(descent.levels) - 1
            if self._home > descent.own:
                self._first = cheapest = descent.cheapest(self._home)
                self._course = Course(p, self.energy.functions, cheapest + 1)
            self._find(start)
            if self._home > self._first:
                self._end_on_the_mesh()
        self._confirm()
        self._refine()

    def _find(self, start: FloatArray | None) -> None:
        """Walk the ways on the first mesh; that which comes closest stays."""
        iterations, descent = self.energy.parameters.iterations, self._descent
        x = where_it_begins(descent.levels, descent.own, self._first, start, not iterations)
        ways = self._course.ways(len(x))
        for number, way in enumerate(ways):
            if self._earlier:
                way = ways[number] = self._course.after(self._value(self._earlier[-1]), way)
            descent.progress, self.way, self._with = Progress(), [], way
            self._walk(np.repeat(x, way.fields // len(x), axis=0), number == len(ways) - 1)
            self._earlier.append(self.way)
            enough = _NEAR * self._goal if self._course.is_free else NEARLY
            if not self._course.is_measured and self._value(self.way) <= enough:
                break
        best = int(np.argmin([self._value(way) for way in self._earlier]))
        self.way, self._with = self._earlier[best], ways[best]
        self.record.is_trying = False

    def _end_on_the_mesh(self) -> None:
        """Take the end of the way to the mesh itself, and on from there if that is needed."""
        course, index = self._course, self._best(self.way)
        mark, after = self.way[index], self.way[index + 1 :]
        if self._first == self._descent.cheapest(self._home) and mark.mismatch <= self._goal:
            return
        self.way = self.way[:index]
        sigmas = [sigma for sigma in course.sigmas if sigma <= mark.stage.sigma]
        if course.is_measured:
            sigmas = sigmas[:1]
        self._come_close(mark.x, self._first, sigmas, mark)
        if course.is_measured:
            self.way += after

    def _walk(self, x: FloatArray, is_last_way: bool) -> None:
        course, descent, first = self._course, self._descent, self._first
        reach, energy = self._with.reach, descent.levels[first].energy
        held = HeldOut(energy, x) if course.is_measured else None
        for sigma in course.sigmas:
            is_last = is_last_way and sigma == course.sigmas[-1]
            self.record.is_trying = not (is_last or course.is_fixed)
            stages = []
            if reach:
                stages.append(course.stage(first, sigma, self._with, reach))
                x = descent.minimise(stages[-1], x).x
                if course.is_found(descent.mismatch) or sigma == course.sigmas[-1]:
                    reach = 0.0
            if not reach:
                stages.append(course.stage(first, sigma, self._with))
                x = descent.minimise(stages[-1], x).x
            self._mark(stages[-1], np.nan if held is None else held.follow(stages))
            if self._is_over() or len(self.record.history) > stages[-1].until:
                break

    def _come_close(
        self, x: FloatArray, level: int, sigmas: list[float], mark: Mark | None = None
    ) -> None:
        """Go on from fields of a level, those of a mark, on the mesh itself, where it has clusters
        first with these.
        """
        descent, course = self._descent, self._course
        left, held_out = (np.inf, np.nan) if mark is None else (mark.mismatch, mark.held_out)
        at: FloatArray | Evaluation = x
        is_there = mark is not None and level == descent.cheapest(self._home)
        for top in range(descent.cheapest(self._home) + is_there, self._home + 1):
            for sigma in sigmas:
                stage = course.stage(top, sigma, self._with)
                if top > level:
                    at, level = descent.prolonged(x, level, stage, left), top
                at = descent.minimise(stage, at).x
                self._mark(stage, held_out)
                if self._is_over() or not self._gains():
                    break
            x, left, sigmas = descent.best.x, descent.mismatch, sigmas[-1:]
            if self.way[-1].mismatch <= self._goal or descent.effort >= descent.limit:
                break

    def _refine(self) -> None:
        """Go on on finer meshes while flow lines leave more than the goal, and it pays."""
        p, course, descent = self.energy.parameters, self._course, self._descent
        ends = course.is_measured or course.is_given
        never = p.refine == 0 or not p.iterations or course.is_fixed
        if never or (p.refine is None and ends):
            return
        while True:
            times = sum(isinstance(level.to_finer, Subdivision) for level in descent.levels)
            if times >= self._most_refined or not self._there():
                return
            mark = self.way[self._end_so_far()]
            mesh = descent.levels[-1].energy.mesh
            is_fine = not fits(mesh, _FINEST)
            if mark.worse <= self._goal:
                return
            if p.refine is None and (is_fine or self._is_resolved(mark)):
                return
            try:
                coarse, fine = subdivided(descent.levels[-1])
            except AbfmError:  # of faces without area, or of a term that has no place there
                return
            descent.levels[-1:] = [coarse, *on_the_mesh(fine.energy)]
            before = len(self.way)
            self._go_on_finer(mark)
            left = min((mark.worse for mark in self.way[before:]), default=np.inf)
            needed = 1.0 if p.refine else 1 - _GAIN
            if not left < needed * mark.worse:
                self.way = self.way[:before]
                return

    @property
    def _most_refined(self) -> int:
        wanted = self.energy.parameters.refine
        return MOST_REFINED if wanted is None else wanted

    def _is_resolved(self, mark: Mark) -> bool:
        """Tell whether what a step leaves is not the mesh's doing."""
        energy = self._descent.levels[mark.stage.level].energy
        return mark.worse > NEARLY and narrowest(energy.functions) >= RESOLVED

    def _go_on_finer(self, mark: Mark) -> None:
        """Go on from a step on the finest mesh; unless asked for with as much effort as is left."""
        course, descent = self._course, self._descent
        self._home = len(descent.levels) - 1
        if self.energy.parameters.refine is None:
            x, first = mark.x, descent.cheapest(self._home)
            for level in descent.levels[mark.stage.level : first]:
                x = level.fields_to_finer(x)
            spare = max(_EFFORT * descent.effort, _FREE)
            if spare < _LEAST * descent.cost(first, x):
                return
            descent.limit = descent.effort + spare
        sigmas = [sigma for sigma in course.sigmas if sigma <= mark.stage.sigma]
        if course.is_measured:
            sigmas = sigmas[:1]
        self._come_close(mark.x, mark.stage.level, sigmas, mark)
        descent.limit = np.inf
        self._confirm()

    def _gains(self) -> bool:
        """Tell whether the last step on its mesh left less than the one before, if it has to."""
        if self._course.is_given or self._course.is_fixed or len(self.way) < 2:
            return True
        before, last = self.way[-2:]
        same = before.stage.level == last.stage.level
        return not same or last.worse < (1 - _GAIN) * before.worse

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

    def _confirm(self) -> None:
        """Come closer by the discrete flow than the goal, while flow lines leave more than that."""
        course, descent, p = self._course, self._descent, self.energy.parameters
        if not course.is_free:
            return
        index = self._end_so_far()
        reason, at, stage = descent.reason, self.way[index].x, self.way[index].stage
        sigmas = [sigma for sigma in course.sigmas if sigma <= stage.sigma]
        for close in _CLOSER:
            mark = self.way[index]
            if not self._goal < mark.worse <= NEARLY or mark.mismatch > self._goal:
                break
            for sigma in sigmas:
                stage = replace(course.stage(stage.level, sigma, self._with), goal=close * p.goal)
                at = descent.minimise(stage, at).x
                if descent.mismatch <= stage.goal:
                    break
            found = self._judged(stage)
            if found.worse < mark.worse:
                self.way[index] = found
        descent.reason = reason

    def _mark(self, stage: Stage, held_out: float = np.nan) -> None:
        """Keep what a step came to."""
        self.way = [*self.way, self._judged(stage, held_out)]
        self.record.path = tuple(mark.step(_LATER) for mark in self.way)

    def _judged(self, stage: Stage, held_out: float = np.nan) -> Mark:
        """Return what a step came to, by all witnesses."""
        descent = self._descent
        x, exact = descent.best.x, descent.exact(stage.level)
        energy = descent.levels[exact].energy
        carried = descent.best.advected if exact == stage.level else energy.advected(x)
        said = {}
        if not self._course.is_fixed and energy.parameters.method != "linearised":
            with (
                suppress(MemoryError),
                step("checking by flow lines", len(energy.mesh.vertices)),
            ):
                said = measured(energy, to_ambient(energy.mesh, x))
        mismatch = energy.relative_mismatch(carried)
        return Mark(stage, x, carried, mismatch, held_out=held_out, **said)

    def _is_over(self) -> bool:
        """Tell whether the way has come to its end before the last sigma."""
        course = self._course
        if course.is_given or course.is_fixed:
            return False
        if course.is_measured:
            return self._best(self.way) < len(self.way) - _PATIENCE
        # less than the stage's goal is not sought with a smaller sigma either
        is_done = self._descent.reason is StopReason.GOAL_REACHED
        return is_done or self.way[-1].worse <= self._goal

    def _best(self, way: list[Mark]) -> int:
        """Return which step of a way is its end."""
        if self._course.is_given or self._course.is_fixed:
            return len(way) - 1
        scores = [self._score(mark) for mark in way]
        return int(np.nanargmin(scores)) if np.isfinite(scores).any() else len(way) - 1

    def _score(self, mark: Mark) -> float:
        if self._course.is_measured:
            return mark.held_out + PRICE * mark.log2_area
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
            left = self.way[self.step].mismatch
        rest = [self.energy.relative_mismatch(carried) for _, carried in self._at_rest]
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
            marks.append(Mark(stage, point.x, point.advected, descent.mismatch))
        if not marks:
            return
        on_the_mesh = [mark for mark in marks if mark.stage.level >= own]
        best = min(on_the_mesh or marks, key=lambda mark: mark.mismatch)
        self.way = next((way for way in ways if best in way), self.way)
        if best in self.way and on_the_mesh:
            return
        level = descent.exact(max(best.stage.level, own))
        x, carried = descent.kept(best.x, best.stage.level, level, best.mismatch)
        energy, on = descent.levels[level].energy, replace(best.stage, level=level)
        self.way = [*self.way, Mark(on, x, carried, energy.relative_mismatch(carried))]

    def path(self) -> tuple[PathStep, ...]:
        """Return the way, with its fields on the mesh itself or on finer ones, in its units."""
        return tuple(mark.step(self._velocity(mark)) for mark in self.way)

    def _velocity(self, mark: Mark) -> FloatArray:
        x, descent, level = mark.x, self._descent, mark.stage.level
        for coarser in descent.levels[level : descent.own]:
            x = coarser.fields_to_finer(x)
        mesh = descent.levels[max(level, descent.own)].energy.mesh
        return to_ambient(mesh, x) * self.energy.length_scale
