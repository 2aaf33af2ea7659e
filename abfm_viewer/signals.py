"""Exit on Ctrl-C, SIGTERM, and SIGHUP of a closed terminal.

The handler of a signal cleans up, prints one line and exits with the status that shells use, 128
plus the number of the signal. It does not raise an exception, which is not safe with compiled
libraries. An interrupted import leaves half a module, callbacks swallow the exception, and the
shutdown of the interpreter may crash.

Temporary files are therefore registered by `cleanup_on_signal` before they exist. Code with a
result worth saving replaces the handler by `signal_handler`.

This module imports only the standard library, so that a program can import it first.
"""

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType

NUMBERS = [
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")
    if hasattr(signal, name)
]
"""Signals of this system that end programs; SIGBREAK is that of a closed window on Windows."""
_SECOND_SIGNAL_SECONDS = 1.0  # a later second signal ends the process without cleanup
_cleanups: list[Callable[[], object]] = []


class EndedBySignal(KeyboardInterrupt):
    """An exit that was postponed to a safe moment; `number` is that of the signal."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number


def status(number: int) -> int:
    return 128 + number


def exit_on_signals(program: str) -> None:
    """Exit on signals with a message that names the program; ignored signals stay ignored."""
    began: list[float] = []

    def leave(number: int, frame: FrameType | None) -> None:
        # cleanup is fast unless a disk does not respond; then a second signal ends the process
        if began:
            if time.monotonic() - began[0] > _SECOND_SIGNAL_SECONDS:
                os._exit(status(number))
            return
        began.append(time.monotonic())
        for clean_up in reversed(_cleanups):
            with suppress(Exception):
                clean_up()
        with suppress(Exception):  # the reader is gone, or print was interrupted
            sys.stdout.flush()
        with suppress(OSError):
            os.write(2, f"{program}: interrupted\n".encode())
        os._exit(status(number))

    for number in NUMBERS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, leave)


@contextmanager
def cleanup_on_signal(clean_up: Callable[[], object]) -> Iterator[None]:
    """Call a function if a signal ends the program inside the context."""
    _cleanups.append(clean_up)
    try:
        yield
    finally:
        _cleanups.remove(clean_up)


@contextmanager
def signal_handler(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Use another handler for all signals that are not ignored, while the context lasts."""
    before = {number: signal.getsignal(number) for number in NUMBERS}
    handled = [number for number in NUMBERS if before[number] is not signal.SIG_IGN]
    try:
        for number in handled:
            signal.signal(number, handler)
        yield
    finally:
        for number in handled:
            signal.signal(number, before[number])
