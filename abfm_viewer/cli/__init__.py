"""The command line `abfm`.

The exit status is 0, or 2 with one line on stderr for bad input. After a signal it is 128 plus the
number of the signal: 130 for Ctrl-C, 143 for SIGTERM, 129 for a closed terminal.
"""

import sys
from collections.abc import Callable

from abfm_viewer import signals

_LOADING_BYTES = 450e6
"""Address space of libraries and a small match; with less they hang (OpenBLAS) or crash."""


def main(argv: list[str] | None = None) -> int:
    """Run the command line, by default the arguments of the process; return the exit status."""
    return program("abfm", _run, argv)


def program(name: str, run: Callable[[list[str]], int], argv: list[str] | None) -> int:
    """Run a program, and return its exit status.

    If ``argv`` is None, take the arguments of the process, handle signals, and end the process.
    """
    if argv is None:
        # signals are handled before the imports, which take longer than many commands
        signals.exit_on_signals(name)
    from abfm_viewer.cli.exit_status import exit_status, program_status

    if argv is None:
        return program_status(name, lambda: run(sys.argv[1:]))
    return exit_status(name, lambda: run(argv))


def _run(words: list[str]) -> int:
    from abfm.numerics.available_memory import require_memory

    require_memory(_LOADING_BYTES)
    from abfm_viewer.cli.commands import run

    return run(words)
