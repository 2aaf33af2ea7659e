"""The one command line, `abfm`: a thin layer over both packages.

Exit status: 0; 2 with one line on stderr for bad input; 128 and its number after a signal: 130
after Ctrl-C, 143 after SIGTERM, 129 when the terminal was closed.
"""

import sys

from abfm_viewer import signals


def main(argv: list[str] | None = None) -> int:
    """Run the command line and return the exit status; without words given it is the program's."""
    if argv is None:
        # before anything else: loading takes longer than many commands
        signals.leave_on_signals("abfm")
    from abfm_viewer.cli.exit_status import exit_status, program_status

    if argv is None:
        return program_status("abfm", lambda: _run(sys.argv[1:]))
    return exit_status("abfm", lambda: _run(argv))


def _run(words: list[str]) -> int:
    from abfm_viewer.cli.commands import run

    return run(words)
