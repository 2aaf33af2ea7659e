"""A page with all figures beside the paper's claims: one HTML file that needs nothing else."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING

from abfm.experiments import Measure
from abfm.paper import NOTE, TABLE_1

if TYPE_CHECKING:
    from PIL import Image

_STYLE = """
:root { --ink: #1d222b; --muted: #5d6675; --line: #d0d4db; --good: #1b7a43; --bad: #b3261e; }
body { margin: 0 auto; max-width: 72rem; padding: 2rem 1.5rem 4rem; color: var(--ink);
  background: #fff;
  font: 16px/1.5 system-ui, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
h1 { font-size: 1.9rem; line-height: 1.2; } h2 { margin: 3.5rem 0 .3rem; font-size: 1.35rem; }
p { max-width: 60rem; } .muted, figcaption { color: var(--muted); }
nav { columns: 16rem; } nav a { display: block; } a { color: #2455c3; text-decoration: none; }
figure { margin: 1rem 0; }
img { max-width: 100%; max-height: 60rem; border: 1px solid var(--line); border-radius: 6px; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; display: block;
  overflow-x: auto; }
th, td { text-align: left; padding: .3rem 1rem .3rem 0; border-bottom: 1px solid var(--line);
  vertical-align: top; }
th { font-weight: 600; } td.number { white-space: nowrap; }
.good { color: var(--good); } .bad { color: var(--bad); }
"""


@dataclass(frozen=True, eq=False)
class Entry:
    """A figure on the page: a problem says why there is none, and notes what must be said with
    the picture.
    """

    number: int
    title: str
    claim: str
    setting: str = ""
    measures: Sequence[Measure] = ()
    picture: Image.Image | None = None
    problem: str = ""
    notes: Sequence[str] = ()


def page(entries: Sequence[Entry]) -> str:
    """Return the whole page as HTML."""
    links = "".join(
        f'<a href="#figure-{e.number}">Figure {e.number}: {escape(e.title)}</a>' for e in entries
    )
    body = "".join(map(_section, entries))
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>The figures of the paper, measured</title><style>{_STYLE}</style></head><body>"
        "<h1>Advection-Based Function Matching on Surfaces: the figures, measured</h1>"
        "<p>Azencot, Vantzos and Ben-Chen, 2016. Each figure was set up again, computed and "
        "measured by abfm. Blue "
        "frames hold the source, red ones the target, black ones the result.</p>"
        f'<nav>{links}<a href="#table-1">Table 1: '
        f"parameters</a></nav>{body}{_table_1()}</body></html>\n"
    )


def _section(entry: Entry) -> str:
    parts = [
        f'<h2 id="figure-{entry.number}">Figure {entry.number}: {escape(entry.title)}</h2>',
        f"<p><b>The paper:</b> {escape(entry.claim)}</p>",
    ]
    if entry.setting:
        parts.append(f'<p class="muted"><b>Here:</b> {escape(entry.setting)}</p>')
    if entry.problem:
        parts.append(f'<p class="bad">{escape(entry.problem)}</p>')
    parts += [f'<p class="bad">{escape(note)}</p>' for note in entry.notes]
    if entry.picture is not None:
        alt = escape(f"Figure {entry.number}: {entry.title}")
        parts.append(
            f'<figure><img alt="{alt}" src="data:image/png;base64,{_png(entry.picture)}"></figure>'
        )
    if entry.measures:
        rows = "".join(map(_row, entry.measures))
        parts.append(
            "<table><thead><tr><th>measured</th><th>value</th><th>at most</th><th>the paper's "
            "claim</th>"
            f"<th>reproduces</th></tr></thead><tbody>{rows}</tbody></table>"
        )
    return "".join(parts)


def _row(measure: Measure) -> str:
    bound = "" if measure.bound is None else f"{measure.bound:g} {_mark(measure.passes)}"
    cells = (f'<td class="number">{measure.value:.4g}</td>', f'<td class="number">{bound}</td>')
    claim = f"<td>{escape(measure.claim)}</td><td>{_mark(measure.reproduces)}</td>"
    return f"<tr><td>{escape(measure.name)}</td>{''.join(cells)}{claim}</tr>"


def _mark(holds: bool | None) -> str:
    if holds is None:
        return ""
    return '<span class="good">yes</span>' if holds else '<span class="bad">no</span>'


def _table_1() -> str:
    names = ("tau", "alpha", "beta", "sigma", "segments", "substeps", "cooling_stages")
    symbols = {
        "tau": "τ",
        "alpha": "α",
        "beta": "β",
        "segments": "N",
        "substeps": "n",
        "cooling_stages": "stages",
    }
    head = "".join(f"<th>{symbols.get(name, name)}</th>" for name in names).replace(
        "sigma", "last σ"
    )
    rows = []
    for row in TABLE_1.values():
        linearised = row.values["method"] == "linearised"
        left_out = "substeps" if linearised else "segments"
        cells = "".join(
            f"<td>{'-' if name == left_out else f'{row.values[name]:g}'}</td>" for name in names
        )
        rows.append(f"<tr><td>Figure {row.figure}</td>{cells}</tr>")
    return (
        f'<h2 id="table-1">Table 1: parameters</h2><p class="muted">{escape(NOTE)}</p>'
        f"<table><thead><tr><th></th>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table>"
    )


def _png(picture: Image.Image) -> str:
    stream = io.BytesIO()
    picture.save(stream, "PNG", optimize=True)
    return base64.b64encode(stream.getvalue()).decode()
