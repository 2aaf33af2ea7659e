"""Long work in a subprocess: started, paused, cancelled and collected in the same way."""

from __future__ import annotations

import threading
import time
import traceback
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, wait
from contextlib import suppress
from enum import Enum
from typing import Any, ClassVar, Generic, TypeVar

from abfm import AbfmError
from abfm.numerics.factoring_apart import factoring_apart
from abfm.tasks.monitor import ignore
from abfm.workers.control import CancelledError, Control, controlled
from abfm.workers.progress import Step, telling
from abfm.workers.worker import Call, Worker, WorkerEndedError
from abfm_viewer.computing.background import THREADS, error_line
from abfm_viewer.computing.freed_memory import give_back

Result = TypeVar("Result")
Value = TypeVar("Value")
Kept = dict[int, Any]
"""What functions keep in their process for later calls."""

_ENDED_MESSAGE = "the process that computes has ended, as for want of memory; try again"
_SPARES_MAX = 2  # a session has a process for runs, and one for initial maps
_RECENT_PARTIALS = 20  # partial results from which the time of the next ones is estimated
_LAST_MOMENT = 0.1  # seconds for a run to end when it is closed, before its process is ended
_HEAD_START = 0.02  # seconds for a run to get under way, which else waits until a frame is drawn


class Process:
    """Calls functions in a subprocess, one after the other; their first argument is what they
    keep. It starts with the first call, and again with the next one after it has ended.

    While a frame is drawn polyscope holds Python's interpreter, without a graphics card nearly all
    of the time: a solver in a thread of the same process got a tenth of it. A process that is idle
    when it is closed is left to the next `Process`: a script that opens one window after the other
    needs no others.
    """

    _spare: ClassVar[list[Worker[Kept]]] = []

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._worker: Worker[Kept] | None = None
        self._is_closed = False

    def call(self, function: Callable[..., Value], *given: Any) -> Call[Value]:
        """Call a function after those called before, and do not wait for it."""
        return self._started().call(function, *given)

    def beside(self, function: Callable[..., Value], *given: Any) -> Value:
        """Return what a short function returns that is called at once, whatever is computed."""
        return self._started().beside(function, *given).result()

    def solve(
        self,
        function: Callable[..., Value],
        *given: Any,
        on_partial: Callable[[Any], object] = ignore,
        tries: int = 1,
    ) -> Value:
        """Return what a function returns. If the process ends, it is called again, up to so many
        times; WorkerEndedError if it ended each time.
        """
        for _ in range(1, tries):
            with suppress(WorkerEndedError):
                return self.call(function, *given).result(on_partial)
        return self.call(function, *given).result(on_partial)

    def close(self) -> None:
        """Take no more calls; one that is under way is ended at once."""
        with self._lock:
            worker, self._worker, self._is_closed = self._worker, None, True
        if worker and worker.is_idle and len(self._spare) < _SPARES_MAX:
            self._spare.append(worker)
        elif worker:
            worker.close()

    def _started(self) -> Worker[Kept]:
        with self._lock:
            if self._is_closed:
                raise WorkerEndedError(_ENDED_MESSAGE)
            if self._worker is None:
                self._worker = self._spare.pop() if self._spare else Worker(dict, _ENDED_MESSAGE)
            return self._worker


RunState = Enum("RunState", "IDLE RUNNING PAUSED ENDING ENDED FAILED")
"""A run that is cancelled is ENDING, and has ENDED or FAILED when it is collected."""


class Run(Generic[Result]):
    """At most one run at a time: work in a thread, which calls functions in a process."""

    def __init__(self, process: Process) -> None:
        self.process = process
        self.state, self.reason = RunState.IDLE, ""  # why the last run failed, in one line
        self.step: Step | None = None  # what is done at present, except another iteration
        self.started = 0  # how many runs there were
        self.has_found = False  # whether there were partial results, or may be earlier ones
        self._lock = threading.Lock()
        self._under_way = threading.Event()
        self._recent: deque[float] = deque(maxlen=_RECENT_PARTIALS)  # when they came

    @property
    def is_wanted(self) -> bool:
        """Whether a run is under way that was neither cancelled nor closed."""
        return self.state in (RunState.RUNNING, RunState.PAUSED)

    @property
    def running(self) -> bool:
        return self.is_wanted or self.state is RunState.ENDING

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
    def seconds_each(self) -> float | None:
        """Seconds from one partial result to the next; None if unknown, or while it is paused."""
        times = list(self._recent)
        is_known = len(times) > 1 and not self.paused
        return (times[-1] - times[0]) / (len(times) - 1) if is_known else None

    def start(
        self,
        work: Callable[[], Result],
        then: Callable[[Result | None], object],
        left: Callable[[], Result | None] = lambda: None,
        resumes: bool = False,
    ) -> None:
        """Start work in a thread, which uses `call`, perhaps from what an earlier run has found.
        `collect` passes its result to ``then``, or what is ``left`` after an error.
        """
        self.state, self.reason, self.step = RunState.RUNNING, "", None
        self.started, self.has_found = self.started + 1, resumes
        self._control, self._then = Control(), then
        self._result: Result | None = None
        self._recent.clear()
        self._under_way.clear()
        self._working: Future[None] = THREADS.submit(self._work, work, left)
        self._under_way.wait(_HEAD_START)

    def pause(self) -> None:
        self._hold(RunState.RUNNING, RunState.PAUSED)

    def resume(self) -> None:
        self._hold(RunState.PAUSED, RunState.RUNNING)

    def _hold(self, before: RunState, after: RunState) -> None:
        with self._lock:
            if self.state is before:
                self.state = after
                self._recent.clear()  # the time of a pause is no iteration's
                self._control.hold(self.paused)

    def cancel(self, briefly: bool = False) -> None:
        """Request what was found so far, unchecked if ``briefly``; returns at once."""
        with self._lock:
            if self.running:
                self.state = RunState.ENDING
                self._control.cancel(briefly)

    def wait(self, seconds: float | None = None) -> bool:
        """Wait for the run to be over; return whether it is, though not yet collected."""
        return not self.running or not wait([self._working], seconds).not_done

    def collect(self) -> None:
        """Pass the result of an ended run, or what a failed one left, to its receiver, once."""
        if self.running and self._working.done():
            self.state = RunState.FAILED if self.reason else RunState.ENDED
            found, then = self._result, self._then
            self.step, self._result, self._then = None, None, ignore
            then(found)

    def forget(self) -> None:
        """Let the last run be as if it had not been."""
        self.state, self.reason = RunState.IDLE, ""

    def close(self, seconds: float = 1) -> None:
        """End the thread, between two evaluations, and the process if that takes long."""
        self.cancel(briefly=True)
        self.wait(min(seconds, _LAST_MOMENT))
        self.process.close()
        self.wait(seconds)
        self.forget()

    # In the thread

    def call(
        self,
        function: Callable[..., Value],
        *given: Any,
        on_partial: Callable[[Any], object] = ignore,
        tries: int = 1,
    ) -> Value:
        """Return what `Process.solve` returns; it is paused and cancelled with the run."""

        def take(partial: Any) -> None:
            self._under_way.set()
            self._recent.append(time.monotonic())
            self.has_found = True
            on_partial(partial)

        with self._lock:
            self._control = control = Control()
            control.hold(self.paused)
            if not self.is_wanted:
                control.cancel()
        with telling(self._tell), controlled(control):
            return self.process.solve(function, *given, on_partial=take, tries=tries)

    def end_call(self) -> None:
        """End the present call with what was found, unchecked, though not the run."""
        self._control.cancel(briefly=True)

    @factoring_apart()
    def _work(self, work: Callable[[], Result], left: Callable[[], Result | None]) -> None:
        try:
            self._result = work()
        except Exception as error:
            if not isinstance(error, AbfmError | CancelledError | MemoryError):
                with suppress(OSError, ValueError):  # where the terminal is gone
                    traceback.print_exc()
            self.reason = error_line(error)
            with suppress(AbfmError, MemoryError):
                self._result = left()
        give_back()

    def _tell(self, step: Step | None) -> None:
        self.step = step
        self._under_way.set()
