"""Cancellation by signals: the first one cancels the work, the second one ends the program."""

import os
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from types import FrameType

from abfm.workers import Control
from abfm_viewer import signals

_DOUBLE_SIGNAL_SECONDS = 0.1  # `timeout` and terminals may send a signal twice


@dataclass
class Interrupt:
    """Number of the received signal, or None."""

    number: int | None = None

    @property
    def status(self) -> int | None:
        return None if self.number is None else signals.status(self.number)


@contextmanager
def cancelled_by_signals(
    control: Control, what: str = "with the best result so far"
) -> Iterator[Interrupt]:
    """Cancel work at the first signal, and end the program at a later second one.

    ``what`` describes the result so far in the printed message.
    """
    interrupt, signal_time = Interrupt(), 0.0

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal signal_time
        if interrupt.number is None:
            interrupt.number, signal_time = number, time.monotonic()
            control.cancel()
            with suppress(OSError):  # print may have been interrupted
                os.write(2, f"stopping {what}; press Ctrl-C again to exit immediately\n".encode())
        elif time.monotonic() - signal_time > _DOUBLE_SIGNAL_SECONDS:
            handled.close()
            os.kill(os.getpid(), number)

    with ExitStack() as handled:
        handled.enter_context(signals.signal_handler(stop))
        yield interrupt
