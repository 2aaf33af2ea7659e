"""How rows of a table are solved here: with signals, progress and a summary."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from abfm import Control, ResultError
from abfm.batch import Cluster, Ledger, LedgerEntry, Row, run
from abfm.batch.cluster import LostError
from abfm.batch.run import REPORTED_STEPS, ROWS_READ_MIN
from abfm.errors import one_line, printable
from abfm.outcome import Outcome
from abfm.wording import counted
from abfm_viewer.cli import options
from abfm_viewer.cli.batches.best import Best, best_of
from abfm_viewer.cli.batches.rows import SummaryRow, counts, summary_row
from abfm_viewer.cli.batches.summary import Drawing, write_summary
from abfm_viewer.cli.exit_status import FAILED_STATUS, UNMATCHED_STATUS, UsageError
from abfm_viewer.cli.interrupts import cancelled_by_signals
from abfm_viewer.cli.progress import row_progress

ROWS_AFTER_SIGNAL_MAX = ROWS_READ_MIN
"""Rows of the largest batch whose summary is written after a signal, which takes under a second."""
_FAILURES_MAX = 8  # that are printed


def add_workers(parser: argparse.ArgumentParser) -> None:
    """Declare who solves."""
    add = options.adder(parser.add_argument_group("who solves"))
    what = "so many processes of this machine (default: one for each core)"
    add("--jobs", what, "N", type=options.processes)
    what = (
        "a Dask cluster's scheduler instead, such as tcp://10.0.0.1:8786; whoever controls it can "
        "run programs on this machine and on its workers: use one that you trust"
    )
    add("--scheduler", what, "ADDRESS", type=options.address)
    add("--scheduler-file", "the same by the file in which it has its address", "FILE", type=Path)


def add_cluster(parser: argparse.ArgumentParser) -> None:
    """Declare who solves, where results go, and what is told."""
    add_workers(parser)
    add = options.adder(parser.add_argument_group("output"))
    about = "folder for results: made if it is not there"
    add("--out", about, "DIR", type=options.folder)
    options.add_up(add)
    add("--no-pictures", "a summary without pictures, which take a tenth of a second each")
    add("--json", "print one JSON object about all rows")
    add("--quiet", "no progress")


def cluster_of(arguments: argparse.Namespace) -> Cluster:
    given = arguments.jobs, arguments.scheduler, arguments.scheduler_file
    if sum(each is not None for each in given) > 1:
        raise UsageError("give one of --jobs, --scheduler and --scheduler-file, or none")
    return Cluster(*given)


def solve(rows: Sequence[Row], title: str, arguments: argparse.Namespace) -> int:
    """Solve the rows that have no result, write and print the summary; return the exit status."""
    began = time.perf_counter()
    try:
        entries, status = solved(rows, title, arguments.out, arguments)
    except LostError as error:
        print(f"abfm: {error}", file=sys.stderr)
        entries, status = Ledger(arguments.out).entries(rows), FAILED_STATUS
    seconds = time.perf_counter() - began
    if status not in (None, FAILED_STATUS) and len(rows) > ROWS_AFTER_SIGNAL_MAX:
        done = sum(entry.state == "done" for entry in entries)
        print(f"{done:,} of {len(rows):,} rows are done; {_how_to_resume(True)}", file=sys.stderr)
        return status
    return report_all(entries, title, arguments, seconds, status)


def solved(
    rows: Sequence[Row], title: str, folder: Path, arguments: argparse.Namespace
) -> tuple[list[LedgerEntry], int | None]:
    """Solve the rows of a folder that have no result, with progress.

    Returns
    -------
    entries : list of Entry
        What is known of each row.
    status : int or None
        The exit status of a signal, if one came.
    """
    cluster, control, ledger = cluster_of(arguments), Control(), Ledger(folder)
    ledger.make()
    ledger.write_rows(rows, title)
    entries = ledger.entries(rows)
    left = [number for number, entry in enumerate(entries) if entry.state != "done"]
    if len(left) < len(rows) and not arguments.quiet:
        done = f"{len(rows) - len(left)} of {counted(len(rows), 'row')}"
        print(f"{done} are there already", file=sys.stderr)
    keys = {rows[number].key for number in left}
    with (
        cancelled_by_signals(control, "with the rows that are done") as interrupt,
        row_progress(len(keys), arguments.quiet, reported=REPORTED_STEPS) as report,
    ):

        def show(entry: LedgerEntry) -> None:
            report(_line(summary_row(entry)))

        found = run(
            [rows[number] for number in left],
            ledger.folder,
            cluster,
            on_change=show,
            control=control,
        )
    for number, entry in zip(left, found, strict=True):
        entries[number] = entry
    return entries, interrupt.status


def report_all(
    entries: Sequence[LedgerEntry],
    title: str,
    arguments: argparse.Namespace,
    seconds: float | None = None,
    status: int | None = None,
) -> int:
    """Write and print the summary, and return the exit status.

    Parameters
    ----------
    seconds : float, optional
        That solving took, if anything was to be solved.
    status : int, optional
        The exit status of a run that ended early; nothing is drawn after it.
    """
    rows, folder = list[SummaryRow](), Path(arguments.out)
    with row_progress(0, arguments.quiet, "reading") as report:
        for number, entry in enumerate(entries, 1):
            report(f"row {number} of {len(entries)}")
            rows.append(summary_row(entry))
    draws = status is None and not arguments.no_pictures

    def drawn(number: int, count: int) -> None:
        report(f"picture {number} of {count}")

    drawing = Drawing(drawn, arguments.up) if draws else None
    try:
        with row_progress(0, arguments.quiet or not draws, "drawing") as report:
            written, why = write_summary(folder, title, rows, drawing)
    except ResultError as error:
        if seconds is not None:
            raise
        print(f"note: no summary is written: {error}", file=sys.stderr)
        written, why = [], ""
    if why:
        print(f"note: the summary has no pictures: {why}", file=sys.stderr)
    best = best_of(rows)
    if arguments.json:
        head = {
            "out": str(folder),
            "counts": counts(rows),
            "seconds": seconds,
            "best": None if best is None else best.to_dict(),
            "summary": list(map(str, written)),
        }
        _print_json(head, rows)
    else:
        print("\n".join(_lines(rows, best, written, seconds)))
    return _status(rows) if status is None else status


def _print_json(head: dict[str, Any], rows: Sequence[SummaryRow]) -> None:
    """Print one JSON object: the head, and a list of rows that is in memory a row at a time."""
    print(json.dumps(head)[:-1], end=', "rows": [')
    for number, row in enumerate(rows):
        print(", " if number else "", json.dumps(row.to_dict()), sep="", end="")
    print("]}")


def _status(rows: Sequence[SummaryRow]) -> int:
    outcomes = counts(rows).keys()
    if outcomes & {Outcome.FAILED, Outcome.MISSING}:
        return FAILED_STATUS
    return 0 if all(outcome.is_good for outcome in outcomes) else UNMATCHED_STATUS


def _line(row: SummaryRow) -> str:
    """Return ``sub-01: matched to 2.1%, in 1.2 s``, or why the row failed."""
    name, facts = one_line(row.name, 80), row.facts
    if not row.is_known:
        return f"{name}: {facts.outcome}: {facts.reason}"
    seconds = row.entry.record.seconds
    took = "" if seconds is None else f", in {seconds:.1f} s"
    return f"{name}: {facts.headline}{took}"


def _lines(
    rows: Sequence[SummaryRow], best: Best | None, written: Sequence[Path], seconds: float | None
) -> list[str]:
    found = counts(rows)
    words = ", ".join(
        f"{count} {'not done' if outcome is Outcome.MISSING else outcome}"
        for outcome, count in found.items()
    )
    took = "" if seconds is None else f", in {seconds:.1f} s"
    lines = [f"{counted(len(rows), 'row')}: {words}{took}"]
    lines += [] if best is None else best.sentences()
    failed = [row for row in rows if row.facts.outcome is Outcome.FAILED or row.entry.reason]
    lines += [f"  {_line(row)}" for row in failed[:_FAILURES_MAX]]
    if len(failed) > _FAILURES_MAX:
        lines.append(f"  and {len(failed) - _FAILURES_MAX} more, see the summary")
    if found.get(Outcome.MISSING):
        lines.append(_how_to_resume(seconds is not None))
    if written:
        lines.append(f"wrote {', '.join(printable(path) for path in written)}")
    return lines


def _how_to_resume(was_run: bool) -> str:
    command = "the same command" if was_run else "the command without --status"
    return f"run {command} to resume, finished rows are kept"
