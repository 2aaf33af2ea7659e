"""`abfm bench`: the solver against what a user would compare it with."""

from __future__ import annotations

import argparse
import json
import sys

from abfm_viewer.cli.options import positive

SUMMARY = "measure the solver against the paper's algorithm and plain L-BFGS"
DESCRIPTION = """\
Measure the solver against the paper's algorithm and plain L-BFGS, how it scales, and what its gradient costs.

Takes about four minutes, alone on the machine: most of it is the time that the baselines get. With --viewer it measures
the window instead: how long it takes to open, what it costs the solver, and how even its frames are during a solve.

Examples:
  abfm bench --json > bench.json
  abfm bench --viewer
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--seconds", type=positive, default=60.0, metavar="S", help="time for each baseline (default: 60)"
    )
    parser.add_argument("--viewer", action="store_true", help="measure the window (off the screen where there is none)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--quiet", action="store_true", help="no progress")


def run(arguments: argparse.Namespace) -> int:
    """Measure and print."""

    def tell(line: str) -> None:
        if not arguments.quiet:
            print(line, file=sys.stderr, flush=True)

    if arguments.viewer:
        from abfm_viewer import benchmark as viewer_benchmark  # not before: it needs OpenGL

        report = viewer_benchmark.run(tell)
        text = viewer_benchmark.format_report(report)
    else:
        from abfm.baselines import benchmark  # not before: it loads much that the other commands do without

        report = benchmark.run(tell, seconds=arguments.seconds)
        text = benchmark.format_report(report)
    print(json.dumps(report, allow_nan=False) if arguments.json else text)
    return 0
