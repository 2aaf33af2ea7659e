"""The solver's thread: takes immutable problems, posts snapshots, and never touches the screen."""

from __future__ import annotations

import threading
import time as clock
import traceback
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

import abfm
from abfm import AbfmError, ParameterError, Parameters, TriangleMesh
from abfm.numerics.own_process import factoring_apart
from abfm.types import FloatArray
from abfm_viewer.computing.background import one_line
from abfm_viewer.computing.evaluation import Functions
from abfm_viewer.document.document import Channel, Run

if TYPE_CHECKING:
    from abfm import Iteration, Match

_ITERATIONS_BETWEEN_RESTARTS = 3
_TIMES_A_PICTURE, _LONGEST_WAIT = 9, 0.2
"""How long no picture is made after one, times what it took, and at most, in seconds."""


@dataclass(frozen=True)
class Problem:
    """What is solved; problems that are equal have the same solution."""

    mesh: TriangleMesh
    channels: tuple[Channel, ...]
    parameters: Parameters
    mask: str


@dataclass(frozen=True, eq=False)
class Snapshot:
    """What is known of a run at some moment.

    Attributes
    ----------
    problem : Problem
        That the newest iterate belongs to.
    iteration : Iteration
        The newest iterate.
    shown : Iteration
        The newest one that is worth a picture: its ``advected`` has been computed.
    """

    problem: Problem
    iteration: Iteration
    shown: Iteration


class Worker:
    """One run in a thread of its own: a problem, and those that take its place on the way.

    What it posts may be read at any time.

    Attributes
    ----------
    problem : Problem
        The newest one given.
    snapshot : Snapshot or None
        The newest iterate.
    result : Match or None
        Set when the run ended well or was cancelled after its start.
    error : str
        Why the run ended early, in one line.
    """

    def __init__(self, problem: Problem, functions: Functions, start: FloatArray | None = None) -> None:
        self.problem = problem
        self.snapshot: Snapshot | None = None
        self.result: Match | None = None
        self.error = ""
        self._functions = functions
        self._rows: list[tuple[float, float, float]] = []
        self._stages: list[int] = []
        self._vertices: list[int] = []
        self._reaches: list[float] = []
        self._restarts: list[int] = []
        self._lock = threading.Lock()
        self._next: Problem | None = problem
        self._control = abfm.Control()
        self._cancelled = self._paused = False
        self._since_restart = 0
        self._next_picture = 0.0
        self._thread = threading.Thread(target=self._run, args=(start,), name="solver", daemon=True)
        self._thread.start()

    @property
    def running(self) -> bool:
        """Whether the thread is still at work, or paused."""
        return self._thread.is_alive()

    @property
    def paused(self) -> bool:
        """Whether it waits for `resume`."""
        return self._paused and self.running

    @property
    def rows(self) -> int:
        """How many iterates there were."""
        return len(self._stages)

    def run(self) -> Run:
        """The energies so far."""
        count = self.rows
        energies = np.array(self._rows[:count]).reshape(count, 3)
        snapshot, parameters = self.snapshot, self.problem.parameters
        mismatch = snapshot.iteration.mismatch if snapshot else 1.0
        label = f"alpha {parameters.alpha:g}, beta {parameters.beta:g}, sigma {parameters.sigma:g}"
        return Run(
            energies,
            np.array(self._stages[:count], dtype=np.int64),
            tuple(self._restarts),
            mismatch,
            label,
            np.array(self._vertices[:count], dtype=np.int64),
            np.array(self._reaches[:count], dtype=np.float64),
        )

    def pause(self) -> None:
        """Hold the run."""
        with self._lock:
            self._paused = True
            self._control.pause()

    def resume(self) -> None:
        """Go on."""
        with self._lock:
            self._paused = False
            self._control.resume()

    def cancel(self) -> None:
        """Ask for the best result so far; returns at once."""
        with self._lock:
            self._cancelled = True
            self._control.cancel()

    def restart(self, problem: Problem) -> None:
        """Go on with another problem on the same mesh, from the field that was found so far."""
        with self._lock:
            if not self._cancelled:
                self.problem = self._next = problem
                self._yield_to_next()

    def wait(self, seconds: float | None = None) -> None:
        """Return when the thread has ended, or the time is over."""
        self._thread.join(seconds)

    @factoring_apart()
    def _run(self, start: FloatArray | None) -> None:
        try:
            while (problem := self._take()) is not None:
                if self.result is not None:
                    start = self.result.start_for(problem.parameters)
                    self._restarts.append(self.rows)
                match = self._solve(problem, start)
                self.result = match
        except Exception as error:
            if not isinstance(error, AbfmError | MemoryError):
                traceback.print_exc()
            self.error = one_line(error)

    def _take(self) -> Problem | None:
        """The problem to solve now, with a control of its own."""
        with self._lock:
            problem, self._next = self._next, None
            self._control = abfm.Control()
            self._since_restart = 0
            if self._paused:
                self._control.pause()
            return None if self._cancelled and self.result is not None else problem

    def _solve(self, problem: Problem, start: FloatArray | None) -> Match:
        functions = self._functions
        sources, targets = (
            np.stack([functions.evaluate(channel.spec(side)) for channel in problem.channels], axis=1)
            for side in ("source", "target")
        )
        mask = functions.evaluate(problem.mask) if problem.mask else None
        weights = [channel.weight for channel in problem.channels]
        with self._lock:
            if self._cancelled:
                self._control.cancel()

        def post(iteration: Iteration) -> None:
            self._post(problem, iteration)

        def solve(from_field: FloatArray | None) -> Match:
            return abfm.match(
                problem.mesh,
                sources,
                targets,
                problem.parameters,
                mask=mask,
                weights=weights,
                start=from_field,
                on_iteration=post,
                control=self._control,
            )

        try:
            return solve(start)
        except ParameterError as error:
            if start is None or not str(error).startswith("start"):
                raise
            return solve(None)  # a field for other parameters may be too fast for these

    def _post(self, problem: Problem, iteration: Iteration) -> None:
        self._rows.append((iteration.energy, iteration.regularity, iteration.mismatch_energy))
        self._vertices.append(iteration.vertices)
        self._reaches.append(iteration.reach)
        self.snapshot = Snapshot(problem, iteration, self._pictured(problem, iteration))
        self._stages.append(iteration.stage)
        self._since_restart += 1
        with self._lock:
            self._yield_to_next()

    def _pictured(self, problem: Problem, iteration: Iteration) -> Iteration:
        """The iterate to show: the new one, or an earlier one, so that pictures take a tenth of the time.

        An iterate on a coarse mesh may take less time than its picture on a fine one.
        """
        before, now = self.snapshot, clock.perf_counter()
        if before is not None and before.problem is problem and now < self._next_picture:
            return before.shown
        _ = iteration.advected  # computed here and kept: not in the frame loop
        done = clock.perf_counter()
        self._next_picture = done + min(_TIMES_A_PICTURE * (done - now), _LONGEST_WAIT)
        return iteration

    def _yield_to_next(self) -> None:
        """End the present solve for the next problem, but not so soon that a drag would keep it from moving."""
        if self._next is not None and self._since_restart >= _ITERATIONS_BETWEEN_RESTARTS:
            self._control.cancel(briefly=True)
