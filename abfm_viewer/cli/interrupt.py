"""Signals that a command keeps for later: a match that goes on to its end with what it has."""

import os
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from types import FrameType

from abfm import Control
from abfm_viewer import signals

_TOGETHER = 0.1  # seconds: `timeout` and terminals may send a signal to a process and to its group


@dataclass
class Kept:
    """The signal that came, if any."""

    number: int | None = None


@contextmanager
def cancelled_by_signals(
    control: Control, what: str = "with the best result so far"
) -> Iterator[Kept]:
    """Turn the first signal inside the block into a cancellation, and say on stderr with what it
    stops.

    The second one leaves at once, unless it comes with the first.
    """
    kept, came = Kept(), 0.0

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal came
        if kept.number is None:
            kept.number, came = number, time.monotonic()
            control.cancel()
            with suppress(OSError):  # not print, which may just have been interrupted
                os.write(2, f"stopping {what}; Ctrl-C again to leave at once\n".encode())
        elif time.monotonic() - came > _TOGETHER:
            handled.close()
            os.kill(os.getpid(), number)

    with ExitStack() as handled:
        handled.enter_context(signals.taken_over(stop))
        yield kept
