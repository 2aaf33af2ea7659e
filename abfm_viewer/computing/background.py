"""Work off the frame loop of which only the newest counts, and values kept until they change."""

from __future__ import annotations

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
from abfm.numerics.factoring_apart import factoring_apart
from abfm.workers.control import CancelledError
from abfm.workers.progress import Step, telling
from abfm.workers.threads import DaemonThreads

Value = TypeVar("Value")

THREADS = DaemonThreads("background")
"""Compute everything that a window does not wait for."""


def error_line(error: BaseException) -> str:
    """Tell an error in a line; one that is not about the input says what kind it is."""
    text = one_line(str(error), MESSAGE_LENGTH_MAX)
    if isinstance(error, AbfmError | OSError):
        return text
    if isinstance(error, MemoryError):
        return f"out of memory{': ' if text else ''}{text}"
    return f"{type(error).__name__}: {text}"


def same(one: object, other: object) -> bool:
    """Tell whether things, or tuples of them, are equal: arrays only if they are one object."""
    if one is other:
        return True
    if isinstance(one, tuple) and isinstance(other, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    are_arrays = isinstance(one, np.ndarray) or isinstance(other, np.ndarray)
    return not are_arrays and bool(one == other)


class Memo(Generic[Value]):
    """Keeps the latest value: the same object while what it is made of stays the `same`."""

    def __init__(self) -> None:
        self._kept: tuple[tuple[object, ...], Value] | None = None

    def get(self, made_of: tuple[object, ...], make: Callable[[], Value]) -> Value:
        if self._kept is None or not same(self._kept[0], made_of):
            self._kept = made_of, make()
        return self._kept[1]


class Latest(Generic[Value]):
    """Computes in `THREADS` what was asked for last, one at a time, and drops what did not begin.

    Keys are compared by `same`; None is no key. The latest `value` was computed for `key`; `error`
    says in one line why that failed. If `at_once`, it computes in the caller's thread instead.

    At any time one key is wanted, at most one waits to be computed, one is running, one is
    finished. As long as it is not retired, what is wanted waits, runs or is finished; what waits is
    what is wanted; and nothing takes the place of what is finished while that is wanted.
    """

    def __init__(self, at_once: bool = False) -> None:
        self.key: object = None  # finished, with its value or error
        self.value: Value | None = None
        self.error = ""
        self.step: Step | None = None  # of the job under way, if it tells any
        self.retired = False
        self._at_once = at_once
        self._wanted: object = None
        self._job: Callable[[], Value] | None = None  # computes what is wanted, if that waits
        self._running: object = None
        self._has_thread = False
        self._condition = threading.Condition()

    @property
    def busy(self) -> bool:
        with self._condition:
            runs = self._running is not None and same(self._running, self._wanted)
            return runs or self._job is not None

    @property
    def is_at_work(self) -> bool:
        with self._condition:
            return self._running is not None

    def ask(self, key: object, compute: Callable[[], Value]) -> Value | None:
        """Return what was computed for this key, or None and it will be, once, later."""
        with self._condition:
            is_new, self._wanted = not same(key, self._wanted), key
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

    def newest(self, about: object, compute: Callable[..., Value], *given: object) -> Value | None:
        """Return what is computed of what is given, or until then the last about the same."""
        found = self.ask((about, given), partial(compute, *given))
        with self._condition:
            is_fit = isinstance(self.key, tuple) and same(self.key[0], about)
            return self.value if found is None and is_fit else found

    def retire(self) -> None:
        with self._condition:
            self.retired, self._job = True, None

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
            if not isinstance(problem, AbfmError | MemoryError | CancelledError):
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
        """Compute nothing more; all jobs together are not waited for long."""
        for one in self._all:
            one.retire()
        end = time.monotonic() + seconds
        for one in self._all:
            one.close(end - time.monotonic())
