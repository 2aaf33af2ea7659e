"""The files of a summary: a table of all rows for programs, and a page of the worst for people."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from abfm import AbfmError
from abfm.errors import one_line
from abfm.io import write_atomically, write_csv
from abfm.io.sheets import Up
from abfm_viewer import pictures
from abfm_viewer.cli.batches.page import page
from abfm_viewer.cli.batches.rows import SummaryRow, worst
from abfm_viewer.files.outputs import write_text

_PICTURES = "pictures"
_COLORS = 64  # of small pictures


class Drawing(NamedTuple):
    """What is called with the number of each picture, and the axis that points upwards."""

    report: Callable[[int, int], object] = lambda done, count: None
    up: Up | None = None


def write_summary(
    folder: Path,
    title: str,
    rows: Sequence[SummaryRow],
    drawing: Drawing | None = None,
) -> tuple[list[Path], str]:
    """Write ``summary.csv``, in the order of the rows, and ``summary.html``, the worst first;
    return them, and why there are no pictures, if there are none.

    The page shows and draws the rows of `worst`. Pictures are kept in a folder of their own, so
    that each is drawn once.
    """
    table, shown_page = folder / "summary.csv", folder / "summary.html"
    _write_table(table, rows)
    shown = [row for row in worst(rows) if row.is_known]
    up = drawing.up if drawing else None
    why = _draw(folder, shown, drawing) if drawing else ""
    small = {
        row.entry.digest: path.read_bytes()
        for row in shown
        if (path := _picture(folder, row.entry.digest, up)).is_file()
    }
    write_text(shown_page, page(title, rows, small, why))
    return [table, shown_page], why


def _write_table(path: Path, rows: Sequence[SummaryRow]) -> None:
    """Write a line for each row: its facts, and all its columns as they were given."""
    repeats: Counter[str] = Counter()
    for row in rows:
        repeats |= Counter(column for column, _ in row.entry.row.options)
    columns = list(repeats.elements())
    own = [key for key in rows[0].to_dict() if key != "file"] if rows else []
    write_csv(path, [[*own, *columns], *(_cells(row, own, columns) for row in rows)])


def _cells(row: SummaryRow, own: Sequence[str], columns: Sequence[str]) -> list[object]:
    given = defaultdict[str, list[str]](list)
    for column, text in reversed(row.entry.row.options):
        given[column].append(text)
    facts = row.to_dict()
    return [
        *(facts[key] for key in own),
        *(given[column].pop() if given[column] else "" for column in columns),
    ]


def _picture(folder: Path, digest: str, up: Up | None) -> Path:
    return folder / _PICTURES / f"{digest}{f'-{up}' if up else ''}.png"


def _draw(
    folder: Path,
    rows: Sequence[SummaryRow],
    drawing: Drawing,
) -> str:
    """Draw the pictures that are missing; return why not, if the machine cannot."""
    entries = {row.entry.path: row.entry for row in rows if row.entry.path}
    files = {path: _picture(folder, entry.digest, drawing.up) for path, entry in entries.items()}
    missing = [(path, entries[path].row.declared) for path in files if not files[path].is_file()]
    if not missing:
        return ""
    try:
        (folder / _PICTURES).mkdir(exist_ok=True)
        for number, (path, drawn) in enumerate(pictures.row_pictures(missing, drawing.up), 1):
            drawing.report(number, len(missing))
            if not isinstance(drawn, AbfmError):
                with write_atomically(files[path]) as temporary:
                    drawn.quantize(_COLORS).save(temporary, "PNG", optimize=True)
    except (AbfmError, OSError) as error:
        return one_line(error, 300)
    return ""
