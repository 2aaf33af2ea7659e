"""The page of a batch in one file: the worst rows first, and counts of all."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from abfm.batch.kinds import KINDS
from abfm_viewer.cli.batches.best import best_of
from abfm_viewer.cli.batches.rows import SummaryRow, counts, worst
from abfm_viewer.reports.pages import cut, render

_HEADS = ("", "residual", "by flow lines", "folded", "|log2\u00a0J|", "seconds")


class Grid(NamedTuple):
    """Rows by the values of two options."""

    across: list[str]
    down: list[tuple[str, list[SummaryRow]]]


def page(
    title: str,
    rows: Sequence[SummaryRow],
    pictures: Mapping[str, bytes],
    why_none: str,
) -> str:
    """Return the page of rows, the worst of them first and with a picture (PNG) by digest if there
    is one.

    Its size is bounded: it shows at most `ROWS_SHOWN_MAX` rows, and refers to the table for all.
    """
    shown = worst(rows)
    kinds = Counter(row.entry.row.kind for row in rows)
    labels = {kind: ", ".join(KINDS[kind].preview_labels) for kind in kinds}
    heads = sorted({labels[row.entry.row.kind] for row in shown}, reverse=True)
    return render(
        "batch.html",
        batch=title,
        sizes=[_counted(count, kind) for kind, count in kinds.items()],
        counts=counts(rows),
        no_pictures=why_none,
        shared=_shared(rows),
        best=best_of(rows),
        grid=_grid(rows) if len(shown) == len(rows) else None,
        heads=("; ".join(heads), *_HEADS),
        labels=labels,
        rows=shown,
        count=len(rows),
        pictures=pictures,
        facts={"title": title, "count": len(rows), "rows": list(map(_facts, shown))},
    )


def _counted(number: int, kind: str) -> str:
    return f"{number:,} {kind}{'es' if kind.endswith('ch') else 's'}" if number > 1 else f"1 {kind}"


def _facts(row: SummaryRow) -> dict[str, object]:
    found = row.to_dict()
    return {key: cut(value) if isinstance(value, str) else value for key, value in found.items()}


def _shared(rows: Sequence[SummaryRow]) -> list[tuple[str, str]]:
    """Return the options that are the same in all rows."""
    if len(rows) < 2:
        return []
    found = dict.fromkeys(rows[0].entry.row.options)
    for row in rows:
        found = {pair: None for pair in found if pair in row.entry.row.options}
        if not found:
            break
    return list(found)


def _grid(rows: Sequence[SummaryRow]) -> Grid | None:
    """Return a grid of all combinations of two options; None if the rows are anything else."""
    every = [dict(row.entry.row.options) for row in rows]
    varied = [name for name in every[0] if len({each.get(name) for each in every}) > 1]
    if len(varied) != 2:
        return None
    down, across = varied
    found = {(o.get(down, ""), o.get(across, "")): row for o, row in zip(every, rows, strict=True)}
    downs, acrosses = (sorted({pair[i] for pair in found}, key=_by_size) for i in range(2))
    if len(found) < len(rows) or len(found) < len(downs) * len(acrosses):
        return None
    return Grid(
        [f"{across} {text}" for text in acrosses],
        [(f"{down} {one}", [found[one, other] for other in acrosses]) for one in downs],
    )


def _by_size(text: str) -> tuple[float, str]:
    try:
        return float(text), ""
    except ValueError:
        return float("inf"), text
