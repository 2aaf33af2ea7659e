"""What is told of a batch: a table for machines, and a page for people."""

from __future__ import annotations

import csv
import io
import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from abfm import AbfmError, ResultError
from abfm.batch import Entry, Facts
from abfm.errors import one_line
from abfm.io import write_atomically
from abfm_viewer import pictures
from abfm_viewer.cli.batches.page import page
from abfm_viewer.document.result_table import WORST_FIRST as WORST_FIRST

GOOD = ("nearly", "registered", "matched")
"""As the exit status has it."""
_PICTURES = "pictures"
_COLORS = 64  # of small pictures
_MOST_PICTURES = 1000  # on a page, which has 5 MB then


@dataclass(frozen=True)
class Told:
    """A row of the summary."""

    entry: Entry
    facts: Facts | None
    verdict: str  # one of `WORST_FIRST`
    reason: str  # why it failed, or what the verdict says

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain numbers and texts, None for what is not known."""
        entry, facts = self.entry, self.facts
        numbers = ("mismatch", "verified_residual", "folded", "log2_area")
        return {
            "name": entry.row.name,
            "digest": entry.digest or None,
            "verdict": self.verdict,
            **{name: None if facts is None else _known(getattr(facts, name)) for name in numbers},
            "seconds": entry.record.seconds,
            "reason": self.reason or None,
            "file": None if entry.path is None else entry.path.name,
        }


def told_of(entries: Sequence[Entry]) -> list[Told]:
    """Return what is told of rows, in their order; of a result that cannot be read, that."""
    found = []
    for entry in entries:
        if entry.path is None:
            found.append(Told(entry, None, entry.state, entry.reason))
            continue
        try:
            facts = entry.facts
        except ResultError as error:
            found.append(Told(entry, None, "failed", str(error)))
        else:
            assert facts is not None
            found.append(Told(entry, facts, facts.verdict, facts.reason))
    return found


def counts(rows: Sequence[Told]) -> dict[str, int]:
    """Return how many rows came to what, the best first."""
    found = Counter(row.verdict for row in rows)
    return {verdict: found[verdict] for verdict in reversed(WORST_FIRST) if found[verdict]}


def write_summary(
    folder: Path,
    title: str,
    rows: Sequence[Told],
    draws: bool = True,
    report: Callable[[int, int], object] = lambda done, count: None,
) -> tuple[list[Path], str]:
    """Write ``summary.csv``, in the order of the rows, and ``summary.html``, the worst first;
    return them, and why there are no pictures, if there are none.

    Pictures, of the worst thousand, are kept in a folder of their own: what is drawn once is not
    drawn again.
    """
    table, told = folder / "summary.csv", folder / "summary.html"
    with write_atomically(table) as temporary:
        temporary.write_text(_csv(rows), encoding="utf-8", newline="")
    order = {verdict: number for number, verdict in enumerate(WORST_FIRST)}
    sorted_rows = sorted(rows, key=lambda row: (order[row.verdict], -_left(row)))
    shown = [row for row in sorted_rows if row.facts is not None][:_MOST_PICTURES]
    why = _draw(folder, shown, report) if draws else ""
    small = {
        row.entry.digest: path.read_bytes()
        for row in shown
        if (path := _picture(folder, row.entry.digest)).is_file()
    }
    with write_atomically(told) as temporary:
        temporary.write_text(page(title, sorted_rows, counts(rows), small, why), encoding="utf-8")
    return [table, told], why


def _left(row: Told) -> float:
    return row.facts.confirmed if row.facts is not None else 0.0


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value


def _csv(rows: Sequence[Told]) -> str:
    """Return the table: what is told of each row, and all its columns as they were given."""
    most: Counter[str] = Counter()
    for row in rows:
        most |= Counter(column for column, _ in row.entry.row.options)
    columns = [column for column, count in most.items() for _ in range(count)]
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    own = [key for key in Told.to_dict(rows[0]) if key != "file"] if rows else []
    writer.writerow([*own, *columns])
    for row in rows:
        left = list(row.entry.row.options)
        cells = []
        for column in columns:
            pair = next((pair for pair in left if pair[0] == column), None)
            cells.append("" if pair is None else pair[1])
            if pair is not None:
                left.remove(pair)
        told = row.to_dict()
        writer.writerow([*("" if told[key] is None else told[key] for key in own), *cells])
    return text.getvalue()


def _picture(folder: Path, digest: str) -> Path:
    return folder / _PICTURES / f"{digest}.png"


def _draw(folder: Path, rows: Sequence[Told], report: Callable[[int, int], object]) -> str:
    """Draw what is not drawn; return why not, where the machine cannot."""
    paths = {row.entry.path: row.entry.digest for row in rows if row.entry.path}
    left = [path for path, digest in paths.items() if not _picture(folder, digest).is_file()]
    if not left:
        return ""
    try:
        (folder / _PICTURES).mkdir(exist_ok=True)
        for number, (path, drawn) in enumerate(pictures.row_pictures(left), 1):
            report(number, len(left))
            if not isinstance(drawn, AbfmError):
                with write_atomically(_picture(folder, paths[path])) as temporary:
                    drawn.quantize(_COLORS).save(temporary, "PNG", optimize=True)
    except (AbfmError, OSError) as error:
        return one_line(error, 300)
    return ""
