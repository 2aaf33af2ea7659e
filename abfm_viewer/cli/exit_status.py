"""How a program ends: the one place where an error becomes a line on stderr and an exit status."""

import os
import sys
from collections.abc import Callable

from abfm import AbfmError

BAD_INPUT, UNMATCHED, INTERRUPTED = 2, 3, 130


class UsageError(Exception):
    """A command line that cannot be understood; the text is one line."""


def exit_status(program: str, run: Callable[[], int]) -> int:
    """Run a program and return its exit status; bad input gives 2 and one line, Ctrl-C gives 130."""
    try:
        status = run()
        sys.stdout.flush()
    except KeyboardInterrupt:
        print(f"{program}: interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # whoever read our output has enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (AbfmError, UsageError, OSError, MemoryError) as error:
        print(f"{program}: {' '.join(str(error).split()) or 'out of memory'}", file=sys.stderr)
        return BAD_INPUT
    return status
