"""Pause, resume and cancel work from another thread: whoever starts it says ``with
controlled(control)``; work that takes long calls `checkpoint` on its way.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar


class CancelledError(Exception):
    """Raised inside work that was cancelled; `match` catches it."""


class Control:
    """Pause, resume or cancel a `match` from another thread; takes effect within one evaluation of
    the energy.

    ``cancelled`` and ``brief`` say whether it was cancelled, and briefly.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._running = threading.Event()
        self._running.set()
        self._observers: tuple[Callable[[Control], None], ...] = ()
        self.cancelled = self.skip_checks = False

    @property
    def paused(self) -> bool:
        """Whether it holds the solve."""
        return not self._running.is_set()

    def pause(self) -> None:
        """Hold the solve before its next evaluation."""
        self.set_paused(True)

    def resume(self) -> None:
        """Go on after `pause`."""
        self.set_paused(False)

    def set_paused(self, paused: bool) -> None:
        """Pause or resume."""
        with self._lock:
            if not paused:
                self._running.set()
            elif not self.cancelled:  # a cancelled solve must still end
                self._running.clear()
        self._notify_observers()

    def cancel(self, skip_checks: bool = False) -> None:
        """Stop the solve; `match` returns its best iterate with the stop reason "cancelled".

        Where that is only to go on from, ``skip_checks`` saves time: the result is
        not verified.
        """
        with self._lock:
            self.cancelled, self.skip_checks = True, skip_checks
            if not self._running.is_set():
                self._running.set()
        self._notify_observers()

    @contextmanager
    def observed_by(self, observer: Callable[[Control], None]) -> Iterator[None]:
        """Tell a watcher of all that is asked of this control, also before."""
        self._observers = (*self._observers, observer)
        try:
            if self.paused or self.cancelled:
                observer(self)
            yield
        finally:
            self._observers = tuple(each for each in self._observers if each is not observer)

    def _notify_observers(self) -> None:
        for observer in self._observers:
            observer(self)

    def wait(self) -> None:
        """Return when the solve may go on; raise `CancelledError` if it must not."""
        # a signal may cancel while this holds what `set` would wait for
        if not self._running.is_set():
            self._running.wait()
        if self.cancelled:
            raise CancelledError


_current: ContextVar[tuple[Control, Callable[[], bool]] | None] = ContextVar(
    "what this thread listens to, and whether it heeds it", default=None
)


@contextmanager
def controlled(control: Control, is_active: Callable[[], bool] = lambda: True) -> Iterator[None]:
    """Let the checkpoints of this thread wait for a control, whenever the work ``is_active`` it."""
    before = _current.set((control, is_active))
    try:
        yield
    finally:
        _current.reset(before)


def current_control() -> Control | None:
    """Return what this thread's checkpoints wait for."""
    current = _current.get()
    return current[0] if current else None


def checkpoint() -> None:
    """Return when this thread's work may go on; raise `CancelledError` if it must not."""
    if current := _current.get():
        control, is_active = current
        if is_active():
            control.wait()
