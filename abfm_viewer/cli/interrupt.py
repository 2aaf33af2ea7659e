"""Signals: what Ctrl-C and termination do to a match and to a movie."""

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from abfm import Control


@contextmanager
def cancelled_by_signals(control: Control) -> Iterator[None]:
    """Turn the first SIGINT or SIGTERM inside the block into a cancellation, so that the best result is kept.

    The second one leaves at once.
    """

    def stop(number: int, frame: FrameType | None) -> None:
        restore()
        control.cancel()
        print("stopping with the best result so far; Ctrl-C again to leave at once", file=sys.stderr, flush=True)

    restore = _restoring(signal.SIGINT, signal.SIGTERM)
    signal.signal(signal.SIGINT, stop)
    signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        restore()


@contextmanager
def interrupted_by_sigterm() -> Iterator[None]:
    """Let SIGTERM do inside the block what Ctrl-C does, so that nothing half-written stays."""
    restore = _restoring(signal.SIGTERM)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        restore()


def _restoring(*signals: signal.Signals) -> Callable[[], None]:
    """What to call to handle signals as now again."""
    before = {number: signal.getsignal(number) for number in signals}

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    return restore
