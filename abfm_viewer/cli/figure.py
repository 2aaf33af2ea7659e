"""`abfm figure`: a figure of the paper, or all of them, computed, measured and drawn."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from abfm import AbfmError, TriangleMesh, experiments
from abfm.errors import printable
from abfm.io import write_atomically
from abfm.paper import FIGURES, TITLES
from abfm_viewer import pictures
from abfm_viewer.cli import options
from abfm_viewer.cli.exit_status import UsageError
from abfm_viewer.cli.figure_page import Entry, page
from abfm_viewer.cli.progress import share_progress
from abfm_viewer.errors import DrawingError
from abfm_viewer.files import outputs

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


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "figure",
        metavar="N|all",
        help=f"number of the figure, 1 to {max(FIGURES)}, or all",
    )
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="folder, made if missing"
    )
    parser.add_argument(
        "--mesh", metavar="FILE", help="compute the figure on this mesh instead of its own"
    )
    options.add_largest_component(parser)
    parser.add_argument(
        "--up", choices=("x", "y", "z"), help="axis that points upwards (default: y for a --mesh)"
    )
    parser.add_argument(
        "--json",
        action="store_true",
        help="print one JSON object with everything that was measured",
    )
    parser.add_argument("--quiet", action="store_true", help="no progress")


def run(arguments: argparse.Namespace) -> int:
    """Compute, draw and write."""
    if arguments.figure not in ("all", *map(str, FIGURES)):
        every = f"a number from {FIGURES[0]} to {FIGURES[-1]}, or all"
        raise UsageError(f"there is no figure {arguments.figure!r}; expected {every}")
    numbers = FIGURES if arguments.figure == "all" else (int(arguments.figure),)
    mesh = options.mesh(arguments) if arguments.mesh else None
    outputs.make_folder(arguments.out)
    for number in numbers:
        for suffix in (".png", ".json"):
            outputs.check(arguments.out / f"figure-{number}{suffix}", [suffix])
    index = arguments.out / "index.html" if arguments.figure == "all" else None
    if index is not None:
        outputs.check(index, [".html"])
    entries = []
    for number in numbers:
        entry = _compute(number, mesh, arguments)
        _write(entry, arguments.out)
        if not arguments.json:
            _print(entry)
        entries.append(entry)
    if index is not None:
        _write_text(index, page(entries))
    if arguments.json:
        print(json.dumps({"figures": [_described(entry) for entry in entries]}))
    elif index is not None:
        print(f"wrote {printable(index)}")
    return 0


def _compute(number: int, mesh: TriangleMesh | None, arguments: argparse.Namespace) -> Entry:
    """Run a figure's script; when all are wanted, one that a mesh does not allow is told on the
    page.
    """
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


def _write(entry: Entry, folder: Path) -> None:
    picture = folder / f"figure-{entry.number}.png"
    if entry.picture is not None:
        outputs.write_picture(picture, entry.picture)
    else:
        picture.unlink(missing_ok=True)  # that of an earlier run shows another mesh
    _write_text(
        folder / f"figure-{entry.number}.json", json.dumps(_described(entry), indent=1) + "\n"
    )


def _write_text(path: Path, text: str) -> None:
    with write_atomically(path) as temporary:
        Path(temporary).write_text(text, encoding="utf-8")


def _described(entry: Entry) -> dict[str, Any]:
    """Return what stands in a figure's JSON."""
    texts = {name: getattr(entry, name) for name in ("title", "claim", "setting", "problem")}
    measures = [measure.to_dict() for measure in entry.measures]
    return {"figure": entry.number, **texts, "notes": list(entry.notes), "measures": measures}


def _print(entry: Entry) -> None:
    print(f"figure {entry.number}: {entry.title}")
    for measure in entry.measures:
        bound = (
            ""
            if measure.bound is None
            else f"  (at most {measure.bound:g}: {_word(measure.passes)})"
        )
        claim = (
            ""
            if measure.reproduces is None
            else f"  [{_word(measure.reproduces)}: {measure.claim}]"
        )
        print(f"  {measure.value:10.4g}  {measure.name}{bound}{claim}")
    for note in (*entry.notes, *filter(None, [entry.problem])):
        print(f"note: figure {entry.number}: {note}", file=sys.stderr)
    sys.stdout.flush()


def _word(holds: bool | None) -> str:
    return "yes" if holds else "no"
