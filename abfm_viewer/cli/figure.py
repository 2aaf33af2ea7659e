"""`abfm figure`: figures of the paper computed, measured and drawn, and a page with all of them."""

from __future__ import annotations

import argparse
import base64
import io
import json
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from abfm import AbfmError, TriangleMesh, experiments
from abfm.errors import printable
from abfm.experiments import Measure
from abfm.io import write_atomically
from abfm.parameters import FIGURES, NOTE, TABLE_1, TITLES
from abfm_viewer import pictures
from abfm_viewer.cli import options
from abfm_viewer.cli.exit_status import UsageError
from abfm_viewer.cli.progress import share_progress
from abfm_viewer.errors import DrawingError
from abfm_viewer.files import outputs

if TYPE_CHECKING:
    from PIL import Image

SUMMARY = "a figure of the paper, computed, measured and drawn"
DESCRIPTION = """\
Compute a figure of the paper, or all of them, anew: figure-N.png is drawn in the paper's
arrangement (blue frames for the source, red for the target, black for the result), figure-N.json
holds what was measured, with the bounds that it keeps or not, whether the paper's claims reproduce,
and what colours do not show. `all` also writes index.html, a page with everything.

The meshes are bundled or generated; --mesh computes the figure on another one. All figures take a
few minutes.

Examples:
  abfm figure 3 --out figures
  abfm figure all --out figures
  abfm figure 1 --mesh bunny.obj --out figures
"""
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
_TABLE_1 = {
    "tau": "τ",
    "alpha": "α",
    "beta": "β",
    "sigma": "last σ",
    "segments": "N",
    "substeps": "n",
    "cooling_stages": "stages",
}
"""The columns of the paper's Table 1: parameters and their titles."""
_WORDS = {True: "yes", False: "no"}


@dataclass(frozen=True, eq=False)
class Entry:
    """A figure on the page: `problem` says why there is none, `notes` what must be said with it."""

    number: int
    title: str
    claim: str
    setting: str = ""
    measures: Sequence[Measure] = ()
    picture: Image.Image | None = None
    problem: str = ""
    notes: Sequence[str] = ()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = options.adder(parser)
    add("figure", f"number of the figure, 1 to {max(FIGURES)}, or all", "N|all")
    add("--out", "folder, made if missing", "DIR", type=Path, required=True)
    add("--mesh", "compute the figure on this mesh instead of its own", "FILE")
    add("--largest-component", options.LARGEST)
    add("--up", "axis that points upwards (default: y for a --mesh)", choices=("x", "y", "z"))
    add("--json", "print one JSON object with everything that was measured")
    add("--quiet", "no progress")


def run(arguments: argparse.Namespace) -> int:
    all_wanted = arguments.figure == "all"
    if not all_wanted and arguments.figure not in map(str, FIGURES):
        every = f"a number from {FIGURES[0]} to {FIGURES[-1]}, or all"
        raise UsageError(f"there is no figure {arguments.figure!r}; expected {every}")
    numbers = FIGURES if all_wanted else (int(arguments.figure),)
    mesh = options.mesh(arguments) if arguments.mesh else None
    index = arguments.out / "index.html"
    outputs.make_folder(arguments.out)
    for path in [_file(arguments.out, n, suffix) for n in numbers for suffix in (".png", ".json")]:
        outputs.check(path, [path.suffix])
    if all_wanted:
        outputs.check(index, [".html"])
    entries = []
    for number in numbers:
        entry = _compute(number, mesh, arguments)
        picture = _file(arguments.out, number, ".png")
        if entry.picture is not None:
            outputs.write_picture(picture, entry.picture)
        else:
            picture.unlink(missing_ok=True)  # that of an earlier run shows another mesh
        text = json.dumps(_described(entry), indent=1) + "\n"
        _write_text(_file(arguments.out, number, ".json"), text)
        if not arguments.json:
            _print(entry)
        entries.append(entry)
    if all_wanted:
        _write_text(index, page(entries))
    if arguments.json:
        print(json.dumps({"figures": [_described(entry) for entry in entries]}))
    elif all_wanted:
        print(f"wrote {printable(index)}")
    return 0


def _file(folder: Path, number: int, suffix: str) -> Path:
    return folder / f"figure-{number}{suffix}"


def _compute(number: int, mesh: TriangleMesh | None, arguments: argparse.Namespace) -> Entry:
    """Run a figure's script; of all, one that a mesh does not allow is told on the page."""
    title, claim = TITLES[number], experiments.claim(number)
    name = Path(arguments.mesh).name if arguments.mesh else ""
    try:
        with share_progress(f"figure {number}", arguments.quiet) as report:
            stage = experiments.Stage(mesh, name, report=report)
            findings = experiments.findings_of(experiments.script(number, stage))
            report("drawing", 1.0)
            sheet = replace(findings.sheet, up=arguments.up or ("y" if mesh else findings.sheet.up))
            notes, picture, problem = pictures.captions(sheet), None, ""
            try:
                picture = pictures.figure_picture(sheet, notes)
            except DrawingError as error:
                problem = f"no picture: {error}"
    except AbfmError as error:
        if arguments.figure != "all":
            raise
        return Entry(number, title, claim, problem=f"Not on this mesh: {error}")
    setting, measures = findings.setting, findings.measures
    return Entry(number, title, claim, setting, measures, picture, problem, notes)


def _write_text(path: Path, text: str) -> None:
    with write_atomically(path) as temporary:
        Path(temporary).write_text(text, encoding="utf-8")


def _described(entry: Entry) -> dict[str, Any]:
    texts = {name: getattr(entry, name) for name in ("title", "claim", "setting", "problem")}
    measures = [measure.to_dict() for measure in entry.measures]
    return {"figure": entry.number, **texts, "notes": list(entry.notes), "measures": measures}


def _print(entry: Entry) -> None:
    print(f"figure {entry.number}: {entry.title}")
    for measure in entry.measures:
        line = f"  {measure.value:10.4g}  {measure.name}"
        if measure.bound is not None:
            line += f"  (at most {measure.bound:g}: {_WORDS[bool(measure.passes)]})"
        if measure.reproduces is not None:
            line += f"  [{_WORDS[measure.reproduces]}: {measure.claim}]"
        print(line)
    for note in (*entry.notes, *filter(None, [entry.problem])):
        print(f"note: figure {entry.number}: {note}", file=sys.stderr)
    sys.stdout.flush()


def page(entries: Sequence[Entry]) -> str:
    links = "".join(
        f'<a href="#figure-{e.number}">Figure {e.number}: {escape(e.title)}</a>' for e in entries
    )
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>The figures of the paper, measured</title><style>{_STYLE}</style></head><body>"
        "<h1>Advection-Based Function Matching on Surfaces: the figures, measured</h1>"
        "<p>Azencot, Vantzos and Ben-Chen, 2016. Each figure was set up again, computed and "
        "measured by abfm. Blue frames hold the source, red ones the target, black ones the "
        f'result.</p><nav>{links}<a href="#table-1">Table 1: parameters</a></nav>'
        f"{''.join(map(_section, entries))}{_table_1()}</body></html>\n"
    )


def _section(entry: Entry) -> str:
    title = escape(f"Figure {entry.number}: {entry.title}")
    bad = filter(None, [entry.problem, *entry.notes])
    parts = [
        f'<h2 id="figure-{entry.number}">{title}</h2>',
        f"<p><b>The paper:</b> {escape(entry.claim)}</p>",
        f'<p class="muted"><b>Here:</b> {escape(entry.setting)}</p>' if entry.setting else "",
        *(f'<p class="bad">{escape(note)}</p>' for note in bad),
    ]
    if entry.picture is not None:
        stream = io.BytesIO()
        entry.picture.save(stream, "PNG", optimize=True)
        png = base64.b64encode(stream.getvalue()).decode()
        parts.append(f'<figure><img alt="{title}" src="data:image/png;base64,{png}"></figure>')
    if entry.measures:
        titles = ("measured", "value", "at most", "the paper's claim", "reproduces")
        parts.append(_table(titles, map(_row, entry.measures)))
    return "".join(parts)


def _table(titles: Iterable[str], rows: Iterable[str]) -> str:
    head = "".join(f"<th>{title}</th>" for title in titles)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table>"


def _row(measure: Measure) -> str:
    bound = "" if measure.bound is None else f"{measure.bound:g} {_mark(measure.passes)}"
    cells = (f'<td class="number">{measure.value:.4g}</td>', f'<td class="number">{bound}</td>')
    claim = f"<td>{escape(measure.claim)}</td><td>{_mark(measure.reproduces)}</td>"
    return f"<tr><td>{escape(measure.name)}</td>{''.join(cells)}{claim}</tr>"


def _mark(holds: bool | None) -> str:
    if holds is None:
        return ""
    return f'<span class="{"good" if holds else "bad"}">{_WORDS[holds]}</span>'


def _table_1() -> str:
    rows = []
    for row in TABLE_1.values():
        left_out = "substeps" if row.values["method"] == "linearised" else "segments"
        shown = ["-" if name == left_out else f"{row.values[name]:g}" for name in _TABLE_1]
        cells = "".join(f"<td>{text}</td>" for text in shown)
        rows.append(f"<tr><td>Figure {row.figure}</td>{cells}</tr>")
    table = _table(["", *_TABLE_1.values()], rows)
    return f'<h2 id="table-1">Table 1: parameters</h2><p class="muted">{escape(NOTE)}</p>{table}'
