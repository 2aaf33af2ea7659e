"""Subprocesses as a `concurrent.futures.Executor`, and a loop over results of any executor."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextvars import Context, copy_context
from functools import partial
from queue import Empty, SimpleQueue
from typing import Any, TypeVar

from abfm.workers.progress import report_step, reporting_steps
from abfm.workers.worker import Worker, no_state

Task = TypeVar("Task")
Result = TypeVar("Result")

ONE_THREAD = {
    f"{name}_NUM_THREADS": "1" for name in ("OMP", "MKL", "OPENBLAS", "NUMBA", "VECLIB_MAXIMUM")
}
"""Environment that makes compiled libraries use one thread.

Each call then takes one core, and sums do not depend on the number of threads.
"""
ENDED_MESSAGE = "the process has ended"
CALLS_SUBMITTED_MAX = 2000
"""Calls submitted at once: more than there are workers, and few enough to cancel quickly."""
_POLL_SECONDS = 0.1  # time between two calls of `is_wanted`


class Processes(Executor):
    """Subprocesses on this machine, each of which computes in one thread.

    At most ``count`` processes run. A process starts when a call first needs it. If a process dies,
    only its call raises `WorkerEndedError`, and the next call starts another process. Steps of
    calls are reported to the thread that submitted them.
    """

    def __init__(self, count: int) -> None:
        self._threads = ThreadPoolExecutor(count)  # each thread waits for one process
        self._workers = [Worker(no_state, ENDED_MESSAGE, ONE_THREAD) for _ in range(count)]
        self._idle = self._workers[::-1]  # a stack; the last worker gets the next call

    def submit(
        self, function: Callable[..., Result], /, *given: Any, **named: Any
    ) -> Future[Result]:
        return self._threads.submit(self._call, partial(function, *given, **named), copy_context())

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Refuse further calls.

        With ``wait``, wait for running calls and then end the processes. With ``cancel_futures``,
        end running calls and processes at once.
        """
        self._threads.shutdown(wait and not cancel_futures, cancel_futures=cancel_futures)
        if wait or cancel_futures:
            for worker in self._workers:
                worker.close()
        self._threads.shutdown(wait)

    def _call(self, call: Callable[[], Result], submitted: Context) -> Result:
        worker = self._idle.pop()
        try:
            with reporting_steps(lambda step: submitted.run(report_step, step)):
                return worker.call(_call_in_process, call).result()
        finally:
            self._idle.append(worker)


def _call_in_process(state: None, call: Callable[[], Result]) -> Result:
    return call()


def completed(
    submit: Callable[[Task], Future[Result]],
    tasks: deque[Task],
    is_wanted: Callable[[], bool],
    submitted_max: int = CALLS_SUBMITTED_MAX,
) -> Iterator[tuple[Task, Future[Result]]]:
    """Submit tasks, and yield each task with its future when it completes.

    ``submit`` submits a task to an executor, at most ``submitted_max`` at once. Tasks are submitted
    from the left of the deque ``tasks``, to which tasks may be added during the iteration. The
    iteration ends when all tasks are complete or ``is_wanted`` returns false. This is checked
    before each submission, and ten times a second. Calls that are still running are not cancelled.
    """
    waiting, ended = dict[Future[Result], Task](), SimpleQueue[Future[Result]]()
    while (tasks or waiting) and is_wanted():
        if tasks and len(waiting) < submitted_max:
            task = tasks.popleft()
            future = submit(task)
            waiting[future] = task
            future.add_done_callback(ended.put)
            continue
        try:
            future = ended.get(timeout=_POLL_SECONDS)
        except Empty:
            continue
        yield waiting.pop(future), future


def in_order(numbered: Iterable[tuple[int, Result]]) -> Iterator[Result]:
    """Yield the items of pairs (number, item) in the order of their numbers 0, 1, 2, ..."""
    early, following = dict[int, Result](), 0
    for number, each in numbered:
        early[number] = each
        while following in early:
            yield early.pop(following)
            following += 1
