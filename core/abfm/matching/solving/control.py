"""Pause, resume and cancel a solve from another thread."""

import threading


class CancelledError(Exception):
    """Raised inside a solve that was cancelled; `match` catches it."""


class Control:
    """Pause, resume or cancel a `match` from another thread; takes effect within one evaluation of the energy.

    ``cancelled`` and ``brief`` say whether it was cancelled, and briefly.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._running = threading.Event()
        self._running.set()
        self.cancelled = self.brief = False

    def pause(self) -> None:
        """Hold the solve before its next evaluation."""
        with self._lock:
            if not self.cancelled:  # a cancelled solve must still end
                self._running.clear()

    def resume(self) -> None:
        """Go on after `pause`."""
        self._running.set()

    def cancel(self, briefly: bool = False) -> None:
        """Stop the solve; `match` returns its best iterate with the stop reason "cancelled".

        Where that is only to go on from, ``briefly`` leaves out what takes its time: the result is not verified.
        """
        with self._lock:
            self.cancelled, self.brief = True, briefly
            if not self._running.is_set():
                self._running.set()

    def wait(self) -> None:
        """Return when the solve may go on; raise `CancelledError` if it must not."""
        if not self._running.is_set():  # a signal may cancel while this holds what `set` would wait for
            self._running.wait()
        if self.cancelled:
            raise CancelledError
