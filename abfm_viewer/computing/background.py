"""Work off the frame loop of which only the newest counts."""

from __future__ import annotations

import threading
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Generic, TypeVar

from abfm import AbfmError
from abfm.errors import LONGEST, one_line
from abfm.numerics.factoring_apart import factoring_apart
from abfm.workers.progress import Step, telling
from abfm.workers.threads import DaemonThreads
from abfm_viewer.computing.memo import same

Value = TypeVar("Value")

THREADS = DaemonThreads("background")
"""Compute everything that a window does not wait for."""


def error_line(error: BaseException) -> str:
    """Return an error as a line for the window; one that is not about the input says what kind it
    is.
    """
    text = one_line(str(error), LONGEST)
    if isinstance(error, AbfmError | OSError):
        return text
    if isinstance(error, MemoryError):
        return f"out of memory{': ' if text else ''}{text}"
    return f"{type(error).__name__}: {text}"


class Latest(Generic[Value]):
    """Computes in `THREADS` what was asked for last, one at a time; requests that came before and
    did not start are dropped.

    Keys are compared by `same`: arrays in them by identity; None is no key. If `at_once`, it
    computes in the caller's thread instead, as pictures off the screen need, which wait for no
    frame. The latest `value` was computed for `key`; `error` says in one line why that failed.

    At any time one key is wanted, at most one waits to be computed, one is running, one is
    finished. As long as it is not retired, what is wanted waits, runs or is finished; what waits is
    what is wanted; and nothing takes the place of what is finished while that is wanted.
    """

    def __init__(self, at_once: bool = False) -> None:
        self.key: object = None  # finished, with its value or error
        self.value: Value | None = None
        self.error = ""
        # of the job under way, if it tells any; may be read at any time
        self.step: Step | None = None
        self._at_once = at_once
        self._wanted: object = None
        self._job: Callable[[], Value] | None = None  # computes what is wanted, if that waits
        self._running: object = None
        self._has_thread = self._retired = False
        self._condition = threading.Condition()

    @property
    def busy(self) -> bool:
        """Whether what was asked for last is still to come."""
        with self._condition:
            return self._job is not None or (
                self._running is not None and same(self._running, self._wanted)
            )

    @property
    def is_at_work(self) -> bool:
        """Whether a job is under way, wanted or not."""
        with self._condition:
            return self._running is not None

    @property
    def retired(self) -> bool:
        """Whether it computes nothing any more."""
        return self._retired

    def ask(self, key: object, compute: Callable[[], Value]) -> Value | None:
        """Return what was computed for this key, or None and it will be, once, later."""
        with self._condition:
            is_new, self._wanted = not same(key, self._wanted), key
            if same(key, self.key):
                self._job = None
                return self.value
            if self._retired:
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

    def newest(self, about: object, key: object, compute: Callable[[], Value]) -> Value | None:
        """Return what was computed for this key; until then what was computed last, if that was
        about the same.
        """
        found = self.ask((about, key), compute)
        with self._condition:
            is_fit = isinstance(self.key, tuple) and same(self.key[0], about)
            return self.value if found is None and is_fit else found

    def retire(self) -> None:
        """Compute nothing more; a job under way is not waited for."""
        with self._condition:
            self._retired, self._job = True, None

    def close(self, seconds: float = 0.2) -> None:
        """Compute nothing more; a job under way is waited for, but not for long."""
        self.retire()
        with self._condition:
            self._condition.wait_for(lambda: not self._has_thread, max(seconds, 0.0))

    @factoring_apart()
    def _work(self) -> None:
        while True:
            with self._condition:
                if self._job is None:
                    self._has_thread = False
                    self._condition.notify_all()
                    return
                key, job, self._job = self._wanted, self._job, None
                self._running = key
            self._compute(key, job)

    def _compute(self, key: object, job: Callable[[], Value]) -> None:
        value: Value | None = None
        error = ""
        try:
            with telling(self._tell):
                value = job()
        except BaseException as problem:  # also what is no Exception: else nobody was answered
            error = error_line(problem)
            if self._at_once and not isinstance(problem, Exception):
                raise
            if not isinstance(problem, AbfmError | MemoryError):
                with suppress(OSError, ValueError):  # where the terminal is gone
                    traceback.print_exc()
        finally:
            with self._condition:
                self._running = None
                # else what is there already was asked for again meanwhile
                if not same(self._wanted, self.key):
                    self.key, self.value, self.error = key, value, error

    def _tell(self, step: Step | None) -> None:
        self.step = step


class Jobs:
    """Several `Latest` of one owner, which compute in the same way and end together."""

    def __init__(self, at_once: bool = False) -> None:
        self.at_once = at_once
        self._all: list[Latest[Any]] = []

    def latest(self) -> Latest[Any]:
        """Return another one."""
        self._all = [one for one in self._all if not one.retired]
        self._all.append(Latest(self.at_once))
        return self._all[-1]

    @property
    def error(self) -> str:
        """What could not be computed, in one line; empty if all could."""
        return next((one.error for one in self._all if one.error), "")

    @property
    def step(self) -> Step | None:
        """What one of them does, if one tells."""
        return next((one.step for one in self._all if one.busy and one.step), None)

    @property
    def busy(self) -> bool:
        """Whether something is still to come."""
        return any(one.busy for one in self._all)

    def close(self, seconds: float = 0.2) -> None:
        """Compute nothing more; jobs under way are waited for, but all together not for long."""
        for one in self._all:
            one.retire()
        end = time.monotonic() + seconds
        for one in self._all:
            one.close(end - time.monotonic())
