"""Background jobs of which only the latest request counts, and a cache with one entry."""

import threading
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any, Generic, TypeVar

import numpy as np

from abfm import AbfmError
from abfm.errors import MESSAGE_LENGTH_MAX, one_line
from abfm.numerics.factoring_in_subprocess import factoring_in_subprocess
from abfm.workers.control import CancelledError
from abfm.workers.progress import Overall, reporting_steps
from abfm.workers.threads import DaemonThreads

Value = TypeVar("Value")

THREADS = DaemonThreads("background")  # threads for all work that the window does not wait for


def error_line(error: BaseException) -> str:
    """Return an error in one line, with its class unless it is about the user's input."""
    text = one_line(str(error), MESSAGE_LENGTH_MAX)
    if isinstance(error, AbfmError | OSError):
        return text
    if isinstance(error, MemoryError):
        return f"out of memory{': ' if text else ''}{text}"
    return f"{type(error).__name__}: {text}"


def same(one: object, other: object) -> bool:
    """Return whether two objects are equal; tuples are compared by entry, arrays by identity."""
    if one is other:
        return True
    if isinstance(one, tuple) and isinstance(other, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    are_arrays = isinstance(one, np.ndarray) or isinstance(other, np.ndarray)
    return not are_arrays and bool(one == other)


class Memo(Generic[Value]):
    """A cache with one entry, which is valid while its inputs are the `same` as before."""

    def __init__(self) -> None:
        self._entry: tuple[tuple[object, ...], Value] | None = None

    def get(self, inputs: tuple[object, ...], make: Callable[[], Value]) -> Value:
        if self._entry is None or not same(self._entry[0], inputs):
            self._entry = inputs, make()
        return self._entry[1]


class Latest(Generic[Value]):
    """Computes the latest request in a thread; older requests that have not begun are dropped.

    A request is identified by its key, which is compared by `same` and must not be None. `value` is
    the latest result and `key` its key. If the computation failed, `error` is the message in one
    line. With ``at_once`` requests are computed in the thread of the caller.

    At any time there is one requested key, and at most one key each that is waiting, running or
    finished. Three invariants hold until the object is retired:

    - The requested key is waiting, running or finished.
    - The waiting key is the requested key.
    - A finished result is not replaced while its key is the requested one.
    """

    def __init__(self, at_once: bool = False) -> None:
        self.key: object = None  # of the finished job
        self.value: Value | None = None
        self.error = ""
        self.overall = Overall()  # progress of the running job
        self.retired = False
        self._at_once = at_once
        self._requested: object = None
        self._job: Callable[[], Value] | None = None  # for the requested key, if it waits
        self._running: object = None
        self._has_thread = False
        self._condition = threading.Condition()

    @property
    def busy(self) -> bool:
        """Whether the requested key is waiting or running."""
        with self._condition:
            runs = self._running is not None and same(self._running, self._requested)
            return runs or self._job is not None

    @property
    def is_running(self) -> bool:
        """Whether any job is running, even one whose result is no longer requested."""
        with self._condition:
            return self._running is not None

    def request(self, key: object, compute: Callable[[], Value]) -> Value | None:
        """Request a value from ``compute``; return None until it is computed, or if it failed."""
        with self._condition:
            is_new, self._requested = not same(key, self._requested), key
            if same(key, self.key):
                self._job = None
                return self.value
            if self.retired:
                return None
            if not self._at_once:
                if is_new:
                    self._job = None if same(key, self._running) else compute
                if self._job is not None and not self._has_thread:
                    THREADS.submit(self._work)
                    self._has_thread = True
                return None
        self._compute(key, compute)
        return self.value

    def newest(
        self, subject: object, compute: Callable[..., Value], *arguments: object
    ) -> Value | None:
        """Request ``compute(*arguments)``; return its value or, until then, an earlier one.

        Only earlier values of the same ``subject``, for example the mesh, are returned; None if
        there is none.
        """
        found = self.request((subject, arguments), partial(compute, *arguments))
        with self._condition:
            is_of_subject = isinstance(self.key, tuple) and same(self.key[0], subject)
            return self.value if found is None and is_of_subject else found

    def retire(self) -> None:
        with self._condition:
            self.retired, self._job = True, None

    def close(self, seconds: float = 0.2) -> None:
        """Start no more jobs, and wait at most ``seconds`` for the running one."""
        self.retire()
        with self._condition:
            self._condition.wait_for(lambda: not self._has_thread, max(seconds, 0.0))

    @factoring_in_subprocess()
    def _work(self) -> None:
        while True:
            with self._condition:
                if self._job is None:
                    self._has_thread = False
                    self._condition.notify_all()
                    return
                key, job, self._job = self._requested, self._job, None
                self._running = key
            self._compute(key, job)

    def _compute(self, key: object, job: Callable[[], Value]) -> None:
        value: Value | None = None
        error = ""
        try:
            self.overall = Overall()
            with reporting_steps(self.overall.update):
                value = job()
        except BaseException as problem:  # without an error text the request would never end
            error = error_line(problem)
            if self._at_once and not isinstance(problem, Exception):
                raise
            if not isinstance(problem, AbfmError | MemoryError | CancelledError):
                with suppress(OSError, ValueError):  # if the terminal is closed
                    traceback.print_exc()
        finally:
            with self._condition:
                self._running = None
                # a finished result that was requested again in the meantime stays
                if not same(self._requested, self.key):
                    self.key, self.value, self.error = key, value, error


class Jobs:
    """All `Latest` of one owner, with the same setting ``at_once``; they are closed together."""

    def __init__(self, at_once: bool = False) -> None:
        self.at_once = at_once
        self._all: list[Latest[Any]] = []

    def latest(self) -> Latest[Any]:
        self._all = [one for one in self._all if not one.retired]
        self._all.append(Latest(self.at_once))
        return self._all[-1]

    @property
    def error(self) -> str:
        return next((one.error for one in self._all if one.error), "")

    @property
    def busy(self) -> bool:
        return any(one.busy for one in self._all)

    def close(self, seconds: float = 0.2) -> None:
        """Start no more jobs, and wait at most ``seconds`` for all running ones together."""
        for one in self._all:
            one.retire()
        end = time.monotonic() + seconds
        for one in self._all:
            one.close(end - time.monotonic())
