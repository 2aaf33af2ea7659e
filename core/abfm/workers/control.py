"""Pause, resume and cancel work from another thread.

The caller runs the work inside ``with controlled(control)``. The work calls `checkpoint` regularly.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar


class CancelledError(Exception):
    """Error that ends cancelled work; `match` catches it and returns its best iterate."""


class Control:
    """Pause, resume or cancel a `match` from another thread.

    A change takes effect within one evaluation of the energy. ``cancelled`` is true after `cancel`,
    and ``skip_checks`` is the argument of that call.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._running = threading.Event()
        self._running.set()
        self._observers: tuple[Callable[[Control], None], ...] = ()
        self.cancelled = self.skip_checks = False

    @property
    def paused(self) -> bool:
        return not self._running.is_set()

    def pause(self) -> None:
        """Pause the work before its next evaluation of the energy."""
        self.set_paused(True)

    def resume(self) -> None:
        self.set_paused(False)

    def set_paused(self, paused: bool) -> None:
        with self._lock:
            if not paused:
                self._running.set()
            elif not self.cancelled:  # cancelled work must run to its end
                self._running.clear()
        self._notify_observers()

    def cancel(self, skip_checks: bool = False) -> None:
        """Stop the work; `match` returns its best iterate with the stop reason "cancelled".

        With ``skip_checks`` the result is not verified, which saves time if the caller continues
        from it.
        """
        with self._lock:
            self.cancelled, self.skip_checks = True, skip_checks
            if not self._running.is_set():
                self._running.set()
        self._notify_observers()

    @contextmanager
    def observed_by(self, observer: Callable[[Control], None]) -> Iterator[None]:
        """Call an observer after each change, and at once if the work is paused or cancelled."""
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
        """Wait while the work is paused; raise `CancelledError` if it is cancelled."""
        # `Event.wait` holds a lock that a cancelling signal handler would need in `Event.set`
        if not self._running.is_set():
            self._running.wait()
        if self.cancelled:
            raise CancelledError


_current: ContextVar[tuple[Control, Callable[[], bool]] | None] = ContextVar(
    "control of this thread, and whether it is active", default=None
)


@contextmanager
def controlled(control: Control, is_active: Callable[[], bool] = lambda: True) -> Iterator[None]:
    """Let a control pause or cancel the work of this thread, whenever it calls `checkpoint`.

    This is a context manager. The control has no effect while ``is_active()`` is false.
    """
    before = _current.set((control, is_active))
    try:
        yield
    finally:
        _current.reset(before)


def current_control() -> Control | None:
    """Return the control that `checkpoint` obeys in this thread; None if there is none."""
    current = _current.get()
    return current[0] if current else None


def checkpoint() -> None:
    """Wait while the work of this thread is paused; raise `CancelledError` if it is cancelled."""
    if current := _current.get():
        control, is_active = current
        if is_active():
            control.wait()
