"""The one command line, `abfm`: a thin layer over both packages.

Exit status: 0; 2 with one line on stderr for bad input; 130 after Ctrl-C.
"""

import sys

from abfm_viewer.cli.exit_status import exit_status


def main(argv: list[str] | None = None) -> int:
    """Run the command line and return the exit status."""
    return exit_status("abfm", lambda: _run(sys.argv[1:] if argv is None else argv))


def _run(words: list[str]) -> int:
    from abfm_viewer.cli.commands import run  # not before: Ctrl-C may come while the solver loads

    return run(words)
