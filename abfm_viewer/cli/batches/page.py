"""The page of a batch in one file: the worst rows first, and counts of all."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from html import escape
from importlib.metadata import version

from abfm.errors import one_line
from abfm.outcome import Outcome
from abfm.wording import number_text, percents
from abfm_viewer.cli.batches.best import Best, best_of
from abfm_viewer.cli.batches.rows import ROWS_SHOWN_MAX, SummaryRow, counts, worst
from abfm_viewer.cli.reports.report_page import (
    document,
    facts_block,
    numbers_list,
    png,
    sentence,
    table,
)

_TEXT_LENGTH_MAX = 400  # characters of a name, an option or a reason
_STYLE = """
.counts dd { font-size: 1.5rem; color: var(--tone); }
table.rows { width: 100%; }
table.rows td, table.rows th { padding: .45rem 0 .45rem 1.1rem; vertical-align: middle;
  white-space: nowrap; }
table.rows td:first-child, table.rows th:first-child { padding-left: 0; width: 19.5rem; }
table.rows td:first-child img { display: block; width: 18.6rem; }
table.rows td:nth-child(2), table.rows th:nth-child(2) { text-align: left; white-space: normal;
  width: 99%; }
table.rows thead th { background: #fff; position: sticky; top: 0; vertical-align: bottom; }
.name { font-weight: 600; overflow-wrap: anywhere; }
.word { color: var(--tone); font-weight: 600; }
.reason { color: var(--ink); font-size: .87rem; overflow-wrap: anywhere; }
.options { color: var(--muted); font-size: .8rem; overflow-wrap: anywhere; }
.options span { display: inline-block; margin-right: .9em; }
.none { color: var(--muted); font-size: .85rem; text-align: center; background: var(--panel);
  border-radius: 6px; padding: 1.3rem 0; }
table.grid th, table.grid td { padding: .35rem 0 .35rem 1.6rem; text-align: right; }
table.grid th:first-child { padding-left: 0; text-align: left; }
.framed { outline: 1px solid var(--muted); outline-offset: 4px; border-radius: 3px; }
.wrapped td { overflow-wrap: anywhere; }
@media print { table.rows thead th { position: static; } }
@media (max-width: 40rem) {
  table.rows, table.rows tbody, table.rows tr, table.rows td { display: block; border: 0; }
  table.rows thead { display: none; }
  table.rows tr { border-bottom: 1px solid var(--line); padding: .7rem 0; }
  table.rows td:nth-child(n) { padding: 0; width: auto; white-space: normal; text-align: left; }
  table.rows td:first-child img { width: 100%; max-width: 18.6rem; }
  table.rows td:nth-child(n + 3) { display: inline-block; margin-right: 1.1rem; font-size: .87rem; }
  table.rows td:nth-child(n + 3)::before { content: attr(data-of) " "; color: var(--muted); }
}
"""
_PICTURES = {"sequence": "first, middle, last frame"}
_HEADS = (
    *("source, carried, target", "", "residual", "by flow lines", "folded", "|log2\u00a0J|"),
    "seconds",
)


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
    shown, shared, best = worst(rows), _shared(rows), best_of(rows)
    kinds = Counter(row.entry.row.kind for row in rows)
    sizes = ", ".join(_counted(count, kind) for kind, count in kinds.items())
    about = f"{sizes}; the worst are first."
    parts = [
        f"<h1>Batch: {escape(title)}</h1>",
        f'<p class="muted">{escape(about)}</p>',
        _counts(counts(rows)),
        f'<ul class="warnings"><li>No pictures: {escape(why_none)}</li></ul>' if why_none else "",
        _options(shared),
        _best(best),
        _grid(rows, best) if len(shown) == len(rows) else "",
        _table(shown, len(rows), shared, pictures),
        f"<footer>abfm {escape(version('abfm'))}</footer>",
        facts_block({"title": title, "count": len(rows), "rows": list(map(_told, shown))}),
    ]
    return document(f"Batch: {title}", parts, _STYLE)


def _counted(number: int, kind: str) -> str:
    return f"{number:,} {kind}{'es' if kind.endswith('ch') else 's'}" if number > 1 else f"1 {kind}"


def _told(row: SummaryRow) -> dict[str, object]:
    found = row.to_dict()
    return {key: _cut(value) if isinstance(value, str) else value for key, value in found.items()}


def _cut(text: str) -> str:
    return one_line(text, _TEXT_LENGTH_MAX)


def _counts(counts: Mapping[Outcome, int]) -> str:
    cells = ((_word(each), f"{count:,}", each.tone) for each, count in counts.items())
    return f'<div class="counts">{numbers_list(cells)}</div>'


def _word(outcome: Outcome) -> str:
    return "not done yet" if outcome is Outcome.MISSING else str(outcome)


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


def _options(shared: Sequence[tuple[str, str]]) -> str:
    if not shared:
        return ""
    lines = "".join(
        f"<tr><td>{escape(column)}</td><td>{escape(_cut(text))}</td></tr>"
        for column, text in shared
    )
    return f'<h2>Of all rows</h2><table class="words wrapped">{lines}</table>'


def _best(best: Best | None) -> str:
    """Return which of several methods to solve one problem is best, and by what."""
    if best is None:
        return ""
    lines = "".join(f"<li>{sentence(each)}.</li>" for each in best.sentences())
    return f"<h2>Best</h2><ul>{lines}</ul>"


def _grid(rows: Sequence[SummaryRow], best: Best | None) -> str:
    """Return a table of all combinations of two options; empty if the rows are anything else."""
    every = [dict(row.entry.row.options) for row in rows]
    varied = [name for name in every[0] if len({each.get(name) for each in every}) > 1]
    if len(varied) != 2:
        return ""
    down, across = varied
    found = {(o.get(down, ""), o.get(across, "")): row for o, row in zip(every, rows, strict=True)}
    downs, acrosses = (sorted({pair[i] for pair in found}, key=_by_size) for i in range(2))
    if len(found) < len(rows) or len(found) < len(downs) * len(acrosses):
        return ""
    lines = (
        f"<tr><th>{escape(down)} {escape(one)}</th>"
        + "".join(_glance(found[one, other], best) for other in acrosses)
        + "</tr>"
        for one in downs
    )
    heads = ["", *(f"{across} {text}" for text in acrosses)]
    text = "The larger residual of both checks, and the mean |log2 J| of the map."
    if best is not None and best.unbeaten:
        text += " A frame marks combinations that no other beats in both."
    return f"<h2>At a glance</h2><p>{text}</p>{table(heads, lines, 'grid')}"


def _by_size(text: str) -> tuple[float, str]:
    try:
        return float(text), ""
    except ValueError:
        return float("inf"), text


def _glance(row: SummaryRow, best: Best | None) -> str:
    facts = row.facts
    if not row.is_known:
        return f'<td class="word {facts.tone}">{escape(_word(facts.outcome))}</td>'
    areas = number_text(facts.number("log2_area"), ".2f")
    residual = f"{100 * facts.worse_residual:.2g}%"
    cell = f'<span class="word {facts.tone}">{residual}</span> {areas}'
    is_framed = best is not None and row.name in best.unbeaten
    return f'<td><span class="framed">{cell}</span></td>' if is_framed else f"<td>{cell}</td>"


def _table(
    rows: Sequence[SummaryRow],
    count: int,
    shared: Sequence[tuple[str, str]],
    pictures: Mapping[str, bytes],
) -> str:
    of_pictures = {_PICTURES.get(row.entry.row.kind, _HEADS[0]) for row in rows}
    heads = ("; ".join(sorted(of_pictures, reverse=True)), *_HEADS[1:])
    lines = (f"{_line(row, shared, pictures)}\n" for row in rows)
    rest = (
        f"<p>The worst {ROWS_SHOWN_MAX:,} of {count:,} rows are shown; "
        '<a href="summary.csv">summary.csv</a> has all of them.</p>'
    )
    return f"<h2>Rows</h2>{rest if count > len(rows) else ''}{table(heads, lines, 'rows')}"


def _line(row: SummaryRow, shared: Sequence[tuple[str, str]], pictures: Mapping[str, bytes]) -> str:
    entry, facts, name = row.entry, row.facts, _cut(row.name)
    small = pictures.get(entry.digest)
    drawn = (
        png(small, f"{name}: {_PICTURES.get(entry.row.kind, _HEADS[0])}")
        if small and row.is_known
        else '<div class="none">no picture</div>'
    )
    own = [
        f"{column} {_cut(text)}"
        for column, text in entry.row.options
        if (column, text) not in shared
    ]
    spans = " ".join(f"<span>{escape(each)}</span>" for each in own)
    options = "" if ", ".join(own) == name else f'<div class="options">{spans}</div>'
    reason = f'<div class="reason">{sentence(_cut(facts.reason))}</div>' if facts.reason else ""
    warnings = (f'<div class="reason">Warning: {escape(each)}</div>' for each in facts.warnings)
    headline = facts.headline if row.is_known else _word(facts.outcome)
    words = (
        f'<div class="name">{escape(name)}</div>'
        f'<div class="word {facts.tone}">{sentence(headline)}</div>'
        f"{''.join(warnings)}{reason}{options}"
    )
    numbers = [
        number_text(facts.number("residual")),
        number_text(facts.number("verified_residual")),
        percents(facts.number("folded")),
        number_text(facts.number("log2_area")),
        number_text(entry.record.seconds, ".1f"),
    ]
    cells = "".join(
        f'<td data-of="{of}">{each}</td>'
        for of, each in zip(_HEADS, (drawn, words, *numbers), strict=True)
    )
    return f"<tr>{cells}</tr>"
