"""Signals: what Ctrl-C and termination do to a match and to a movie."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from abfm import Control

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def cancelled_by_signals(control: Control) -> Iterator[None]:
    """Turn the first SIGINT or SIGTERM inside the block into a cancellation, so that the best result is kept.

    The second one leaves at once.
    """
    before = {number: signal.getsignal(number) for number in _SIGNALS}

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    def stop(number: int, frame: FrameType | None) -> None:
        restore()
        control.cancel()
        print("stopping with the best result so far; Ctrl-C again to leave at once", file=sys.stderr, flush=True)

    for number in _SIGNALS:
        signal.signal(number, stop)
    try:
        yield
    finally:
        restore()


@contextmanager
def interrupted_by_sigterm() -> Iterator[None]:
    """Let SIGTERM do inside the block what Ctrl-C does, so that nothing half-written stays."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
