"""Ctrl-C during a match: the first asks it to stop, so that its best result is kept; the second leaves at once."""

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
    """Turn the first SIGINT or SIGTERM inside the block into a cancellation."""
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
