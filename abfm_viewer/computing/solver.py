"""The solver: one run at a time in a thread that takes immutable problems and posts snapshots."""

from __future__ import annotations

import math
import threading
import time as clock
import traceback
from collections import deque
from concurrent.futures import wait
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

import abfm
from abfm import AbfmError, ParameterError, Parameters, TriangleMesh
from abfm.numerics.factoring_apart import factoring_apart
from abfm.outcome import outcome_of
from abfm.types import FloatArray
from abfm.workers.control import controlled
from abfm.workers.progress import Step, telling
from abfm_viewer.computing.background import THREADS, Memo, error_line
from abfm_viewer.computing.evaluation import Evaluators
from abfm_viewer.computing.freed_memory import give_back
from abfm_viewer.computing.match_apart import IteratePicture, MatchApart, better
from abfm_viewer.document.document import SIDES, Channel, InitialMap, Landmark, Run
from abfm_viewer.document.surface_points import paired

FIRST_KEEP_SECONDS = 2.0
"""Seconds of a run before a field is fetched to be kept: shorter ones lose little, and should
lose no time."""
_TIMES_A_FIELD = 49
_GROWTH = 1.5
_WAIT_SECONDS_MAX = 20.0
"""How long none is fetched after one, at least: times what it took, so that fetching takes 2% of
the time, and times the wait before; and at most."""
_SECONDS_PER_VERTEX = 1e-6  # of fetching one: 33 ms at 40,962 vertices
_RECENT_ITERATIONS = 20  # iterations that tell how long the next ones take
_ITERATIONS_BETWEEN_RESTARTS = 3
_LAST_MOMENT = 0.1  # seconds for a run to end when it is closed, before its process is ended
_HEAD_START = 0.02  # seconds for a run to get under way, which else waits until a frame is drawn


@dataclass(frozen=True)
class ProblemSpec:
    """What is solved, its functions as text; those that are equal have the same solution."""

    mesh: TriangleMesh
    channels: tuple[Channel, ...]
    parameters: Parameters
    mask: str
    landmarks: tuple[Landmark, ...] = ()  # whole ones
    landmarks_alone: bool = False  # whether functions are only carried, as long as there are some
    initial: InitialMap | None = None  # of two surfaces, from A to the mesh, which is B

    @property
    def is_of_landmarks(self) -> bool:
        return self.landmarks_alone and bool(self.landmarks)

    def problem(self, functions: Evaluators) -> abfm.Problem:
        specs = [[channel.spec(side) for channel in self.channels] for side in SIDES]
        source, target = (
            np.stack([functions.evaluate(spec, side) for spec in own], axis=1)
            for side, own in zip(SIDES, specs, strict=True)
        )
        mask = functions.evaluate(self.mask) if self.mask else None
        weights = [0.0 if self.is_of_landmarks else each.weight for each in self.channels]
        found = None if self.initial is None else self.initial.correspondence
        a = self.mesh if found is None else found.a
        marks = paired(a, self.mesh, self.landmarks)
        if found is not None:
            return abfm.registration.prepare(
                a,
                self.mesh,
                source,
                target,
                initial=found,
                landmarks=marks,
                parameters=self.parameters,
                mask_b=mask,
                weights=weights,
            ).problem
        problem = abfm.Problem(
            self.mesh,
            source,
            target,
            self.parameters,
            mask=mask,
            weights=weights,
            landmarks=None if marks is None else (marks.a, marks.b),
            landmark_weights=None if marks is None else marks.weights,
        )
        return problem.with_specs(*specs)


@dataclass(frozen=True, eq=False)
class Snapshot:
    """The newest iterate of a problem, and the best one so far that is `shown`, whose ``advected``
    is there. A new attempt of the solver starts with a larger residual than the one before.
    """

    problem: ProblemSpec
    iteration: abfm.Iteration
    shown: abfm.Iteration


RunState = Enum("RunState", "IDLE RUNNING PAUSED ENDING ENDED FAILED")
"""Of a run, which ends while it is cancelled, and has ended when `Solver.collect` has seen that."""
# neither cancelled nor closed, which its thread outlives
_LIVE_STATES = (RunState.RUNNING, RunState.PAUSED)


class RunHistory:
    """What a run has come to: one thread adds to it, others read.

    If its process is killed, the field of `best`, a snapshot of the present solve, is here.
    """

    def __init__(self, vertices: int = 0) -> None:
        self.best: Snapshot | None = None
        # total, regularity, mismatch; stage, vertices, reach, residual
        self._rows: list[tuple[float, float, float, int, int, float, float]] = []
        self._shares: list[dict[str, float]] = []
        self._restarts: list[int] = []
        self._run = Memo[Run]()
        self._recent: deque[float] = deque(maxlen=_RECENT_ITERATIONS)  # when they came
        self._problem: ProblemSpec | None = None
        self._wait = max(FIRST_KEEP_SECONDS, _TIMES_A_FIELD * _SECONDS_PER_VERTEX * vertices)
        self._next = clock.perf_counter() + self._wait

    def begin(self, problem: ProblemSpec) -> None:
        self.best, self._problem = None, problem
        if self._rows:
            self._restarts.append(len(self._rows))

    def add(self, now: abfm.Iteration) -> None:
        self._recent.append(clock.monotonic())
        energies = (now.energy, now.regularity, now.mismatch_energy)
        self._shares.append(now.shares)
        self._rows.append((*energies, now.stage, now.vertices, now.reach, now.residual))

    @property
    def seconds_each(self) -> float | None:
        times = list(self._recent)
        return (times[-1] - times[0]) / (len(times) - 1) if len(times) > 1 else None

    def run(self, residual: float, parameters: Parameters) -> Run | None:
        """The run so far, the same object while nothing is added; None before the first iterate."""
        rows, restarts = self._rows[:], tuple(self._restarts)

        def make() -> Run:
            table = np.array(rows)
            stages, vertices = (table[:, column].astype(np.int64) for column in (3, 4))
            sigma = "auto" if parameters.sigma is None else f"{parameters.sigma:g}"
            label = f"α {parameters.alpha:g}, β {parameters.beta:g}, σ {sigma}"
            run = Run(table[:, :3], stages, restarts, residual, label, vertices, table[:, 5])
            run = replace(run, residuals=table[:, 6])
            words = tuple(dict.fromkeys(word for row in self._shares for word in row))
            if len(words) == 1:
                return run
            shares = [[row.get(word, 0.0) for word in words] for row in self._shares[: len(rows)]]
            return replace(run, words=words, shares=np.array(shares))

        made_of = (len(rows), residual, parameters, restarts)
        return self._run.get(made_of, make) if rows else None

    def keep(self, snapshot: Snapshot) -> None:
        """Keep a snapshot whose field is here, unless it is of an earlier solve or a worse one."""
        if snapshot.problem is not self._problem:
            return
        if self.best is None or better(snapshot.shown, self.best.shown):
            self.best = snapshot

    def fetch(self, snapshot: Snapshot) -> None:
        """Fetch its field if it is time for one; it waits, so not for the frame loop."""
        began = clock.perf_counter()
        is_new = self.best is None or self.best.shown is not snapshot.shown
        if began < self._next or not snapshot.shown.iteration or not is_new:
            return
        with suppress(AbfmError):  # that the process has ended is told by what comes next
            _ = snapshot.shown.velocity
            self.keep(snapshot)
        now = clock.perf_counter()
        self._wait = max(
            min(_GROWTH * self._wait, _WAIT_SECONDS_MAX), _TIMES_A_FIELD * (now - began)
        )
        self._next = now + self._wait


class Solver:
    """At most one run: a problem, and those that take its place on the way."""

    def __init__(self) -> None:
        self.follow = True  # whether a change of the problem during a run restarts it
        self.warm = False  # whether a new run starts from the current field instead of zero
        self.state = RunState.IDLE
        self.reason = ""  # why the last run ended; an error in one line if it failed
        self.problem: ProblemSpec | None = None  # the newest one given
        self.snapshot: Snapshot | None = None  # may be read at any time, as the next one
        self.step: Step | None = None  # what is done where that is not another iteration
        self.started = 0  # how many runs there were
        self._course = RunHistory()
        self._apart = MatchApart()
        self.prepare = self._apart.prepare
        self._lock = threading.Lock()

    @property
    def running(self) -> bool:
        return self.state in (*_LIVE_STATES, RunState.ENDING)

    @property
    def paused(self) -> bool:
        return self.state is RunState.PAUSED

    @property
    def finished(self) -> bool:
        return self.state in (RunState.ENDED, RunState.FAILED)

    @property
    def failed(self) -> bool:
        return self.state is RunState.FAILED

    @property
    def run(self) -> Run | None:
        if not self.running or self.snapshot is None or self.problem is None:
            return None
        return self._course.run(0.0, self.problem.parameters)

    @property
    def seconds_each(self) -> float | None:
        return None if self.paused else self._course.seconds_each

    def start(
        self, problem: ProblemSpec, functions: Evaluators, field: FloatArray | None = None
    ) -> None:
        self.state, self.reason, self.snapshot, self.step = RunState.RUNNING, "", None, None
        self.started += 1
        self.problem = problem
        self._next: ProblemSpec | None = problem
        self._result: abfm.Match | None = None
        self._solved = problem  # that the result is of
        self._course = RunHistory(len(problem.mesh.vertices))
        self._error = ""
        self._control = abfm.Control()
        self._since_restart = 0
        self._under_way = threading.Event()
        self._working = THREADS.submit(self._work, functions, field)
        self._under_way.wait(_HEAD_START)

    def pause(self) -> None:
        with self._lock:
            if self.state is RunState.RUNNING:
                self.state = RunState.PAUSED
                self._control.pause()

    def resume(self) -> None:
        with self._lock:
            if self.state is RunState.PAUSED:
                self.state = RunState.RUNNING
                self._control.resume()

    def cancel(self, briefly: bool = False) -> None:
        """Ask for the best field so far, unchecked if ``briefly``; returns at once."""
        with self._lock:
            if self.running:
                self.state = RunState.ENDING
                self._control.cancel(briefly)

    def follow_problem(self, problem: ProblemSpec, dragging: bool = False) -> None:
        """Restart with a changed problem, another alpha when not dragging; end with its mesh."""
        if not self.running or self.problem is None or problem == self.problem:
            return
        if problem.mesh.digest != self.problem.mesh.digest:
            self.cancel()
            return
        refactors = problem.parameters.alpha != self.problem.parameters.alpha
        if not self.follow or not problem.channels or (dragging and refactors):
            return
        with self._lock:
            if self.state is not RunState.ENDING:
                self.problem = self._next = problem
                self._yield_to_next()

    def wait(self, seconds: float | None = None) -> bool:
        """Wait for the run to be over; whether it is, though not yet collected."""
        return not self.running or not wait([self._working], seconds).not_done

    def collect(self) -> tuple[abfm.Match | None, Run | None, ProblemSpec] | None:
        """Return, once, what a run that has ended leaves, failed or not, and what it solved."""
        if not self.running or self.problem is None or not self._working.done():
            return None
        run = self.run
        if run is not None and self.snapshot is not None:
            ends = self._result.path if self._result else (self.snapshot.iteration,)
            run = replace(run, residual=min(end.residual for end in ends))
        left = (self._result, run, self._solved)
        self.state = RunState.FAILED if self._error else RunState.ENDED
        self.reason = self._error or (self._result.stop_reason if self._result else "cancelled")
        self.snapshot = self.step = self._result = None
        self._course = RunHistory()
        return left

    def unfinished(self, snapshot: Snapshot, functions: Evaluators) -> tuple[abfm.Match, Run]:
        """Return the best field of a snapshot as if the run had been cancelled there, unverified,
        and the run's energies.

        It waits, so not for the frame loop; it is kept, should the run fail. AbfmError if its field
        is not known any more, or the run is over.
        """
        course, now = self._course, snapshot.shown
        if (run := course.run(now.residual, snapshot.problem.parameters)) is None:
            raise AbfmError("the run of that iterate is over")
        reason = abfm.StopReason.CANCELLED
        kind = outcome_of(now.residual, snapshot.problem.parameters.goal)
        found = abfm.Match(
            problem=snapshot.problem.problem(functions),
            fine_velocity=now.velocity,
            advected=now.advected,
            energy_history=run.energies,
            stages=run.stages,
            residual=now.residual,
            verified_residual=math.nan,
            folded=math.nan,
            stop_reason=reason,
            verdict=abfm.matching.Verdict(kind, reason, ""),
        )
        course.keep(snapshot)
        return found, run

    def forget(self) -> None:
        """Let the last run be as if it had not been."""
        self.state, self.reason = RunState.IDLE, ""

    def close(self, seconds: float = 1) -> None:
        """End the thread, between two evaluations, and the process if that takes long."""
        self.cancel(briefly=True)
        self.wait(min(seconds, _LAST_MOMENT))
        self._apart.close()
        self.wait(seconds)
        self.forget()

    # In the thread

    @factoring_apart()
    def _work(self, functions: Evaluators, start: FloatArray | None) -> None:
        try:
            while (problem := self._take()) is not None:
                self._course.begin(problem)
                if self._result is not None:
                    start = self._result.start_for(problem.parameters)
                self._result = self._solve(problem, functions, start)
                self._solved = problem
        except Exception as error:
            if not isinstance(error, AbfmError | MemoryError):
                traceback.print_exc()
            self._error = error_line(error)
            # what a run that fails has found
            for snapshot in (self.snapshot if self._since_restart else None, self._course.best):
                with suppress(AbfmError, MemoryError):  # where its process was killed
                    if snapshot is not None:
                        self._result, _ = self.unfinished(snapshot, functions)
                        self._solved = snapshot.problem
                        break
        give_back()

    def _take(self) -> ProblemSpec | None:
        with self._lock:
            problem, self._next = self._next, None
            self._control = abfm.Control()
            self._since_restart = 0
            if self.state is RunState.PAUSED:
                self._control.pause()
            return problem if self.state in _LIVE_STATES or self._result is None else None

    def _solve(
        self, spec: ProblemSpec, functions: Evaluators, start: FloatArray | None
    ) -> abfm.Match:
        problem = spec.problem(functions)
        with self._lock:
            if self.state not in _LIVE_STATES:
                self._control.cancel()

        def solve(problem: abfm.Problem) -> abfm.Match:
            with telling(self._at), controlled(self._control):
                return self._apart.match(problem, lambda now: self._post(spec, now))

        try:
            return solve(problem.starting_from(start))
        except ParameterError as error:
            if start is None or not str(error).startswith("start"):
                raise
            return solve(problem)  # a field for other parameters may be too fast for these

    def _at(self, step: Step | None) -> None:
        self.step = step
        self._under_way.set()

    def _post(self, problem: ProblemSpec, now: abfm.Iteration) -> None:
        self._under_way.set()
        self._course.add(now)
        shown, before = now, self.snapshot
        if before is not None and before.problem is problem:
            is_pictured = isinstance(now.look, IteratePicture) and now.look.picture is not None
            shown = now if is_pictured and better(now, before.shown) else before.shown
        self.snapshot = Snapshot(problem, now, shown)
        self._since_restart += 1
        self._course.fetch(self.snapshot)
        with self._lock:
            self._yield_to_next()

    def _yield_to_next(self) -> None:
        """End this solve for the next problem, but not so soon that a drag keeps it from moving."""
        if self._next is not None and self._since_restart >= _ITERATIONS_BETWEEN_RESTARTS:
            self._control.cancel(briefly=True)
