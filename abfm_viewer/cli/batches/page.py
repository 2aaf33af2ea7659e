"""The page of a batch: a row a problem, the worst first, with nothing outside it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from html import escape
from importlib.metadata import version
from typing import TYPE_CHECKING

from abfm.wording import share
from abfm_viewer.cli.batches.best import Best, best_of
from abfm_viewer.cli.reports.report_page import document, facts_block, png, sentence

if TYPE_CHECKING:
    from abfm_viewer.cli.batches.summary import Told

_TONES = {"matched": "good", "registered": "good", "nearly": "ink", "missing": "muted"}
_STYLE = """
.counts dd { font-size: 1.5rem; color: var(--tone); }
.muted { --tone: var(--muted); }
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
    *("source, carried, target", "", "mismatch", "by flow lines", "folded", "|log2\u00a0J|"),
    "seconds",
)


def page(
    title: str,
    rows: Sequence[Told],
    counts: Mapping[str, int],
    pictures: Mapping[str, bytes],
    why_none: str,
) -> str:
    """Return the page of rows, in this order, with a picture (PNG) by digest where there is one."""
    shared = _shared(rows)
    kinds = Counter(row.entry.row.kind for row in rows)
    told = ", ".join(_counted(count, kind) for kind, count in kinds.items())
    about, best = f"{told}; those that came least far are first.", best_of(rows)
    parts = [
        f"<h1>Batch: {escape(title)}</h1>",
        f'<p class="muted">{escape(about)}</p>',
        _counts(counts),
        f'<ul class="warnings"><li>No pictures: {escape(why_none)}</li></ul>' if why_none else "",
        _options(shared),
        _best(best),
        _grid(rows, best),
        _table(rows, shared, pictures),
        f"<footer>abfm {escape(version('abfm'))}</footer>",
        facts_block({"title": title, "rows": [row.to_dict() for row in rows]}),
    ]
    return document(f"Batch: {title}", parts, _STYLE)


def _counted(number: int, kind: str) -> str:
    return f"{number:,} {kind}{'es' if kind.endswith('ch') else 's'}" if number > 1 else f"1 {kind}"


def _counts(counts: Mapping[str, int]) -> str:
    cells = (
        f'<div class="{_tone(verdict)}"><dt>{escape(_word(verdict))}</dt><dd>{count:,}</dd></div>'
        for verdict, count in counts.items()
    )
    return f'<dl class="counts">{"".join(cells)}</dl>'


def _tone(verdict: str) -> str:
    return _TONES.get(verdict, "bad")


def _word(verdict: str) -> str:
    return "not done yet" if verdict == "missing" else verdict


def _shared(rows: Sequence[Told]) -> list[tuple[str, str]]:
    """Return the options that are the same in all rows."""
    if len(rows) < 2:
        return []
    every = [row.entry.row.options for row in rows]
    return [pair for pair in every[0] if all(pair in options for options in every)]


def _options(shared: Sequence[tuple[str, str]]) -> str:
    if not shared:
        return ""
    lines = "".join(
        f"<tr><td>{escape(column)}</td><td>{escape(text)}</td></tr>" for column, text in shared
    )
    return f'<h2>Of all rows</h2><table class="words wrapped">{lines}</table>'


def _best(best: Best | None) -> str:
    """Say which of several ways to solve one problem is best, and by what."""
    if best is None:
        return ""
    lines = "".join(f"<li>{sentence(each)}.</li>" for each in best.sentences())
    return f"<h2>Best</h2><ul>{lines}</ul>"


def _grid(rows: Sequence[Told], best: Best | None) -> str:
    """Return what came of all combinations of two options at a glance; nothing where the rows are
    not that.
    """
    every = [dict(row.entry.row.options) for row in rows]
    varied = [name for name in every[0] if len({each.get(name) for each in every}) > 1]
    if len(varied) != 2:
        return ""
    down, across = varied
    found = {(o.get(down, ""), o.get(across, "")): row for o, row in zip(every, rows, strict=True)}
    downs, acrosses = (sorted({pair[i] for pair in found}, key=_by_size) for i in range(2))
    if len(found) < len(rows) or len(found) < len(downs) * len(acrosses):
        return ""
    head = "".join(f"<th>{escape(across)} {escape(text)}</th>" for text in acrosses)
    lines = "".join(
        f"<tr><th>{escape(down)} {escape(one)}</th>"
        + "".join(_glance(found[one, other], best) for other in acrosses)
        + "</tr>"
        for one in downs
    )
    text = "What is left by the worse witness, and the mean |log2 J| of the map."
    if best is not None and best.unbeaten:
        text += " Framed is what no other combination beats in both."
    return (
        f"<h2>At a glance</h2><p>{text}</p>"
        f'<table class="grid"><thead><tr><th></th>{head}</tr></thead><tbody>{lines}</tbody></table>'
    )


def _by_size(text: str) -> tuple[float, str]:
    try:
        return float(text), ""
    except ValueError:
        return float("inf"), text


def _glance(row: Told, best: Best | None) -> str:
    facts, tone = row.facts, _tone(row.verdict)
    if facts is None:
        return f'<td class="word {tone}">{escape(_word(row.verdict))}</td>'
    areas = f"{facts.log2_area:.2f}" if facts.log2_area == facts.log2_area else "-"
    left = f"{100 * facts.confirmed:.2g}%"
    told = f'<span class="word {tone}">{left}</span> {areas}'
    is_framed = best is not None and row.entry.row.name in best.unbeaten
    return f'<td><span class="framed">{told}</span></td>' if is_framed else f"<td>{told}</td>"


def _table(
    rows: Sequence[Told], shared: Sequence[tuple[str, str]], pictures: Mapping[str, bytes]
) -> str:
    of_pictures = {_PICTURES.get(row.entry.row.kind, _HEADS[0]) for row in rows}
    heads = ("; ".join(sorted(of_pictures, reverse=True)), *_HEADS[1:])
    head = "".join(f"<th>{escape(each)}</th>" for each in heads)
    lines = "\n".join(_line(row, shared, pictures) for row in rows)
    return (
        f'<h2>Rows</h2><table class="rows"><thead><tr>{head}</tr></thead>'
        f"<tbody>{lines}</tbody></table>"
    )


def _line(row: Told, shared: Sequence[tuple[str, str]], pictures: Mapping[str, bytes]) -> str:
    entry, facts = row.entry, row.facts
    small = pictures.get(entry.digest)
    drawn = (
        png(small, f"{entry.row.name}: {_PICTURES.get(entry.row.kind, _HEADS[0])}")
        if small and facts
        else '<div class="none">no picture</div>'
    )
    own = [f"{column} {text}" for column, text in entry.row.options if (column, text) not in shared]
    told = " ".join(f"<span>{escape(each)}</span>" for each in own)
    options = "" if ", ".join(own) == entry.row.name else f'<div class="options">{told}</div>'
    reason = f'<div class="reason">{sentence(row.reason)}</div>' if row.reason else ""
    left = "" if facts is None else f" to {share(facts.confirmed)}"
    if row.verdict != "matched":
        left = left and f": {share(facts.confirmed)} left" if facts else ""
    words = (
        f'<div class="name">{escape(entry.row.name)}</div>'
        f'<div class="word {_tone(row.verdict)}">{sentence(_word(row.verdict))}{left}</div>'
        f"{reason}{options}"
    )
    numbers = ("-", "-", "-", "-")
    if facts is not None:
        both = _number(facts.residual), _number(facts.verified_residual)
        numbers = (*both, _folded(facts.folded), _number(facts.log2_area))
    seconds = "-" if entry.record.seconds is None else f"{entry.record.seconds:.1f}"
    cells = "".join(
        f'<td data-of="{of}">{each}</td>'
        for of, each in zip(_HEADS, (drawn, words, *numbers, seconds), strict=True)
    )
    return f"<tr>{cells}</tr>"


def _number(value: float) -> str:
    return f"{value:.3f}" if value == value else "-"


def _folded(value: float) -> str:
    return f"{100 * value:.2g}%" if value == value else "-"
