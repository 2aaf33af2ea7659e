"""Signals: what Ctrl-C and termination do to a match and to a movie."""

from __future__ import annotations

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

    restore = _handle((signal.SIGINT, signal.SIGTERM), stop)
    try:
        yield
    finally:
        restore()


@contextmanager
def interrupted_by_sigterm() -> Iterator[None]:
    """Let SIGTERM do inside the block what Ctrl-C does, so that nothing half-written stays."""
    restore = _handle((signal.SIGTERM,), signal.default_int_handler)
    try:
        yield
    finally:
        restore()


def _handle(
    signals: tuple[signal.Signals, ...], handler: Callable[[int, FrameType | None], None]
) -> Callable[[], None]:
    """Handle signals so until the answer is called."""
    before = {number: signal.signal(number, handler) for number in signals}

    def restore() -> None:
        for number, former in before.items():
            signal.signal(number, former)

    return restore
