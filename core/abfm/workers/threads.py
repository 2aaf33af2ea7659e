"""Threads for jobs that do not keep the program from ending."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Executor, Future
from functools import partial
from typing import ParamSpec, TypeVar

# seconds without a job after which a thread ends; the next job starts another thread
_IDLE_SECONDS = 10.0

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")
_Job = Callable[[], None]


class DaemonThreads(Executor):
    """An executor with as many threads as there are jobs at once, so that no job waits for another.

    The executor lets a program end during jobs, unlike `concurrent.futures.ThreadPoolExecutor`.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._condition = threading.Condition()
        self._waiting: deque[_Job] = deque()
        self._idle = 0

    def submit(
        self,
        function: Callable[Arguments, Result],
        /,
        *given: Arguments.args,
        **named: Arguments.kwargs,
    ) -> Future[Result]:
        """Run a function in a thread; raise RuntimeError if no thread can start."""
        future = Future[Result]()

        def job() -> None:
            if future.set_running_or_notify_cancel():
                try:
                    future.set_result(function(*given, **named))
                except BaseException as error:  # after SystemExit too, the thread continues
                    future.set_exception(error)

        with self._condition:
            if self._idle > len(self._waiting):
                self._waiting.append(job)
                self._condition.notify()
            else:
                work = partial(self._work, [job])
                threading.Thread(target=work, name=self._name, daemon=True).start()
        return future

    def _work(self, jobs: list[_Job]) -> None:
        while jobs:
            jobs.pop()()  # popped, so that an idle thread holds no reference to it
            with self._condition:
                self._idle += 1
                self._condition.wait_for(lambda: self._waiting, _IDLE_SECONDS)
                self._idle -= 1
                if self._waiting:
                    jobs.append(self._waiting.popleft())
