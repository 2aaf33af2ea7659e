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
        self._watchers: tuple[Callable[[Control], None], ...] = ()
        self.cancelled = self.brief = False

    @property
    def paused(self) -> bool:
        """Whether it holds the solve."""
        return not self._running.is_set()

    def pause(self) -> None:
        """Hold the solve before its next evaluation."""
        self.hold(True)

    def resume(self) -> None:
        """Go on after `pause`."""
        self.hold(False)

    def hold(self, paused: bool) -> None:
        """Pause or resume."""
        with self._lock:
            if not paused:
                self._running.set()
            elif not self.cancelled:  # a cancelled solve must still end
                self._running.clear()
        self._tell_watchers()

    def cancel(self, briefly: bool = False) -> None:
        """Stop the solve; `match` returns its best iterate with the stop reason "cancelled".

        Where that is only to go on from, ``briefly`` leaves out what takes its time: the result is
        not verified.
        """
        with self._lock:
            self.cancelled, self.brief = True, briefly
            if not self._running.is_set():
                self._running.set()
        self._tell_watchers()

    @contextmanager
    def watched(self, watcher: Callable[[Control], None]) -> Iterator[None]:
        """Tell a watcher of all that is asked of this control, also before."""
        self._watchers = (*self._watchers, watcher)
        try:
            if self.paused or self.cancelled:
                watcher(self)
            yield
        finally:
            self._watchers = tuple(each for each in self._watchers if each is not watcher)

    def _tell_watchers(self) -> None:
        for watcher in self._watchers:
            watcher(self)

    def wait(self) -> None:
        """Return when the solve may go on; raise `CancelledError` if it must not."""
        # a signal may cancel while this holds what `set` would wait for
        if not self._running.is_set():
            self._running.wait()
        if self.cancelled:
            raise CancelledError


_listening: ContextVar[tuple[Control, Callable[[], bool]] | None] = ContextVar(
    "what this thread listens to, and whether it heeds it", default=None
)


@contextmanager
def controlled(control: Control, heeds: Callable[[], bool] = lambda: True) -> Iterator[None]:
    """Let the checkpoints of this thread wait for a control, whenever the work ``heeds`` it."""
    before = _listening.set((control, heeds))
    try:
        yield
    finally:
        _listening.reset(before)


def present_control() -> Control | None:
    """Return what this thread's checkpoints wait for."""
    listening = _listening.get()
    return listening[0] if listening else None


def checkpoint() -> None:
    """Return when this thread's work may go on; raise `CancelledError` if it must not."""
    if listening := _listening.get():
        control, heeds = listening
        if heeds():
            control.wait()
