"""`abfm bench`: the solver against what a user would compare it with."""

from __future__ import annotations

import argparse
import json
import sys

from abfm_viewer.cli.options import positive

SUMMARY = "measure the solver against the paper's algorithm and plain L-BFGS"
DESCRIPTION = """\
Measure the solver against the paper's algorithm and plain L-BFGS, how it scales, and what its gradient costs.

Takes about four minutes, alone on the machine: most of it is the time that the baselines get.

Example:
  abfm bench --json > bench.json
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--seconds", type=positive, default=60.0, metavar="S", help="time for each baseline (default: 60)"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--quiet", action="store_true", help="no progress")


def run(arguments: argparse.Namespace) -> int:
    """Measure and print."""
    from abfm.baselines import benchmark  # not before: it loads much that the other commands do without

    def tell(line: str) -> None:
        if not arguments.quiet:
            print(line, file=sys.stderr, flush=True)

    report = benchmark.run(tell, seconds=arguments.seconds)
    print(json.dumps(report, allow_nan=False) if arguments.json else benchmark.format_report(report))
    return 0
