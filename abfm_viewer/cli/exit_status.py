"""How a program ends and prints: where an error becomes a line on stderr and an exit status."""

import atexit
import io
import os
import signal
import sys
import warnings
from collections.abc import Callable
from contextlib import suppress
from typing import Any, TextIO, cast

from abfm import AbfmError
from abfm.errors import MESSAGE_LENGTH_MAX, AbfmWarning, one_line, printable
from abfm.io import remove_temporary
from abfm.workers import process
from abfm_viewer import signals

BAD_INPUT_STATUS, UNMATCHED_STATUS, FAILED_STATUS = 2, 3, 4
"""Nothing was done; a target was not reached; of many problems some failed."""


class UsageError(Exception):
    """A command line that cannot be understood; the text is one line."""


def exit_status(program: str, run: Callable[[], int]) -> int:
    """Run a program and return its exit status: 2 after bad input, 130 after Ctrl-C."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("always", AbfmWarning)
            warnings.showwarning = _print_warning
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
    except ImportError as error:  # also where memory is too small for a library's code
        why = f"{one_line(error)}; free some memory, or install abfm again"
        print(f"{program}: a library cannot be loaded: {why}", file=sys.stderr)
        return BAD_INPUT_STATUS


def print_note(text: str, kind: str = "note") -> None:
    """Print a note, or a warning, to stderr in one line."""
    print_line(printable(f"{kind}: {text}"))


def print_line(text: str) -> None:
    """Print a line to stderr."""
    print(text, file=sys.stderr, flush=True)


def _print_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    print_note(one_line(message, MESSAGE_LENGTH_MAX), "warning")


def program_status(program: str, run: Callable[[], int]) -> int:
    """Run a program to which the whole process belongs, and return its exit status.

    What it prints never ends it: it goes on when nobody reads any more, and letters that the
    encoding lacks are escaped. The process ends as soon as everything is tidied up: taking the
    interpreter apart takes seconds on large meshes, and a signal in the middle of that is not safe.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:  # whoever started the program has closed it
            # takes the lowest number that is free: else a result might get it
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
    out, errors = _LastingStream(sys.stdout, 1), _LastingStream(sys.stderr, 2)
    sys.stdout, sys.stderr = cast(TextIO, out), cast(TextIO, errors)
    ended: list[int] = []
    atexit.register(_end_at_once, ended)  # what is registered later comes before
    with signals.tidied(remove_temporary), signals.tidied(process.kill_all):
        try:
            status = exit_status(program, run)
        except SystemExit as error:  # argparse has printed its help
            status = error.code if isinstance(error.code, int) else 0
        out.flush()
        if out.problem and not isinstance(out.problem, BrokenPipeError):
            print(f"{program}: cannot write the output: {out.problem.strerror}", file=sys.stderr)
            status = status or BAD_INPUT_STATUS
    ended.append(status)
    return status


def _end_at_once(ended: list[int]) -> None:
    if ended:
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError, AttributeError):
                stream.flush()
        os._exit(ended[0])


class _LastingStream:
    """Prints to a stream, or /dev/null, until it fails by a `problem`; the rest is dropped."""

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

    def _try(self, act: Callable[[], object]) -> None:
        if self.problem is None:
            try:
                act()
            except OSError as error:
                self.problem = error

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)
