"""How a program ends: the one place where an error becomes a line on stderr and an exit status."""

import atexit
import os
import signal
import sys
from collections.abc import Callable
from contextlib import suppress

from abfm import AbfmError
from abfm.errors import LONGEST, one_line
from abfm.io import remove_temporary
from abfm.workers import process
from abfm_viewer import signals
from abfm_viewer.cli.streams import lasting_streams

BAD_INPUT, UNMATCHED = 2, 3


class UsageError(Exception):
    """A command line that cannot be understood; the text is one line."""


def exit_status(program: str, run: Callable[[], int]) -> int:
    """Run a program and return its exit status; bad input gives 2 and one line, Ctrl-C gives
    130.
    """
    try:
        return run()
    except KeyboardInterrupt as error:
        print(f"{program}: interrupted", file=sys.stderr)
        return signals.status(getattr(error, "number", signal.SIGINT))
    except (AbfmError, UsageError, OSError, MemoryError) as error:
        print(f"{program}: {one_line(str(error) or 'out of memory', LONGEST)}", file=sys.stderr)
        return BAD_INPUT


def program_status(program: str, run: Callable[[], int]) -> int:
    """Run a program to which the whole process belongs, and return its exit status.

    What it prints never ends it: it goes on when nobody reads any more, and letters that the
    encoding lacks are escaped. The process ends as soon as everything is tidied up: taking the
    interpreter apart takes seconds on large meshes, and a signal in the middle of that is not safe.
    """
    out, errors = lasting_streams()
    ended: list[int] = []
    atexit.register(_end_at_once, ended)  # what is registered later comes before
    with signals.tidied(remove_temporary), signals.tidied(process.end_all):
        try:
            status = exit_status(program, run)
        except SystemExit as error:  # argparse has printed its help
            status = error.code if isinstance(error.code, int) else 0
        out.flush()
        if out.problem and not isinstance(out.problem, BrokenPipeError):
            print(f"{program}: cannot write the output: {out.problem.strerror}", file=errors)
            status = status or BAD_INPUT
    ended.append(status)
    return status


def _end_at_once(ended: list[int]) -> None:
    if ended:
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError, AttributeError):
                stream.flush()
        os._exit(ended[0])
