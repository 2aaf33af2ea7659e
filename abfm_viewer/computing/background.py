"""Work off the frame loop of which only the newest counts."""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable, Hashable
from typing import ClassVar, Generic, TypeVar

from abfm import AbfmError
from abfm.numerics.own_process import factoring_apart

Value = TypeVar("Value")


def one_line(error: BaseException) -> str:
    """An error as a line for the window; one that is not about the input says what kind it is."""
    text = " ".join(str(error).split())
    if isinstance(error, AbfmError | OSError):
        return text
    if isinstance(error, MemoryError):
        return f"out of memory{': ' if text else ''}{text}"
    return f"{type(error).__name__}: {text}"


class Latest(Generic[Value]):
    """Computes in a thread of its own what was asked for last; requests that came before and did not start are dropped.

    Attributes
    ----------
    key, value
        What was computed last, and what for; None before.
    error : str
        Why the last request failed, in one line; empty if it did not.
    at_once : bool
        Of the class: compute in the caller's thread instead, as pictures off the screen need, which wait for no frame.
    """

    at_once: ClassVar[bool] = False

    def __init__(self, name: str) -> None:
        self.key: Hashable = None
        self.value: Value | None = None
        self.error = ""
        self._name = name
        self._wanted: Hashable = None
        self._job: Callable[[], Value] | None = None
        self._condition = threading.Condition()
        self._thread: threading.Thread | None = None
        self._closed = False

    @property
    def busy(self) -> bool:
        """Whether what was asked for last is still to come."""
        return self._wanted is not None and self._wanted != self.key

    def ask(self, key: Hashable, compute: Callable[[], Value]) -> Value | None:
        """What was computed for this key, or None and it will be, once, in the background."""
        if Latest.at_once and key != self.key:
            self._wanted = key
            self._compute(key, compute)
        with self._condition:
            if key == self.key:
                self._wanted, self._job = key, None
                return self.value
            if key != self._wanted:
                self._wanted, self._job = key, compute
                if self._thread is None:
                    self._thread = threading.Thread(target=self._work, name=self._name, daemon=True)
                    self._thread.start()
                self._condition.notify()
        return None

    def close(self, seconds: float = 0.5) -> None:
        """End the thread; a job under way is waited for, but not for long."""
        with self._condition:
            self._closed, self._job = True, None
            self._condition.notify()
        if self._thread is not None:
            self._thread.join(seconds)

    @factoring_apart()
    def _work(self) -> None:
        while True:
            with self._condition:
                while self._job is None and not self._closed:
                    self._condition.wait()
                if self._job is None:
                    return
                key, job, self._job = self._wanted, self._job, None
            self._compute(key, job)
            del job

    def _compute(self, key: Hashable, job: Callable[[], Value]) -> None:
        value: Value | None = None
        error = ""
        try:
            value = job()
        except Exception as problem:
            if not isinstance(problem, AbfmError | MemoryError):
                traceback.print_exc()
            error = one_line(problem)
        with self._condition:
            self.key, self.value, self.error = key, value, error
