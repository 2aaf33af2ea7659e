"""`abfm batch`: a table of problems, or one match with all combinations of some options."""

import argparse
import csv
import json
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from textwrap import TextWrapper
from typing import Any

from abfm import AbfmError, ResultError
from abfm.batch import Ledger, LedgerEntry, Row, combinations, read_table
from abfm.batch import run as run_rows
from abfm.batch.cluster import ConnectionLostError
from abfm.batch.run import REPORTED_STEPS, ROWS_READ_MIN
from abfm.batch.table import known_columns
from abfm.display import BEST_VIEW, ViewSpec
from abfm.errors import ColumnError, ParameterError, brief, did_you_mean, one_line, printable
from abfm.io import write_atomically, write_csv
from abfm.matching.task import MatchTask
from abfm.mesh import load_mesh
from abfm.outcome import Outcome
from abfm.parameters import option
from abfm.tasks.inputs import MESH_INPUTS, mesh_options
from abfm.wording import counted
from abfm.workers import Control
from abfm_viewer import pictures
from abfm_viewer.cli import options
from abfm_viewer.cli.exit_status import (
    FAILED_STATUS,
    UNMATCHED_STATUS,
    UsageError,
    cancelled_by_signals,
    print_line,
    print_note,
)
from abfm_viewer.cli.progress import row_progress
from abfm_viewer.files import outputs
from abfm_viewer.reports import batches
from abfm_viewer.reports.batches import ROWS_SHOWN_MAX

SUMMARY = "solve a table of problems on all cores or a cluster, and resume it later"
ROWS_AFTER_SIGNAL_MAX = ROWS_READ_MIN
"""Largest number of rows whose summary is also written after a signal, in less than 1 s."""
_FAILURES_MAX = 8  # printed failures
_NAMES_MAX = 8  # printed names of rows with one outcome
_PICTURE_COLORS = 64  # colours of a small picture
_PARAGRAPH = TextWrapper(96, "  ", "  ", break_on_hyphens=False)
DESCRIPTION = """\
Solve a table of problems, one per row, on the cores of this machine or on a Dask cluster. Each
result is a file DIR/<digest>.npz. Run the same command again to resume: it solves only the rows
without a result. Rows that fail are reported and do not stop the others.

With --over, solve one match with all combinations of some option values, without a table. Its
options are those of `abfm match`.

Examples:
  abfm batch table.csv --out results
  abfm batch table.csv --out results --scheduler tcp://10.0.0.1:8786
  abfm batch --status results
  abfm batch spot.obj --source gaussian:vertex=12 --target gaussian:vertex=900 \\
      --over alpha=0.003,0.01,0.03 --over sigma=0.01,0.1 --out sweep

The first line of TABLE.csv names its columns, which are options of `abfm match`, `abfm register`
and `abfm sequence`:
  name,mesh,source,target
  one,a.off,"gaussian:vertex=1,width=0.2",curvature:mean

The exit status is 0 if all rows reached their target, 3 if some did not, 4 if some failed, 2 for
bad input.
"""
DETAILS = f"""\
Table:
  Columns decide what a row is, unless the column `task` names it, such as `symmetric`:
    a match         mesh, source, target, channel, mask, start, alpha, sigma, ...
    a registration  a, b, source, target, landmarks, initial, mask-a, mask-b, ...
    a sequence      frames, mesh, array, dt, gamma, channel, mask, alpha, sigma, ...
    a problem       problem: a file written by `abfm.Problem.save`
  Empty cells take the default. Paths begin at the folder of the table. Put a cell with a comma in
  double quotes; the same holds for values of --over:
    --over 'target=eigenfunction:3,"gaussian:vertex=7,width=0.2"'
  All columns:
{_PARAGRAPH.fill(", ".join(["name", *known_columns()]))}

Output:
  DIR/<digest>.npz   the result of a row; files are complete even if the run is killed
  DIR/summary.csv    one line per row: digest, verdict, residuals and columns
  DIR/summary.html   page with the {ROWS_SHOWN_MAX:,} worst rows, their pictures, and counts of all

Exit status:
  0    all rows are matched, nearly matched or registered
  2    the table is not valid; nothing is solved
  3    some rows did not reach their target
  4    some rows failed or, with --status, are not finished
  130  Ctrl-C ended the run (143: SIGTERM, 129: closed terminal); finished results are kept. Of
       more than {ROWS_AFTER_SIGNAL_MAX} rows, `abfm batch --status DIR` writes the summary
"""
MAIN_OPTIONS = (
    "over",
    "status",
    "jobs",
    "scheduler",
    "scheduler-file",
    "out",
    "json",
    "source",
    "target",
    "channel",
    "mask",
    "set",
)


def add_arguments(parser: options.Parser) -> None:
    add = options.adder(parser)
    about = "comma-separated table with one problem per row; with --over a triangle mesh"
    add("table", about, "TABLE.csv", nargs="?", type=Path)
    about = "values of an option of the match; repeatable, for all combinations"
    add("--over", about, "NAME=A,B,...", action="append", default=[])
    about = "solve nothing; write and print the summary of TABLE.csv, or of the last run in DIR"
    add("--status", about, "DIR", nargs="?", const=True)
    options.add_workers(parser)
    options.add_folder(parser)
    options.add_inputs(parser, MatchTask.inputs, ("mesh",))


def run(arguments: argparse.Namespace) -> int:
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
        raise UsageError(
            f"--{name} needs --over NAME=A,B,..., the option to vary on a mesh; a TABLE.csv has a "
            f"column {name} instead"
        )
    with row_progress(0, arguments.quiet, "reading"):  # seconds for tens of thousands of rows
        if arguments.table is None:
            title, entries = ledger.read_rows()
        else:
            rows, title = read_table(arguments.table), printable(arguments.table.name)
            if status is not None and not ledger.folder.is_dir():
                folder = printable(arguments.out)
                raise UsageError(
                    f"the folder {folder} does not exist; give the folder of the results of a batch"
                )
            entries = [] if status is None else ledger.entries(rows)
    if status is None:
        return solve(rows, title, arguments)
    return _report(entries, title, arguments)


def _find_folder(arguments: argparse.Namespace) -> None:
    """Decide whether the value of ``--status`` is a folder of results or a table."""
    status = arguments.status
    if isinstance(status, str) and arguments.out is None:
        arguments.out = Path(status)
    elif isinstance(status, str) and arguments.table is None:  # --status TABLE.csv --out DIR
        arguments.table = Path(status)
    elif isinstance(status, str) and Path(status) != arguments.out:
        raise UsageError("--status and --out name different folders; give one of them")
    if arguments.out is None:
        name = "--out" if status is None else "--status DIR"
        raise UsageError(f"{name} is missing; give the folder of the results")
    if arguments.table is None and status is None:
        raise UsageError("TABLE.csv is missing; see abfm batch --help")


def _swept(
    given: Sequence[tuple[str, str]], arguments: argparse.Namespace
) -> tuple[list[Row], str]:
    """Return one row per combination of the option values of ``--over``, and the batch's title."""
    if arguments.status is not None or arguments.table is None:
        raise UsageError(
            "--over needs a mesh and excludes --status: abfm batch MESH --over NAME=A,B"
        )
    over: dict[str, list[str]] = {}
    for word in arguments.over:
        name, values = _values(word)
        if name in over:
            raise UsageError(f"--over {name} is given twice; give all its values in one option")
        over[name] = values
    try:
        rows = combinations([("mesh", arguments.table), *given], over)
    except ColumnError as error:
        raise UsageError(error.message_with(f"--{error.column}")) from error
    except ParameterError as error:
        raise UsageError(str(error)) from error
    first = rows[0].values()
    if not over.keys() & {each.name for each in MESH_INPUTS}:
        load_mesh(first["mesh"], **mesh_options(first).changed)  # otherwise every row would fail
    return rows, f"{printable(arguments.table.name)}, over {' and '.join(over)}"


def _values(word: str) -> tuple[str, list[str]]:
    """Split ``NAME=A,B,...`` into the name of an option and its values."""
    names = [each.name for each in MatchTask.inputs if each.name != "mesh" and not each.repeats]
    name, sign, text = word.partition("=")
    name = option(name.strip().lower().removeprefix("--"))
    if not (sign and name):
        raise UsageError(f"--over {brief(word)} is not NAME=A,B,...")
    if name not in names:
        raise UsageError(
            f"--over: {brief(name)} is not an option of a match{did_you_mean(name, names)}"
        )
    try:
        (values,) = csv.reader([text], skipinitialspace=True, strict=True)
    except (csv.Error, ValueError):
        values = []
    values = [value.strip() for value in values]
    if not values or not all(values):
        raise UsageError(f"--over {brief(word)}: expected values separated by commas")
    if len(set(values)) < len(values):
        raise UsageError(f"--over {brief(word)} has a repeated value")
    return name, values


def solve(rows: Sequence[Row], title: str, arguments: argparse.Namespace) -> int:
    """Solve the rows without a result, write and print the summary, and return the exit status."""
    start = time.perf_counter()
    try:
        entries, status = solved(rows, title, arguments.out, arguments)
    except ConnectionLostError as error:
        print_line(f"abfm: {error}")
        entries, status = Ledger(arguments.out).entries(rows), FAILED_STATUS
    seconds = time.perf_counter() - start
    if status not in (None, FAILED_STATUS) and len(rows) > ROWS_AFTER_SIGNAL_MAX:
        done = sum(entry.state == "done" for entry in entries)
        print_line(f"finished: {done:,} of {len(rows):,} rows; {_resume_advice(True)}")
        return status
    return _report(entries, title, arguments, seconds, status)


def solved(
    rows: Sequence[Row], title: str, folder: Path, arguments: argparse.Namespace
) -> tuple[list[LedgerEntry], int | None]:
    """Solve the rows without a result; return all rows, and the exit status after a signal."""
    cluster, control, ledger = options.cluster_of(arguments), Control(), Ledger(folder)
    ledger.make()
    ledger.write_rows(rows, title)
    entries = ledger.entries(rows)
    remaining = [number for number, entry in enumerate(entries) if entry.state != "done"]
    if len(remaining) < len(rows) and not arguments.quiet:
        done = len(rows) - len(remaining)
        print_line(f"already finished: {done} of {counted(len(rows), 'row')}")
    keys = {rows[number].key for number in remaining}
    with (
        cancelled_by_signals(control, "with the finished rows") as interrupt,
        row_progress(len(keys), arguments.quiet, reported=REPORTED_STEPS) as report,
    ):
        solved_entries = run_rows(
            [rows[number] for number in remaining],
            ledger.folder,
            cluster,
            on_change=lambda entry: report(_line(batches.SummaryRow(entry, entry.facts))),
            control=control,
        )
    for number, entry in zip(remaining, solved_entries, strict=True):
        entries[number] = entry
    return entries, interrupt.status


def _report(
    entries: Sequence[LedgerEntry],
    title: str,
    arguments: argparse.Namespace,
    seconds: float | None = None,
    status: int | None = None,
) -> int:
    """Write and print the summary, and return the exit status.

    ``seconds`` is the duration of the run; None if nothing was solved. ``status`` is the exit
    status after a signal; no pictures are drawn then.
    """
    rows, folder = list[batches.SummaryRow](), Path(arguments.out)
    with row_progress(0, arguments.quiet, "reading") as report:
        for number, entry in enumerate(entries, 1):
            report(f"row {number} of {len(entries)}")
            rows.append(batches.SummaryRow(entry, entry.facts))
    draws = status is None and not arguments.no_pictures
    try:
        with row_progress(0, arguments.quiet or not draws, "drawing") as report:
            written, no_pictures = write_summary(
                folder, title, rows, report if draws else None, options.view_of(arguments)
            )
    except ResultError as error:
        if seconds is not None:
            raise
        print_note(f"the summary was not written: {error}")
        written, no_pictures = [], ""
    if no_pictures:
        print_note(f"the summary has no pictures: {no_pictures}")
    best = batches.best_of(rows)
    if arguments.json:
        head = {
            "out": str(folder),
            "counts": batches.counts(rows),
            "seconds": seconds,
            "best": None if best is None else best.to_dict(),
            "summary": list(map(str, written)),
        }
        _print_json(head, rows)
    else:
        print("\n".join(_lines(rows, best, written, seconds)))
    return _status(rows) if status is None else status


def _print_json(head: dict[str, Any], rows: Sequence[batches.SummaryRow]) -> None:
    """Print one JSON object with the head and the rows; the rows are converted one by one."""
    print(json.dumps(head)[:-1], end=', "rows": [')
    for number, row in enumerate(rows):
        print(", " if number else "", json.dumps(row.to_dict()), sep="", end="")
    print("]}")


def _status(rows: Sequence[batches.SummaryRow]) -> int:
    outcomes = batches.counts(rows).keys()
    if outcomes & {Outcome.FAILED, Outcome.MISSING}:
        return FAILED_STATUS
    return 0 if all(outcome.is_good for outcome in outcomes) else UNMATCHED_STATUS


def _line(row: batches.SummaryRow) -> str:
    """Return a line: ``sub-01: matched (residual 2.1%), in 1.2 s``, or the reason for a failure."""
    name, facts = one_line(row.name, 80), row.facts
    if not row.is_known:
        return f"{name}: {facts.outcome}: {facts.reason}"
    return f"{name}: {facts.headline}{_duration(row.entry.record.seconds)}"


def _lines(
    rows: Sequence[batches.SummaryRow],
    best: batches.Best | None,
    written: Sequence[Path],
    seconds: float | None,
) -> list[str]:
    found = batches.counts(rows)
    words = ", ".join(
        f"{count} {'not finished' if outcome is Outcome.MISSING else outcome}"
        for outcome, count in found.items()
    )
    lines = [f"{counted(len(rows), 'row')}: {words}{_duration(seconds)}"]
    lines += _unsolved_lines(rows)
    lines += [] if best is None else best.sentences()
    failed = [row for row in rows if row.facts.outcome is Outcome.FAILED or row.entry.reason]
    lines += [f"  {_line(row)}" for row in failed[:_FAILURES_MAX]]
    if len(failed) > _FAILURES_MAX:
        lines.append(f"  and {len(failed) - _FAILURES_MAX} more, listed in the summary")
    if found.get(Outcome.MISSING):
        lines.append(_resume_advice(seconds is not None))
    if written:
        lines.append(f"wrote {', '.join(printable(path) for path in written)}")
    return lines


def _unsolved_lines(rows: Sequence[batches.SummaryRow]) -> list[str]:
    lines = []
    for outcome in (Outcome.NOT_REACHED, Outcome.IMPOSSIBLE, Outcome.MISSING):
        names = [one_line(row.name, 80) for row in rows if row.facts.outcome is outcome]
        if not names:
            continue
        label = "not finished" if outcome is Outcome.MISSING else outcome
        more = len(names) - _NAMES_MAX
        tail = f" and {more} more, listed in the summary" if more > 0 else ""
        lines.append(f"  {label}: {'; '.join(names[:_NAMES_MAX])}{tail}")
    return lines


def _duration(seconds: float | None) -> str:
    return "" if seconds is None else f", in {seconds:.1f} s"


def _resume_advice(was_run: bool) -> str:
    command = "the same command" if was_run else "the command without --status"
    return f"run {command} to resume; finished rows are kept"


def write_summary(
    folder: Path,
    title: str,
    rows: Sequence[batches.SummaryRow],
    report: Callable[[str], object] | None = None,
    view: ViewSpec = BEST_VIEW,
) -> tuple[list[Path], str]:
    """Write ``summary.csv``, in the order of the rows, and ``summary.html``, worst rows first.

    If ``report`` is given, missing pictures of rows on the page are drawn and stored in a
    subfolder; ``report`` is called with their progress. Return the paths of the written files, and
    the reason for missing pictures, or an empty text.
    """
    table, shown_page = folder / "summary.csv", folder / "summary.html"
    _write_table(table, rows)
    shown = [row.entry for row in batches.worst(rows) if row.is_known]
    ending = "" if view == BEST_VIEW else f"-{view.name}-{view.up}"
    files = {entry.digest: folder / "pictures" / f"{entry.digest}{ending}.png" for entry in shown}
    reason = _draw(shown, files, report, view) if report else ""
    small = {digest: path.read_bytes() for digest, path in files.items() if path.is_file()}
    outputs.write_text(shown_page, batches.batch_page(title, rows, small, reason))
    return [table, shown_page], reason


def _write_table(path: Path, rows: Sequence[batches.SummaryRow]) -> None:
    repeats: Counter[str] = Counter()
    for row in rows:
        repeats |= Counter(column for column, _ in row.entry.row.options)
    columns = list(repeats.elements())
    own = [key for key in rows[0].to_dict() if key != "file"] if rows else []
    write_csv(path, [[*own, *columns], *(_cells(row, own, columns) for row in rows)])


def _cells(row: batches.SummaryRow, own: Sequence[str], columns: Sequence[str]) -> list[object]:
    given = defaultdict[str, list[str]](list)
    for column, text in reversed(row.entry.row.options):
        given[column].append(text)
    facts = row.to_dict()
    return [
        *(facts[key] for key in own),
        *(given[column].pop() if given[column] else "" for column in columns),
    ]


def _draw(
    entries: Sequence[LedgerEntry],
    files: Mapping[str, Path],
    report: Callable[[str], object],
    view: ViewSpec,
) -> str:
    """Draw missing pictures; return the reason if the machine cannot draw, else an empty text."""
    missing = {entry.path: entry for entry in entries if not files[entry.digest].is_file()}
    results = [(path, entry.row.task_type) for path, entry in missing.items() if path]
    try:
        for number, (path, drawn) in enumerate(pictures.row_pictures(results, view), 1):
            report(f"picture {number} of {len(results)}")
            if not isinstance(drawn, AbfmError):
                place = files[missing[path].digest]
                place.parent.mkdir(exist_ok=True)
                with write_atomically(place) as temporary:
                    drawn.quantize(_PICTURE_COLORS).save(temporary, "PNG", optimize=True)
    except (AbfmError, OSError) as error:
        return one_line(error, 300)
    return ""
