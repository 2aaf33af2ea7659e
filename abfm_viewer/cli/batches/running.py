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
from abfm.batch import Cluster, Entry, Ledger, Row, run
from abfm.batch.run import WAITS, LostError
from abfm.errors import one_line, printable
from abfm.wording import counted
from abfm_viewer import signals
from abfm_viewer.cli import options
from abfm_viewer.cli.batches.best import Best, best_of
from abfm_viewer.cli.batches.summary import GOOD, Told, counts, told_of, write_summary
from abfm_viewer.cli.exit_status import FAILED, UNMATCHED, UsageError
from abfm_viewer.cli.match import cancelled_by_signals
from abfm_viewer.cli.progress import row_progress

_MOST_TOLD = 8  # failed rows


def add_workers(parser: argparse.ArgumentParser) -> None:
    """Declare who solves."""
    add = options.adder(parser.add_argument_group("who solves"))
    what = "so many processes of this machine (default: one for each core)"
    add("--jobs", what, "N", type=options.processes)
    what = "a Dask cluster's scheduler instead, such as tcp://10.0.0.1:8786"
    add("--scheduler", what, "ADDRESS", type=options.address)
    add("--scheduler-file", "the same by the file in which it has its address", "FILE", type=Path)


def add_cluster(parser: argparse.ArgumentParser) -> None:
    """Declare who solves, where results go, and what is told."""
    add_workers(parser)
    add = options.adder(parser.add_argument_group("output"))
    about = "folder for results: made if it is not there"
    add("--out", about, "DIR", type=options.folder)
    add("--no-pictures", "a summary without pictures, which take a tenth of a second each")
    add("--json", "print one JSON object about all rows")
    add("--quiet", "no progress")


def cluster_of(arguments: argparse.Namespace) -> Cluster:
    given = arguments.jobs, arguments.scheduler, arguments.scheduler_file
    if sum(each is not None for each in given) > 1:
        raise UsageError("give one of --jobs, --scheduler and --scheduler-file, or none")
    return Cluster(*given)


def solve(rows: Sequence[Row], title: str, arguments: argparse.Namespace) -> int:
    """Solve what is missing, write the summary, tell it, and return the exit status."""
    began = time.perf_counter()
    try:
        entries, status = solved(rows, title, arguments.out, arguments)
    except LostError as error:
        print(f"abfm: {error}", file=sys.stderr)
        entries, status = Ledger(arguments.out).entries(rows), FAILED
    return tell_all(entries, title, arguments, time.perf_counter() - began, status)


def solved(
    rows: Sequence[Row], title: str, folder: Path, arguments: argparse.Namespace
) -> tuple[list[Entry], int | None]:
    """Solve what is missing in a folder, with progress; return what has come of all rows, and the
    exit status of a signal, if one came.
    """
    cluster, control, ledger = cluster_of(arguments), Control(), Ledger(folder)
    ledger.make()
    ledger.write_rows(rows, title)
    known = ledger.entries(rows)
    left = len({entry.row.key for entry in known if entry.state != "done"})
    there = sum(entry.state == "done" for entry in known)
    if there and not arguments.quiet:
        print(f"{there} of {counted(len(rows), 'row')} are there already", file=sys.stderr)
    with (
        cancelled_by_signals(control, "with the rows that are done") as kept,
        row_progress(left, arguments.quiet, waits=WAITS) as report,
    ):

        def tell(entry: Entry) -> None:
            report(_line(told_of([entry])[0]))

        entries = run(rows, ledger.folder, cluster, on_change=tell, control=control)
    return entries, signals.status(kept.number) if kept.number is not None else None


def tell_all(
    entries: Sequence[Entry],
    title: str,
    arguments: argparse.Namespace,
    seconds: float | None = None,
    status: int | None = None,
) -> int:
    """Write the summary and tell it; ``seconds`` are those of solving, if that was asked for, and
    ``status`` is that of a run which was broken off, after which nothing is drawn any more.
    """
    rows, folder = list[Told](), Path(arguments.out)
    with row_progress(0, arguments.quiet, "reading") as report:
        for number, entry in enumerate(entries, 1):
            report(f"row {number} of {len(entries)}")
            rows += told_of([entry])
    draws = status is None and not arguments.no_pictures

    def drawn(number: int, count: int) -> None:
        report(f"picture {number} of {count}")

    try:
        with row_progress(0, arguments.quiet or not draws, "drawing") as report:
            written, why = write_summary(folder, title, rows, draws, drawn)
    except ResultError as error:
        if seconds is not None:
            raise
        print(f"note: no summary is written: {error}", file=sys.stderr)
        written, why = [], ""
    if why:
        print(f"note: the summary has no pictures: {why}", file=sys.stderr)
    if status is None:
        status = _status(rows)
    best = best_of(rows)
    if arguments.json:
        told: dict[str, Any] = {
            "out": str(folder),
            "counts": counts(rows),
            "seconds": seconds,
            "best": None if best is None else best.to_dict(),
            "summary": list(map(str, written)),
            "rows": [row.to_dict() for row in rows],
        }
        print(json.dumps(told))
    else:
        print("\n".join(_lines(rows, best, written, seconds)))
    return status


def _status(rows: Sequence[Told]) -> int:
    verdicts = {row.verdict for row in rows}
    if verdicts & {"failed", "missing"}:
        return FAILED
    return 0 if verdicts <= set(GOOD) else UNMATCHED


def _line(row: Told) -> str:
    """``sub-01: matched, 0.021 left in 1.2 s``, or why it failed."""
    name = one_line(row.entry.row.name, 80)
    if row.facts is None:
        return f"{name}: {row.verdict}: {row.reason}"
    seconds = row.entry.record.seconds
    took = "" if seconds is None else f" in {seconds:.1f} s"
    return f"{name}: {row.verdict}, {row.facts.confirmed:.3f} left{took}"


def _lines(
    rows: Sequence[Told], best: Best | None, written: Sequence[Path], seconds: float | None
) -> list[str]:
    found = counts(rows)
    words = ", ".join(
        f"{count} {'not done' if verdict == 'missing' else verdict}"
        for verdict, count in found.items()
    )
    took = "" if seconds is None else f", in {seconds:.1f} s"
    lines = [f"{counted(len(rows), 'row')}: {words}{took}"]
    lines += [] if best is None else best.sentences()
    failed = [row for row in rows if row.verdict == "failed"]
    lines += [f"  {_line(row)}" for row in failed[:_MOST_TOLD]]
    if len(failed) > _MOST_TOLD:
        lines.append(f"  and {len(failed) - _MOST_TOLD} more, see the summary")
    if found.get("missing"):
        how = "the same again" if seconds is not None else "it without --status"
        lines.append(f"run {how} to go on: what is done is kept")
    if written:
        lines.append(f"wrote {', '.join(printable(path) for path in written)}")
    return lines
