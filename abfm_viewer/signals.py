"""How a program ends when it is told to: by Ctrl-C, by SIGTERM, or by SIGHUP when its terminal is
closed.

A signal is answered in its handler, which tidies up, says one line and leaves with the status that
shells know, 128 and its number. Nothing is raised: an exception in the middle of anything is not
safe with compiled libraries. An import that it breaks off leaves half a module, callbacks swallow
it, and taking the interpreter apart may crash. So what must not stay behind is told to `tidied`
before it is there, and what has something worth keeping takes the signals over for a while.

This module imports nothing but Python's own, so that a program can begin with it.
"""

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType

NUMBERS = [
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
]
"""Signals that end programs, of those that the system has."""
_PATIENCE = 1.0  # seconds after which another signal ends the process without tidying up
_tidying: list[Callable[[], object]] = []


class EndedBySignal(KeyboardInterrupt):
    """Raised where a signal was kept until a good moment; `number` says which one it was."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number


def status(number: int) -> int:
    return 128 + number


def leave_on_signals(program: str) -> None:
    """Begin to answer signals for a program of this name, but for those that it is to ignore."""
    began: list[float] = []

    def leave(number: int, frame: FrameType | None) -> None:
        # another signal while this tidies up, which takes no time unless a disk does not answer
        if began:
            if time.monotonic() - began[0] > _PATIENCE:
                os._exit(status(number))
            return
        began.append(time.monotonic())
        for tidy in reversed(_tidying):
            with suppress(Exception):
                tidy()
        with suppress(Exception):  # nobody reads, or print was interrupted
            sys.stdout.flush()
        with suppress(OSError):
            os.write(2, f"{program}: interrupted\n".encode())
        os._exit(status(number))

    for number in NUMBERS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, leave)


@contextmanager
def tidied(tidy: Callable[[], object]) -> Iterator[None]:
    """Call this if a signal ends the program inside the block."""
    _tidying.append(tidy)
    try:
        yield
    finally:
        _tidying.remove(tidy)


@contextmanager
def taken_over(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Have another handler for all signals that are not ignored, until the block ends."""
    before = {number: signal.getsignal(number) for number in NUMBERS}
    taken = [number for number in NUMBERS if before[number] is not signal.SIG_IGN]
    try:
        for number in taken:
            signal.signal(number, handler)
        yield
    finally:
        for number in taken:
            signal.signal(number, before[number])
