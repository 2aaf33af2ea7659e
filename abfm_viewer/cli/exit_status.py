"""Exit statuses of a program, its messages on stderr, and cancellation by signals."""

import atexit
import errno
import io
import os
import signal
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from types import FrameType
from typing import Any, TextIO, cast

from abfm import AbfmError
from abfm.errors import MESSAGE_LENGTH_MAX, AbfmWarning, one_line, printable
from abfm.io import remove_temporary
from abfm.workers import Control, process
from abfm_viewer import signals

BAD_INPUT_STATUS, UNMATCHED_STATUS, FAILED_STATUS = 2, 3, 4
"""Bad input, nothing was done; a target was not reached; some of several problems failed."""
_DOUBLE_SIGNAL_SECONDS = 0.1  # `timeout` and terminals may send a signal twice


class UsageError(Exception):
    """Invalid command line; the text has one line."""


def exit_status(program: str, run: Callable[[], int]) -> int:
    """Run a program and return its exit status: 2 after bad input, 130 after Ctrl-C."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("always", AbfmWarning)
            warnings.showwarning = lambda message, *_, **__: print_note(
                one_line(message, MESSAGE_LENGTH_MAX), "warning"
            )
            return run()
    except KeyboardInterrupt as error:
        print(f"{program}: interrupted", file=sys.stderr)
        return signals.status(getattr(error, "number", signal.SIGINT))
    except (AbfmError, UsageError, OSError, MemoryError) as error:
        print(
            f"{program}: {one_line(str(error) or 'out of memory', MESSAGE_LENGTH_MAX)}",
            file=sys.stderr,
        )
        return BAD_INPUT_STATUS
    except ImportError as error:  # also if there is too little memory for the code of a library
        reason = f"{one_line(error)}; free some memory, or install abfm again"
        print(f"{program}: a library cannot be loaded: {reason}", file=sys.stderr)
        return BAD_INPUT_STATUS


def print_note(text: str, kind: str = "note") -> None:
    """Print a note, or a warning, to stderr in one line."""
    print_line(printable(text if text.startswith("warning: ") else f"{kind}: {text}"))


def print_line(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def program_status(program: str, run: Callable[[], int]) -> int:
    """Run a program that is the whole process, and return its exit status.

    Printing never ends the program: it continues if the reader of its output is gone, and escapes
    characters that the encoding lacks. At exit the process ends directly after cleanup. A shutdown
    of the interpreter takes seconds on large meshes, and a signal during it is not safe.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:  # the parent process has closed it
            # takes the stream's number, which a result file would otherwise get
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
    out, errors = _SafeStream(sys.stdout, 1), _SafeStream(sys.stderr, 2)
    sys.stdout, sys.stderr = cast(TextIO, out), cast(TextIO, errors)
    statuses: list[int] = []
    atexit.register(_end_process, statuses)  # later registrations run before it
    with signals.cleanup_on_signal(remove_temporary), signals.cleanup_on_signal(process.kill_all):
        try:
            status = exit_status(program, run)
        except SystemExit as error:  # argparse has printed its help
            status = error.code if isinstance(error.code, int) else 0
        out.flush()
        if out.problem and not _is_reader_gone(out.problem):
            print(f"{program}: cannot write the output: {out.problem.strerror}", file=sys.stderr)
            status = status or BAD_INPUT_STATUS
    statuses.append(status)
    return status


def _is_reader_gone(error: OSError) -> bool:
    """Return whether an error means that the program reading the output has ended.

    Windows reports an invalid argument in this case.
    """
    is_invalid = sys.platform == "win32" and error.errno == errno.EINVAL
    return is_invalid or isinstance(error, BrokenPipeError)


def _end_process(statuses: list[int]) -> None:
    if statuses:
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError, AttributeError):
                stream.flush()
        os._exit(statuses[0])


class _SafeStream:
    """Stream that drops all text after a write failed; `problem` is the error of that write."""

    def __init__(self, stream: TextIO | None, number: int) -> None:
        self._stream = stream or os.fdopen(number, "w", encoding="utf-8")
        self.problem: OSError | None = None
        if isinstance(self._stream, io.TextIOWrapper):
            self._stream.reconfigure(errors="backslashreplace")

    def write(self, text: str) -> int:
        self._try(lambda: self._stream.write(text))
        return len(text)

    def flush(self) -> None:
        self._try(self._stream.flush)

    def _try(self, action: Callable[[], object]) -> None:
        if self.problem is None:
            try:
                action()
            except OSError as error:
                self.problem = error

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@dataclass
class Interrupt:
    """The signal that cancelled the work: its number, or None if no signal was received."""

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
            signal.raise_signal(number)  # os.kill would skip the handler on Windows

    with ExitStack() as handled:
        handled.enter_context(signals.signal_handler(stop))
        yield interrupt
