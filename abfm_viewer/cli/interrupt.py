"""Signals: what Ctrl-C and termination do to a match and to a movie."""

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from types import FrameType

from abfm import Control


@contextmanager
def cancelled_by_signals(control: Control) -> Iterator[None]:
    """Turn the first SIGINT or SIGTERM inside the block into a cancellation, so that the best result is kept.

    The second one leaves at once.
    """

    def stop(number: int, frame: FrameType | None) -> None:
        handled.close()
        control.cancel()
        print("stopping with the best result so far; Ctrl-C again to leave at once", file=sys.stderr, flush=True)

    with ExitStack() as handled:
        for number in (signal.SIGINT, signal.SIGTERM):
            _handle(handled, number, stop)
        yield


@contextmanager
def interrupted_by_sigterm() -> Iterator[None]:
    """Let SIGTERM do inside the block what Ctrl-C does, so that nothing half-written stays."""
    with ExitStack() as handled:
        _handle(handled, signal.SIGTERM, signal.default_int_handler)
        yield


def _handle(handled: ExitStack, number: signal.Signals, handler: Callable[[int, FrameType | None], None]) -> None:
    """Handle a signal until the stack is closed."""
    handled.callback(signal.signal, number, signal.getsignal(number))
    signal.signal(number, handler)
