"""The one command line, `abfm`: exit status 0; 2 with one line on stderr for bad input; 128 and its
number after a signal (130 after Ctrl-C, 143 after SIGTERM, 129 when the terminal was closed).
"""

import sys
from collections.abc import Callable

from abfm_viewer import signals

_LOADING_BYTES = 450e6
"""Address space of the libraries and a small match: if it runs out in the middle, OpenBLAS retries
without end, and others crash.
"""


def main(argv: list[str] | None = None) -> int:
    """Run the command line and return the exit status; without words given it is the program's."""
    return program("abfm", _run, argv)


def program(name: str, run: Callable[[list[str]], int], argv: list[str] | None) -> int:
    """Run a program with these words, or with those of the process, which then belongs to it."""
    if argv is None:
        # before anything else: loading takes longer than many commands
        signals.leave_on_signals(name)
    from abfm_viewer.cli.exit_status import exit_status, program_status

    if argv is None:
        return program_status(name, lambda: run(sys.argv[1:]))
    return exit_status(name, lambda: run(argv))


def _run(words: list[str]) -> int:
    from abfm.numerics.available_memory import require_memory

    require_memory(_LOADING_BYTES)
    from abfm_viewer.cli.commands import run

    return run(words)
