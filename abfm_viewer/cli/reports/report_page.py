"""The page of `abfm report`: HTML of facts and pictures, with nothing outside it."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

from abfm.pages.page import in_script
from abfm.parameters import FIELDS
from abfm.wording import share
from abfm_viewer.cli.results import SCORE, STEP_HEADS, has_scores, number_text, percents, step_cells
from abfm_viewer.document.verdict_words import plain

if TYPE_CHECKING:
    from PIL import Image

    from abfm_viewer.pictures.registration_pictures import Bar, RegistrationPictures, Row

Facts = Mapping[str, Any]

LEAST_COVERED = 0.98
"""The share of A that is covered below which a report warns."""
MOST_APART = 0.1
"""Edges from the start, that 5% of the vertices may come back without a warning."""
_COLORS = 256  # of pictures: a third of the bytes, and no eye sees it
_COLUMN, _TALL = 14.6, 1.4  # width of pictures in rem, less of those more than this times as high
_STYLE = """
:root { --ink: #1d222b; --muted: #5d6675; --line: #d9dde4; --good: #12633a; --bad: #b3261e;
  --panel: #f5f6f8; color-scheme: light; }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 76rem; padding: 2rem 1.5rem 3rem; color: var(--ink);
  background: #fff; print-color-adjust: exact; -webkit-print-color-adjust: exact;
  font: 15px/1.45 system-ui, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0; overflow-wrap: anywhere; }
h2 { font-size: 1.15rem; margin: 2.2rem 0 .5rem; padding-bottom: .25rem;
  border-bottom: 1px solid var(--line); }
h3 { font-size: 1rem; margin: 1.2rem 0 .3rem; }
p { margin: .3rem 0; max-width: 58rem; }
.muted, figcaption, dt { color: var(--muted); }
.verdict { margin: 1.2rem 0 .8rem; padding: .8rem 1.1rem; background: var(--panel);
  border-left: .5rem solid var(--tone); }
.verdict strong { display: block; color: var(--tone); font-size: 1.9rem; line-height: 1.25; }
.good { --tone: var(--good); } .ink { --tone: var(--ink); }
.warning { --tone: #8a5300; } .failure { --tone: var(--bad); } .muted { --tone: var(--muted); }
ul { margin: .5rem 0; padding-left: 1.2rem; } .warnings { color: var(--bad); font-weight: 600; }
dl { display: grid; grid-template-columns: repeat(auto-fill, minmax(10.5rem, 1fr)); gap: .6rem;
  margin: .8rem 0; }
dl div { border: 1px solid var(--line); border-radius: 6px; padding: .45rem .7rem; }
dt { font-size: .8rem; }
dd { margin: 0; font-size: 1.15rem; font-weight: 600; white-space: nowrap; }
dd.bad { color: var(--bad); }
.row { display: grid; gap: .3rem .8rem; align-items: end;
  grid-template-columns: repeat(var(--columns), minmax(0, 1fr)); }
figure { margin: 0; break-inside: avoid; } figcaption { text-align: center; font-weight: 600; }
figure img { display: block; width: 100%; }
.bars { display: flex; flex-wrap: wrap; gap: .3rem 2.5rem; margin: .5rem 0;
  font-variant-numeric: tabular-nums; }
.bars span { display: flex; align-items: center; gap: .5rem; }
.bars img { width: 11rem; height: .8rem; border: 1px solid var(--line); }
.half { display: grid; grid-template-columns: repeat(2, minmax(0, 1fr));
  gap: 1rem 2rem; align-items: start; }
th[colspan] { text-align: center; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; margin: .5rem 0; }
th, td { text-align: right; padding: .2rem 0 .2rem 1.1rem; border-bottom: 1px solid var(--line);
  vertical-align: top; }
th:first-child, td:first-child, .words td { text-align: left; padding-left: 0; }
.numbers th, .numbers td { white-space: nowrap; }
.words td + td, .words th + th { text-align: left; padding-left: 1.3rem; }
th { font-weight: 600; } tr.chosen { background: #eaf0fc; font-weight: 600; }
footer { margin-top: 2.5rem; color: var(--muted); font-size: .85rem; }
@page { size: A4; margin: 12mm; }
@media print { body { max-width: none; padding: 0; font-size: 10pt; }
  dl { grid-template-columns: repeat(6, 1fr); gap: .3rem; } dl div { padding: .3rem .4rem; }
  dt { font-size: 7pt; } dd { font-size: 10pt; } table { font-size: 8pt; }
  th, td { padding-left: .7rem; }
  section, .verdict, tr, .bars { break-inside: avoid; } h2, h3 { break-after: avoid; } }
@media (max-width: 40rem) { body { padding: 1rem .9rem 2rem; } dd { white-space: normal; }
  .half { grid-template-columns: minmax(0, 1fr); } table { display: block; overflow-x: auto; }
  .row { grid-template-columns: repeat(auto-fill, minmax(7rem, 1fr)); } }
"""
_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"


def page(facts: Facts, pictures: RegistrationPictures) -> str:
    """Return the page of facts, with pictures."""
    title = escape(facts["title"])
    is_registration = "verdict" in facts
    parts = [
        f"<h1>{title}</h1>",
        f'<p class="muted">{escape(_about(facts))}</p>',
        _verdict(facts),
        _warnings(facts["warnings"]),
        _list(facts.get("notes", ()), ""),
        _numbers(facts),
        _functions(facts, pictures.functions),
        _map(facts, pictures.map),
        _distortion(facts, *pictures.histograms),
        *([_path(facts, pictures.path), _parameters(facts)] if is_registration else []),
        f"<footer>abfm {escape(facts['abfm'])}, of {escape(facts['file'])}</footer>",
    ]
    return document(facts["title"], [*parts, facts_block(facts)])


def facts_block(facts: object) -> str:
    """Write facts as JSON that no HTML parser takes for a tag."""
    return f'<script type="application/json" id="facts">{in_script(facts)}</script>'


def _about(facts: Facts) -> str:
    if not _has_two(facts):
        return f"A match on a surface of {_sized(facts['b'])}"
    kind = "Registration" if "verdict" in facts else "Map"
    return f"{kind} of surface A, {_sized(facts['a'])}, to surface B, {_sized(facts['b'])}"


def _has_two(facts: Facts) -> bool:
    """Tell whether A is another surface than B."""
    return "initial_map" in facts or "verdict" not in facts


def _sized(surface: Facts) -> str:
    return f"{surface['vertices']:,} vertices and {surface['faces']:,} faces"


def _verdict(facts: Facts) -> str:
    headline = sentence(facts["headline"])
    if "verdict" not in facts:
        return f'<div class="verdict ink"><strong>{headline}</strong></div>'
    reason = f"<p>{sentence(facts['why'])}.</p>"
    advice = f"<p><b>Advice:</b> {escape(facts['advice'])}.</p>" if facts["advice"] else ""
    return f'<div class="verdict {facts["tone"]}"><strong>{headline}</strong>{reason}{advice}</div>'


def sentence(text: str) -> str:
    """Write a text with a capital first letter."""
    return escape(text[:1].upper() + text[1:])


def _warnings(warnings: Sequence[str]) -> str:
    if not warnings:
        return ""
    return _list((f"Warning: {warning}" for warning in warnings), "warnings")


def _list(lines: Iterable[str], kind: str) -> str:
    items = "".join(f"<li>{sentence(line)}.</li>" for line in lines)
    return f'<ul class="{kind or "notes"}">{items}</ul>' if items else ""


def _numbers(facts: Facts) -> str:
    """Write the few numbers that one looks at first, those that are warned of in red."""
    of_map = facts["map"]
    cells = []
    if "verdict" in facts:
        ends = (facts["initial_residual"], facts["worse_residual"])
        before, after = ("unknown" if end is None else share(end) for end in ends)
        cells.append(("residual", f"{before} → {after}", False))
    if marks := facts.get("landmarks"):
        farthest = ("farthest landmark", f"{share(marks['farthest'])} of √area", False)
        cells = [farthest] if marks["alone"] else [*cells, farthest]
    cells += [
        ("areas: |log2 J|, 95%", f"{of_map['log2_area']['p95']:.2f}", False),
        ("shapes: |log2 R|, 95%", f"{of_map['log2_shape']['p95']:.2f}", False),
        ("folded faces", f"{of_map['folded']:,}", of_map["folded"] > 0),
        (
            "A covered" if _has_two(facts) else "covered",
            percents(of_map["coverage"], ".3g"),
            of_map["coverage"] < LEAST_COVERED,
        ),
        (
            "there and back, 95%",
            f"{_edges(of_map['there_and_back']['p95'])} edges",
            of_map["there_and_back"]["p95"] > MOST_APART,
        ),
    ]
    return numbers_list(
        (name, value, "bad" if is_bad else "plain") for name, value, is_bad in cells
    )


def numbers_list(cells: Iterable[tuple[str, str, str]]) -> str:
    """Write numbers in boxes, by their names, each of a class."""
    items = (
        f'<div><dt>{escape(name)}</dt><dd class="{kind}">{escape(value)}</dd></div>'
        for name, value, kind in cells
    )
    return f"<dl>{''.join(items)}</dl>"


def _functions(facts: Facts, rows: Sequence[Row]) -> str:
    if not rows:
        return ""
    text = "From the front, and below from behind."
    if _has_two(facts):
        text = (
            "A with its function, which the file keeps as the initial map brought it to B; that "
            "function on B, by the initial map and by the registration; B with its own; and what "
            "is left between them, where it counts; from the front, and below from behind. "
            "Measured functions are in standard deviations, as compared."
        )
    specs = facts["functions"]
    if len(rows) < len(specs):
        text += f" These are the first {len(rows)} of {len(specs)} pairs of functions."
    parts = []
    for row, (source, target) in zip(rows, specs, strict=False):
        named = f": {source} → {target}" if source and target else ""
        is_needed = len(rows) > 1 or named
        heading = f"<h3>{sentence(row.title)}{escape(named)}</h3>" if is_needed else ""
        parts.append(f"<section>{heading}{pictures_row(row)}</section>")
    return f"<h2>Functions</h2><p>{text}</p>{''.join(parts)}"


def _map(facts: Facts, row: Row) -> str:
    text = (
        "A checkerboard that is straight on A as seen from the front, and where it goes on B; and "
        "how much areas and shapes of B change on their way to A, see below."
        if _has_two(facts)
        else "A checkerboard, and where the flow carries it; and how much areas and shapes change "
        "on the way back, see below."
    )
    return f"<section><h2>The map seen</h2><p>{text}</p>{pictures_row(row)}</section>"


def _distortion(facts: Facts, of_areas: Image.Image, of_shapes: Image.Image) -> str:
    text = (
        "J is the area of a face of B where it lies on A over its own, both surfaces scaled to one "
        "area"
        if _has_two(facts)
        else "J is the area of a face where the flow brought it from over its own"
    )
    text += (
        "; R is its largest stretch over its smallest. |log2 J| and |log2 R| are below the lines "
        "on 95% and 98% of the area; what lies beyond the ends is in the outermost bars."
    )
    plots = (
        f"<figure>{image(of_areas, 'Histogram of log2 J')}</figure>"
        f"<figure>{image(of_shapes, 'Histogram of log2 R')}</figure>"
    )
    return (
        f'<section><h2>Distortion</h2><p>{text}</p><div class="half">{plots}</div>'
        f"{_distortion_table(facts)}</section>"
    )


def _distortion_table(facts: Facts) -> str:
    """Write a row a map: what it does to areas and shapes, and how whole it is."""
    maps = {"initial map": facts["initial_map"]} if "initial_map" in facts else {}
    maps["registered" if maps else "map"] = facts["map"]
    groups = (
        ("", 1),
        ("|log2 J| of areas", 4),
        ("|log2 R| of shapes", 4),
        ("faces", 2),
        ("", 1),
        ("there and back, edges", 2),
    )
    each = ("mean", "95%", "98%", "most")
    covered = "A covered" if _has_two(facts) else "covered"
    heads = ("", *each, *each, "folded", "collapsed", covered, "median", "95%")
    rows = []
    for name, numbers in maps.items():
        logs = [value for key in ("log2_area", "log2_shape") for value in numbers[key].values()]
        counts = (f"{numbers[key]:,}" for key in ("folded", "collapsed"))
        faults = (*counts, percents(numbers["coverage"], ".3g"))
        apart = map(_edges, numbers["there_and_back"].values())
        rows.append((name, *(f"{value:.3f}" for value in logs), *faults, *apart))
    return rows_table(heads, rows, groups=groups)


def _edges(apart: float) -> str:
    return f"{apart:.3g}" if apart >= 0.001 else "< 0.001"


def _path(facts: Facts, picture: Image.Image | None) -> str:
    heads, rows = [*STEP_HEADS, *([SCORE] if has_scores(facts["path"]) else [])], []
    for number, step in enumerate(facts["path"]):
        mark = "→ " if number == facts["step"] else ""
        first, *cells = step_cells(number, step, ".3f")
        row = [f"{mark}{first}", *cells, number_text(step[SCORE], ".4f")]
        rows.append(row[: len(heads)])
    text = (
        "The fields that were found on the way; the arrow is at the one that was chosen. "
        "Distortions here are means of the flow alone, without the initial map."
        if _has_two(facts)
        else "The fields that were found on the way; the arrow is at the one that was chosen."
    )
    table = rows_table(heads, rows, chosen=facts["step"])
    plot = "" if picture is None else image(picture, "Mismatch against distortion along the path")
    beside = f'<div class="half"><div>{table}</div><figure>{plot}</figure></div>' if plot else table
    return f"<section><h2>From smooth to close</h2><p>{text}</p>{beside}</section>"


def _parameters(facts: Facts) -> str:
    if not (changed := facts["changed_parameters"]):
        return "<section><h2>Parameters</h2><p>All have their defaults.</p></section>"
    rows = []
    for name, value in changed.items():
        entry = FIELDS[name]
        symbol = f" [{entry.metadata['symbol']}]" if entry.metadata["symbol"] else ""
        rows.append((f"{name}{symbol}", plain(value), plain(entry.default), entry.metadata["help"]))
    table = rows_table(("", "here", "default", "what it is"), rows, kind="words")
    return f"<section><h2>Parameters other than the defaults</h2>{table}</section>"


def pictures_row(row: Row) -> str:
    """Write pictures side by side, and what their colours mean."""
    columns = len(row.drawings)
    aspect = row.drawings[0].sides[0].width / row.drawings[0].sides[0].height
    widest = f"{columns * _COLUMN * min(_TALL * aspect, 1):.3g}rem"
    figures = "".join(
        f"<figure><figcaption>{escape(each.title)}</figcaption>"
        + "".join(
            image(picture, f"{row.title}, {each.title}, {side}")
            for picture, side in zip(each.sides, ("front", "back"), strict=True)
        )
        + "</figure>"
        for each in row.drawings
    )
    bars = "".join(map(_bar, row.bars))
    style = f"--columns: {columns}; max-width: {widest}"
    return f'<div class="row" style="{style}">{figures}</div>' + (
        f'<div class="bars">{bars}</div>' if bars else ""
    )


def _bar(bar: Bar) -> str:
    low, high = (f"{end:.3g}" for end in (bar.low, bar.high))
    strip = image(bar.strip, f"colours of {bar.title} from {low} to {high}")
    return f"<span>{escape(bar.title)}: {low} {strip} {high}</span>"


def image(picture: Image.Image, what: str) -> str:
    """Write a picture in few bytes, with what it shows in words."""
    stream = io.BytesIO()
    picture.quantize(_COLORS).save(stream, "PNG", optimize=True)
    return png(stream.getvalue(), what)


def png(content: bytes, what: str) -> str:
    """Write a picture that is a PNG already."""
    text = base64.b64encode(content).decode()
    return f'<img alt="{escape(what)}" src="data:image/png;base64,{text}">'


def document(title: str, parts: Iterable[str], style: str = "") -> str:
    """Write a whole page of these parts, to which nothing outside it belongs."""
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{_STYLE}{style}</style></head>\n<body>\n"
        f"{chr(10).join(filter(None, parts))}\n</body></html>\n"
    )


def rows_table(
    heads: Sequence[str],
    rows: Sequence[Sequence[str]],
    chosen: int = -1,
    kind: str = "numbers",
    groups: Sequence[tuple[str, int]] = (),
) -> str:
    """Write a table, with a line of heads for groups of so many columns where these are given."""
    lines = []
    for number, row in enumerate(rows):
        mark = ' class="chosen"' if number == chosen else ""
        cells = "".join(f"<td>{escape(cell)}</td>" for cell in row)
        lines.append(f"<tr{mark}>{cells}</tr>")
    return table(heads, lines, kind, groups)


def table(
    heads: Iterable[str],
    lines: Iterable[str],
    kind: str,
    groups: Sequence[tuple[str, int]] = (),
) -> str:
    """Write a table of lines that are HTML already."""
    head = "".join(f"<th>{escape(each)}</th>" for each in heads)
    if groups:
        wide = (f'<th colspan="{n}">{escape(name)}</th>' for name, n in groups)
        head = f"{''.join(wide)}</tr><tr>{head}"
    body = "".join(lines)
    return f'<table class="{kind}"><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>'
