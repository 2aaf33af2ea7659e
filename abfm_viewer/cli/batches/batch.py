"""`abfm batch`: a table of problems."""

import argparse
from pathlib import Path
from textwrap import TextWrapper

from abfm.batch import Ledger, read_table
from abfm.batch.table import known_columns
from abfm.errors import printable
from abfm_viewer.cli import options
from abfm_viewer.cli.batches.rows import ROWS_SHOWN_MAX
from abfm_viewer.cli.batches.running import (
    ROWS_AFTER_SIGNAL_MAX,
    add_cluster,
    report_all,
    solve,
)
from abfm_viewer.cli.exit_status import UsageError
from abfm_viewer.cli.progress import row_progress
from abfm_viewer.files import outputs

SUMMARY = "solve a table of problems, on all cores or a cluster, and go on where it was ended"
_FILLED = TextWrapper(96, "  ", "  ", break_on_hyphens=False)
DESCRIPTION = f"""\
Solve a table of problems, a row each, by this machine's cores or a Dask cluster; a result is
DIR/<digest>.npz. Run again, it does what is missing and nothing else: whatever was killed, at any
moment, leaves whole files. Rows that fail are told, and do not stop others.

Examples:
  abfm batch table.csv --out results
  abfm batch table.csv --out results --scheduler tcp://10.0.0.1:8786
  abfm batch --status results

The first line of TABLE.csv names its columns, as the options of `abfm match`, `abfm register`
and `abfm sequence` are named, and may have `name`. A row is
  a match where it has a mesh: mesh, source, target, channel, mask, start, alpha, sigma, ...
  a registration where it has a and b: a, b, source, target, landmarks, initial, mask-a, mask-b, ...
  a film where it has frames: mesh, frames, array, dt, gamma, mask, weights, alpha, sigma, ...
  a problem where it has problem: a file that `abfm.Problem.save` wrote
Empty cells have their defaults. Paths begin at the table's folder. A cell with a comma stands in
double quotes:
  name,mesh,source,target
  one,a.off,"gaussian:vertex=1,width=0.2",curvature:mean
All columns are
{_FILLED.fill(", ".join(["name", *known_columns()]))}

DIR/summary.csv has a line for each row: its digest, verdict, residuals and columns.
DIR/summary.html is a page of the worst {ROWS_SHOWN_MAX:,} rows with a picture of each, and counts
of all.

The exit status is 0 when all rows are matched, nearly or registered; 3 when some did not reach
their target; 4 when some failed, or with --status are not done; 2 for a table that does not fit,
of which nothing is solved; and 130 or 143 after Ctrl-C or SIGTERM: results that are done are kept,
and the summary of more than {ROWS_AFTER_SIGNAL_MAX} rows is left to `abfm batch --status DIR`.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = options.adder(parser)
    add("table", "comma-separated, a problem a row", "TABLE.csv", nargs="?", type=Path)
    add(
        "--status",
        "solve nothing: write and tell the summary of what is done, of TABLE.csv or of all that "
        "was asked for last",
        "DIR",
        nargs="?",
        const=True,
    )
    add_cluster(parser)


def run(arguments: argparse.Namespace) -> int:
    """Solve a table, or tell how far one is."""
    status = arguments.status
    if isinstance(status, str) and arguments.out is None:
        arguments.out = Path(status)
    elif isinstance(status, str) and arguments.table is None:  # --status TABLE.csv --out DIR
        arguments.table = Path(status)
    elif isinstance(status, str) and Path(status) != arguments.out:
        raise UsageError("--status and --out name two folders; give one")
    if arguments.out is None:
        how = "--out" if status is None else "--status DIR"
        raise UsageError(f"{how} is missing: the folder of the results")
    if arguments.table is None and status is None:
        raise UsageError("TABLE.csv is missing; see abfm batch --help")
    ledger = Ledger(arguments.out)
    if arguments.table is not None:
        outputs.check_not_read(arguments.out / "summary.csv", [str(arguments.table)])
    with row_progress(0, arguments.quiet, "reading"):  # some seconds, of tens of thousands of rows
        if arguments.table is None:
            title, entries = ledger.kept()
        else:
            rows, title = read_table(arguments.table), printable(arguments.table.name)
            if status is not None and not ledger.folder.is_dir():
                folder = printable(arguments.out)
                raise UsageError(f"there is no folder {folder}: nothing was solved yet")
            entries = [] if status is None else ledger.entries(rows)
    if status is None:
        return solve(rows, title, arguments)
    return report_all(entries, title, arguments)
