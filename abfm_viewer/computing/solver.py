"""The solver: one run at a time in a thread that takes immutable problems, posts snapshots and
never draws.
"""

from __future__ import annotations

import threading
import traceback
from concurrent.futures import wait
from contextlib import suppress

import abfm
from abfm import AbfmError, ParameterError, Parameters, TriangleMesh
from abfm.numerics.factoring_apart import factoring_apart
from abfm.types import FloatArray
from abfm.workers.control import controlled
from abfm.workers.progress import Step, telling
from abfm_viewer.computing.background import THREADS, error_line
from abfm_viewer.computing.energies import Energies
from abfm_viewer.computing.evaluation import Functions
from abfm_viewer.computing.freed_memory import give_back
from abfm_viewer.computing.keeping import Keeper
from abfm_viewer.computing.match_apart import MatchApart, is_pictured
from abfm_viewer.computing.problem import ProblemSpec, Snapshot, State
from abfm_viewer.document.document import Run

_ITERATIONS_BETWEEN_RESTARTS = 3
_LAST_MOMENT = 0.1  # seconds for a run to end when it is closed, before its process is ended
_HEAD_START = 0.02  # seconds for a run to get under way, which else waits until a frame is drawn


class Solver:
    """At most one run: a problem, and those that take its place on the way.

    Attributes
    ----------
    follow : bool
        Whether a change of the problem during a run restarts it from the current field.
    warm : bool
        Whether a new run starts from the current field instead of zero.
    reason : str
        Why the last run ended; an error in one line if it failed.
    problem : ProblemSpec or None
        The newest one given.
    """

    def __init__(self) -> None:
        self.follow = True
        self.warm = False
        self.state = State.IDLE
        self.reason = ""
        self.problem: ProblemSpec | None = None
        self.snapshot: Snapshot | None = None  # may be read at any time
        # of the run, where that is not another iteration; may be read at any time
        self.step: Step | None = None
        self.started = 0  # how many runs there were
        self._keeper = Keeper(0)
        self._apart = MatchApart()
        self._energies = Energies()
        self._lock = threading.Lock()

    @property
    def pid(self) -> int | None:
        """The number of the process that matches; None before it starts."""
        return self._apart.pid

    def prepare(self, mesh: TriangleMesh, parameters: Parameters) -> None:
        """Make the coarser meshes ahead, on which a run of this mesh begins."""
        self._apart.prepare(mesh, parameters)

    @property
    def running(self) -> bool:
        """Whether a run has begun and not ended; also while it is paused."""
        return self.state in (State.RUNNING, State.PAUSED, State.ENDING)

    @property
    def paused(self) -> bool:
        return self.state is State.PAUSED

    @property
    def _goes_on(self) -> bool:
        """Whether the run was neither cancelled nor closed, which its thread may outlive."""
        return self.state in (State.RUNNING, State.PAUSED)

    @property
    def finished(self) -> bool:
        """Whether there was a run and it ended, well or not."""
        return self.state in (State.ENDED, State.FAILED)

    @property
    def failed(self) -> bool:
        return self.state is State.FAILED

    @property
    def run(self) -> Run | None:
        """The energies of the run so far."""
        snapshot = self.snapshot
        if not self.running or snapshot is None or self.problem is None:
            return None
        return self._energies.run(snapshot.iteration.mismatch, self.problem.parameters)

    @property
    def seconds_each(self) -> float | None:
        """How long an iteration takes at present; None if unknown."""
        return None if self.paused else self._energies.seconds_each

    def start(
        self, problem: ProblemSpec, functions: Functions, field: FloatArray | None = None
    ) -> None:
        """Begin a run, from a field (N, F, 3) if there is one."""
        self.state, self.reason, self.snapshot, self.step = State.RUNNING, "", None, None
        self.started += 1
        self.problem = problem
        self._next: ProblemSpec | None = problem
        self._result: abfm.Match | None = None
        self._keeper = Keeper(len(problem.mesh.vertices))
        self._error = ""
        self._energies = Energies()
        self._control = abfm.Control()
        self._since_restart = 0
        self._under_way = threading.Event()
        self._working = THREADS.submit(self._work, functions, field)
        self._under_way.wait(_HEAD_START)

    def pause(self) -> None:
        with self._lock:
            if self.state is State.RUNNING:
                self.state = State.PAUSED
                self._control.pause()

    def resume(self) -> None:
        with self._lock:
            if self.state is State.PAUSED:
                self.state = State.RUNNING
                self._control.resume()

    def cancel(self, briefly: bool = False) -> None:
        """Ask for the best field so far, unchecked if ``briefly``; returns at once."""
        with self._lock:
            if self.running:
                self.state = State.ENDING
                self._control.cancel(briefly)

    def follow_problem(self, problem: ProblemSpec, dragging: bool = False) -> None:
        """Restart with a changed problem; another alpha, which must be factored, only when the
        mouse lets go.
        """
        if not self.running or self.problem is None or problem == self.problem:
            return
        if problem.mesh is not self.problem.mesh:
            self.cancel()
            return
        refactors = problem.parameters.alpha != self.problem.parameters.alpha
        if not self.follow or not problem.channels or (dragging and refactors):
            return
        with self._lock:
            if self.state is not State.ENDING:
                self.problem = self._next = problem
                self._yield_to_next()

    def wait(self, seconds: float | None = None) -> bool:
        """Return when the run is over, or the time is; whether it is over, though not yet
        collected.
        """
        if self.running:
            wait([self._working], seconds)
        return not (self.running and not self._working.done())

    def collect(self) -> tuple[abfm.Match | None, Run | None, ProblemSpec] | None:
        """Return what a run that has ended leaves, failed or not; None unless one has ended since
        the last call.
        """
        if not self.running or self.problem is None or not self._working.done():
            return None
        left = (self._result, self.run, self.problem)
        self.state = State.FAILED if self._error else State.ENDED
        self.reason = self._error or (self._result.stop_reason if self._result else "cancelled")
        self.snapshot = self.step = self._result = None
        self._keeper = Keeper(0)
        return left

    def unfinished(self, snapshot: Snapshot, functions: Functions) -> tuple[abfm.Match, Run | None]:
        """A snapshot as if the run had been cancelled there, and its energies; it waits, so not for
        the frame loop.

        AbfmError if its field is not known any more. The last one asked for is kept, should the run
        fail.
        """
        problem, energies, keeper = snapshot.problem, self._energies, self._keeper
        run = energies.run(snapshot.iteration.mismatch, problem.parameters)
        found = snapshot.as_match(functions, run)
        keeper.keep(snapshot)
        return found, run

    def forget(self) -> None:
        """Let the last run be as if it had not been."""
        self.state, self.reason = State.IDLE, ""

    def close(self, seconds: float = 1) -> None:
        """End the thread, and the process if it still matches after a moment; a thread ends
        between two evaluations, not waited for long.
        """
        self.cancel(briefly=True)
        self.wait(min(seconds, _LAST_MOMENT))
        self._apart.close()
        self.wait(seconds)
        self.forget()

    # In the thread

    @factoring_apart()
    def _work(self, functions: Functions, start: FloatArray | None) -> None:
        try:
            while (problem := self._take()) is not None:
                if self._result is not None:
                    start = self._result.start_for(problem.parameters)
                    self._energies.restart()
                self._result = self._solve(problem, functions, start)
        except Exception as error:
            if not isinstance(error, AbfmError | MemoryError):
                traceback.print_exc()
            self._error = error_line(error)
            self._rescue(functions)
        give_back()

    def _rescue(self, functions: Functions) -> None:
        """Keep what a run that fails has found."""
        newest = self.snapshot if self._since_restart else None
        for snapshot in (newest, self._keeper.newest):
            if snapshot is not None:
                with suppress(AbfmError, MemoryError):  # where its process was killed
                    self._result, _ = self.unfinished(snapshot, functions)
                    return

    def _take(self) -> ProblemSpec | None:
        """The problem to solve now, with a control of its own."""
        with self._lock:
            problem, self._next = self._next, None
            self._control = abfm.Control()
            self._since_restart = 0
            self._keeper.begin(problem)
            if self.state is State.PAUSED:
                self._control.pause()
            return problem if self._goes_on or self._result is None else None

    def _solve(
        self, spec: ProblemSpec, functions: Functions, start: FloatArray | None
    ) -> abfm.Match:
        problem = spec.problem(functions)
        with self._lock:
            if not self._goes_on:
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
        before = self.snapshot
        is_first = before is None or before.problem is not problem
        shown = now if is_pictured(now) or is_first or before is None else before.shown
        self.snapshot = Snapshot(problem, now, shown)
        self._energies.add(now)
        self._since_restart += 1
        self._keeper.fetch(self.snapshot)
        with self._lock:
            self._yield_to_next()

    def _yield_to_next(self) -> None:
        """End the present solve for the next problem, but not so soon that a drag would keep it
        from moving.
        """
        if self._next is not None and self._since_restart >= _ITERATIONS_BETWEEN_RESTARTS:
            self._control.cancel(briefly=True)
