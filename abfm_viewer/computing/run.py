"""Long computations in a subprocess, one at a time, which can be paused and cancelled."""

import threading
import traceback
from collections.abc import Callable
from concurrent.futures import Future, wait
from contextlib import suppress
from enum import Enum
from typing import Any, ClassVar, Generic, TypeVar

from abfm import AbfmError
from abfm.numerics.factoring_in_subprocess import factoring_in_subprocess
from abfm.tasks.monitor import ignore
from abfm.workers.control import CancelledError, Control, controlled
from abfm.workers.progress import Overall, Step, reporting_steps
from abfm.workers.worker import Call, Worker, WorkerEndedError
from abfm_viewer.computing.background import THREADS, error_line
from abfm_viewer.computing.freed_memory import return_free_memory

Result = TypeVar("Result")
Value = TypeVar("Value")
ProcessCache = dict[int, Any]  # values that functions store in their process for later calls

_ENDED_MESSAGE = (
    "the computing process ended unexpectedly, possibly because memory ran out; try again"
)
_IDLE_WORKERS_MAX = 2  # a session has one process for runs, and one for initial maps
_CLOSE_SECONDS = 0.1  # time for a closed run to end before its process is killed
_START_SECONDS = 0.02  # wait for a run to begin, which drawing would delay


class Process:
    """A subprocess that calls functions one after another; their first argument is its cache.

    The subprocess starts with the first call. If it has ended, the next call starts another one.
    When a `Process` is closed, the next one reuses its subprocess if that is idle.

    A thread would be too slow: polyscope holds Python's interpreter while it draws, nearly all of
    the time without a graphics card. A solver in a thread got a tenth of the time.
    """

    _idle_workers: ClassVar[list[Worker[ProcessCache]]] = []

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._worker: Worker[ProcessCache] | None = None
        self._is_closed = False

    def call(self, function: Callable[..., Value], *given: Any) -> Call[Value]:
        return self._started().call(function, *given)

    def call_now(self, function: Callable[..., Value], *given: Any) -> Value:
        """Return the result of a short function, called at once, even during another call."""
        return self._started().call_now(function, *given).result()

    def solve(
        self,
        function: Callable[..., Value],
        *given: Any,
        on_partial: Callable[[Any], object] = ignore,
        tries: int = 1,
    ) -> Value:
        """Call a function in the subprocess, wait until it ends, and return its result.

        ``on_partial`` is called with each partial result. If the subprocess ends during a call, the
        function is called again, at most ``tries`` times in all. If the subprocess ends each time,
        a `WorkerEndedError` is raised.
        """
        for _ in range(1, tries):
            with suppress(WorkerEndedError):
                return self.call(function, *given).result(on_partial)
        return self.call(function, *given).result(on_partial)

    def close(self) -> None:
        """Accept no more calls, and end a running one at once."""
        with self._lock:
            worker, self._worker, self._is_closed = self._worker, None, True
        if worker and worker.is_idle and len(self._idle_workers) < _IDLE_WORKERS_MAX:
            self._idle_workers.append(worker)
        elif worker:
            worker.close()

    def _started(self) -> Worker[ProcessCache]:
        with self._lock:
            if self._is_closed:
                raise WorkerEndedError(_ENDED_MESSAGE)
            if self._worker is None:
                idle = self._idle_workers
                self._worker = idle.pop() if idle else Worker(dict, _ENDED_MESSAGE)
            return self._worker


RunState = Enum("RunState", "IDLE RUNNING PAUSED ENDING ENDED FAILED")
"""State of a run; a cancelled run is ENDING until it is collected, then ENDED or FAILED."""


class Run(Generic[Result]):
    """Executes one computation at a time, in a thread that calls functions in a subprocess."""

    def __init__(self, process: Process) -> None:
        self.process = process
        self.state, self.reason = RunState.IDLE, ""  # why the last run failed, in one line
        self.overall = Overall()  # progress of the latest run
        self.started = 0  # number of runs
        self.has_partial_results = False  # including results of an earlier run
        self._lock = threading.Lock()
        self._has_reported = threading.Event()

    @property
    def is_active(self) -> bool:
        """Whether a computation is in progress that was neither cancelled nor closed."""
        return self.state in (RunState.RUNNING, RunState.PAUSED)

    @property
    def running(self) -> bool:
        return self.is_active or self.state is RunState.ENDING

    @property
    def paused(self) -> bool:
        return self.state is RunState.PAUSED

    @property
    def finished(self) -> bool:
        return self.state in (RunState.ENDED, RunState.FAILED)

    @property
    def failed(self) -> bool:
        return self.state is RunState.FAILED

    def start(
        self,
        work: Callable[[], Result],
        then: Callable[[Result | None], object],
        recover: Callable[[], Result | None] = lambda: None,
        resumes: bool = False,
    ) -> None:
        """Start ``work``, which calls functions in the subprocess by `call`, in a thread.

        When the run is over, `collect` passes the result to ``then``. After an error it passes the
        result of ``recover``. ``resumes`` is true if partial results of an earlier run exist.
        """
        self.state, self.reason, self.overall = RunState.RUNNING, "", Overall(has_phases=True)
        self.started, self.has_partial_results = self.started + 1, resumes
        self._control, self._then = Control(), then
        self._result: Result | None = None
        self._has_reported.clear()
        self._working: Future[None] = THREADS.submit(self._work, work, recover)
        self._has_reported.wait(_START_SECONDS)

    def pause(self) -> None:
        self._switch(RunState.RUNNING, RunState.PAUSED)

    def resume(self) -> None:
        self._switch(RunState.PAUSED, RunState.RUNNING)

    def toggle(self) -> None:
        """Pause the run, or resume it if it is paused."""
        self.resume() if self.paused else self.pause()

    def _switch(self, before: RunState, after: RunState) -> None:
        with self._lock:
            if self.state is before:
                self.state = after
                self.overall.set_paused(self.paused)
                self._control.set_paused(self.paused)

    def cancel(self, skip_checks: bool = False) -> None:
        """Cancel the run without waiting; ``skip_checks`` leaves its best result unverified."""
        with self._lock:
            if self.running:
                self.state = RunState.ENDING
                self._control.cancel(skip_checks)

    def wait(self, seconds: float | None = None) -> bool:
        """Wait at most ``seconds`` until the run is over; return whether it is over."""
        return not self.running or not wait([self._working], seconds).not_done

    def collect(self) -> None:
        """Pass the result to the callback of `start` if the run is over; do so only once."""
        if self.running and self._working.done():
            self.state = RunState.FAILED if self.reason else RunState.ENDED
            found, then = self._result, self._then
            self.overall.update(None)
            self._result, self._then = None, ignore
            then(found)

    def forget(self) -> None:
        self.state, self.reason = RunState.IDLE, ""

    def close(self, seconds: float = 1) -> None:
        """Cancel the run, and kill its subprocess if the run does not end soon."""
        self.cancel(skip_checks=True)
        self.wait(min(seconds, _CLOSE_SECONDS))
        self.process.close()
        self.wait(seconds)
        self.forget()

    # The methods below are called in the thread of the run

    def call(
        self,
        function: Callable[..., Value],
        *given: Any,
        on_partial: Callable[[Any], object] = ignore,
        tries: int = 1,
    ) -> Value:
        """Return the result of `Process.solve`, which is paused and cancelled with the run."""

        def take(partial: Any) -> None:
            self._has_reported.set()
            self.has_partial_results = True
            on_partial(partial)

        with self._lock:
            self._control = control = Control()
            control.set_paused(self.paused)
            if not self.is_active:
                control.cancel()
        with reporting_steps(self._set_step), controlled(control):
            return self.process.solve(function, *given, on_partial=take, tries=tries)

    def end_call(self) -> None:
        """End the current call, but not the run, with its best result so far, unverified."""
        self._control.cancel(skip_checks=True)

    @factoring_in_subprocess()
    def _work(self, work: Callable[[], Result], recover: Callable[[], Result | None]) -> None:
        try:
            self._result = work()
        except Exception as error:
            if not isinstance(error, AbfmError | CancelledError | MemoryError):
                with suppress(OSError, ValueError):  # if the terminal is closed
                    traceback.print_exc()
            self.reason = error_line(error)
            with suppress(AbfmError, MemoryError):
                self._result = recover()
        return_free_memory()

    def _set_step(self, step: Step | None) -> None:
        self.overall.update(step)
        self._has_reported.set()
