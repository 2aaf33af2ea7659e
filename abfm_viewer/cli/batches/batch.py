"""`abfm batch`: a table of tasks, or one match with all combinations of some options."""

import argparse
import csv
import re
from collections.abc import Sequence
from pathlib import Path
from textwrap import TextWrapper

from abfm.batch import Ledger, Row, combinations, read_table
from abfm.batch.table import known_columns
from abfm.errors import ParameterError, brief, did_you_mean, printable
from abfm.matching.task import MatchTask
from abfm.mesh import load_mesh
from abfm.parameters import option
from abfm.tasks.inputs import MESH_INPUTS, mesh_options
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

SUMMARY = "solve a table of tasks on all cores or a cluster, and resume where it was ended"
_PARAGRAPH = TextWrapper(96, "  ", "  ", break_on_hyphens=False)
DESCRIPTION = f"""\
Solve a table of tasks, a row each, by this machine's cores or a Dask cluster; a result is
DIR/<digest>.npz. The same command solves what is missing and nothing else: a run that is killed, at
any moment, leaves complete files. Rows that fail are reported, and do not stop others.

With --over, solve one match with all combinations of some options' values: the table is made of the
options.

Examples:
  abfm batch table.csv --out results
  abfm batch table.csv --out results --scheduler tcp://10.0.0.1:8786
  abfm batch --status results
  abfm batch spot.obj --source gaussian:vertex=12 --target gaussian:vertex=900 \\
      --over alpha=0.003,0.01,0.03 --over sigma=0.01,0.1 --out sweep
  abfm batch spot.obj --source hks:time=0.01 \\
      --over 'target=eigenfunction:3,"gaussian:vertex=7,width=0.2"' --out targets

The first line of TABLE.csv names its columns, as the options of `abfm match`, `abfm register`
and `abfm sequence` are named, and may have `name`. A row is
  a match where it has a mesh: mesh, source, target, channel, mask, start, alpha, sigma, ...
  a registration where it has a and b: a, b, source, target, landmarks, initial, mask-a, mask-b, ...
  a sequence where it has frames: mesh, frames, array, dt, gamma, mask, weights, alpha, sigma, ...
  a problem where it has problem: a file that `abfm.Problem.save` wrote
Empty cells have their defaults. Paths begin at the table's folder. A cell with a comma stands in
double quotes:
  name,mesh,source,target
  one,a.off,"gaussian:vertex=1,width=0.2",curvature:mean
All columns are
{_PARAGRAPH.fill(", ".join(["name", *known_columns()]))}

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
    about = "comma-separated, a task a row; with --over a triangle mesh"
    add("table", about, "TABLE.csv", nargs="?", type=Path)
    add(
        "--over",
        "values of an option of the match, repeatable; one with a comma stands in double quotes",
        "NAME=A,B,...",
        action="append",
        default=[],
    )
    add(
        "--status",
        "solve nothing: write and print the summary of what is done, of TABLE.csv or of the last "
        "run",
        "DIR",
        nargs="?",
        const=True,
    )
    add_cluster(parser)
    options.add_inputs(parser, MatchTask.inputs, ("mesh",))


def run(arguments: argparse.Namespace) -> int:
    """Solve a table, or report how far one is."""
    status = arguments.status
    _find_folder(arguments)
    ledger = Ledger(arguments.out)
    if arguments.table is not None:
        outputs.check_not_read(arguments.out / "summary.csv", [str(arguments.table)])
    given = list(options.given_texts(arguments, MatchTask.inputs))
    if arguments.over:
        return solve(*_swept(given, arguments), arguments)
    if given:
        name = given[0][0]
        raise UsageError(f"--{name} is for --over; give TABLE.csv a column {name}")
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


def _find_folder(arguments: argparse.Namespace) -> None:
    """Take the folder, or the table, of ``--status`` for what it is."""
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


def _swept(
    given: Sequence[tuple[str, str]], arguments: argparse.Namespace
) -> tuple[list[Row], str]:
    """Return a row for each combination of values, and the title of all."""
    if arguments.status is not None or arguments.table is None:
        raise UsageError("--over needs a mesh, and no --status: abfm batch MESH --over NAME=A,B")
    over: dict[str, list[str]] = {}
    for word in arguments.over:
        name, values = _values(word)
        if name in over:
            raise UsageError(f"--over {name} is given twice; give all its values in one")
        over[name] = values
    try:
        rows = combinations([("mesh", arguments.table), *given], over)
    except ParameterError as error:
        raise UsageError(re.sub("^column ", "--", str(error))) from error
    first = rows[0].values()
    if not over.keys() & {each.name for each in MESH_INPUTS}:
        load_mesh(first["mesh"], **mesh_options(first).given)  # else it would fail every row
    return rows, f"{printable(arguments.table.name)}, over {' and '.join(over)}"


def _values(word: str) -> tuple[str, list[str]]:
    """Return the option and the values of ``NAME=A,B,...``."""
    names = [each.name for each in MatchTask.inputs if each.name != "mesh" and not each.repeats]
    name, sign, text = word.partition("=")
    name = option(name.strip().lower().removeprefix("--"))
    if not (sign and name):
        raise UsageError(f"--over {brief(word)} is not NAME=A,B,...")
    if name not in names:
        raise UsageError(
            f"--over: a match has no option {brief(name)} to vary{did_you_mean(name, names)}"
        )
    try:
        (values,) = csv.reader([text], skipinitialspace=True, strict=True)
    except (csv.Error, ValueError):
        values = []
    values = [value.strip() for value in values]
    if not values or not all(values):
        raise UsageError(f"--over {brief(word)}: expected values with commas between")
    if len(set(values)) < len(values):
        raise UsageError(f"--over {brief(word)} has a value twice")
    return name, values
