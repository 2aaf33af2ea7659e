"""Ctrl-C and SIGTERM: cancel at the first signal, end at the second."""

import os
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from types import FrameType

from abfm.workers import Control
from abfm_viewer import signals

# seconds: `timeout` and terminals may send a signal to a process and to its group
_DOUBLE_SIGNAL_SECONDS = 0.1


@dataclass
class Interrupt:
    """The number of the signal that came; None if none did."""

    number: int | None = None

    @property
    def status(self) -> int | None:
        """The exit status after the signal."""
        return None if self.number is None else signals.status(self.number)


@contextmanager
def cancelled_by_signals(
    control: Control, what: str = "with the best result so far"
) -> Iterator[Interrupt]:
    """Cancel at the first signal, and print with what; end at a second one, if it comes later."""
    interrupt, came = Interrupt(), 0.0

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal came
        if interrupt.number is None:
            interrupt.number, came = number, time.monotonic()
            control.cancel()
            with suppress(OSError):  # not print, which may just have been interrupted
                os.write(2, f"stopping {what}; Ctrl-C again to leave at once\n".encode())
        elif time.monotonic() - came > _DOUBLE_SIGNAL_SECONDS:
            handled.close()
            os.kill(os.getpid(), number)

    with ExitStack() as handled:
        handled.enter_context(signals.taken_over(stop))
        yield interrupt
