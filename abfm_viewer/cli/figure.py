"""`abfm figure`: compute, measure and draw figures of the paper, and write a page with all."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from abfm import AbfmError, Match, TriangleMesh, experiments, load_mesh
from abfm.batch import Row
from abfm.display import BEST_VIEW
from abfm.errors import printable
from abfm.experiments import Findings, Measure, RequestedMatch, Script
from abfm.parameters import FIGURES, TITLES
from abfm_viewer import pictures
from abfm_viewer.cli import options
from abfm_viewer.cli.batch import solved
from abfm_viewer.cli.exit_status import UsageError, print_line, print_note
from abfm_viewer.cli.progress import share_progress
from abfm_viewer.errors import DrawingError
from abfm_viewer.files import outputs
from abfm_viewer.reports.pages import figures_page

if TYPE_CHECKING:
    from PIL import Image

SUMMARY = "compute, measure and draw figures of the paper"
DESCRIPTION = """\
Compute one or all figures of the paper. Write figure-N.png, in the arrangement of the paper, and
figure-N.json with the measured numbers. `all` also writes a page, index.html.

Examples:
  abfm figure 3 --out figures
  abfm figure all --out figures --jobs 2
  abfm figure 1 --mesh bunny.obj --out figures
"""
DETAILS = """\
In a picture, the frame of a panel is blue for the source, red for the target and black for the
result. The JSON file has the measured numbers, and notes on values outside the range of the
colours. For each number it records whether it is within its bound and whether it reproduces the
claim of the paper.

The meshes are bundled or generated; --mesh computes the figure on another one. All figures take a
few minutes. `all`, --jobs, --scheduler and --scheduler-file first solve the matches as a batch in
DIR/matches, on all cores or a cluster. `abfm batch --status DIR/matches` reports its state, and the
same command resumes it.
"""
MAIN_OPTIONS = ("out", "mesh", "jobs", "scheduler", "json", "quiet")
_WORDS = {True: "yes", False: "no"}
_MATCHES = "matches"


@dataclass(frozen=True, eq=False)
class FigureEntry:
    """A figure on the page, with its `notes`; `problem` is the reason for a missing picture."""

    number: int
    title: str
    claim: str
    setting: str = ""
    measures: Sequence[Measure] = ()
    picture: Image.Image | None = None
    problem: str = ""
    notes: Sequence[str] = ()


def add_arguments(parser: options.Parser) -> None:
    add = options.adder(parser)
    add("figure", f"number of the figure, 1 to {max(FIGURES)}, or all", "N|all")
    add("--out", "folder for the files, created if missing", "DIR", type=Path, required=True)
    add("--mesh", "compute the figure on this mesh", "FILE")
    options.add_mesh_options(parser)
    options.add_view(add)
    add("--json", "print all measured numbers as one JSON object")
    add("--quiet", "do not show progress")
    options.add_workers(parser)


def run(arguments: argparse.Namespace) -> int:
    is_all = arguments.figure == "all"
    if not is_all and arguments.figure not in map(str, FIGURES):
        every = f"a number from {FIGURES[0]} to {FIGURES[-1]}, or all"
        raise UsageError(f"{arguments.figure!r} is not a figure; expected {every}")
    numbers = FIGURES if is_all else (int(arguments.figure),)
    mesh = _mesh(arguments) if arguments.mesh else None
    index = arguments.out / "index.html"
    outputs.make_folder(arguments.out)
    written = [_file(arguments.out, n, suffix) for n in numbers for suffix in (".png", ".json")]
    for path in [*written, *([index] if is_all else [])]:
        outputs.check(path, [path.suffix])
    name = Path(arguments.mesh).name if arguments.mesh else ""
    figures = [_Figure(number, mesh, name) for number in numbers]
    if is_all or any((arguments.jobs, arguments.scheduler, arguments.scheduler_file)):
        status = _match_by_batch(figures, arguments)
        if status is not None:
            return status
    entries = []
    for figure in figures:
        entry = _compute(figure, arguments)
        _write(entry, arguments.out)
        if not arguments.json:
            _print(entry)
        entries.append(entry)
    if is_all:
        outputs.write_text(index, figures_page(entries))
    if arguments.json:
        print(json.dumps({"figures": [_described(entry) for entry in entries]}))
    else:
        files = [index] if is_all else filter(Path.is_file, written)
        print(f"wrote {', '.join(map(printable, files))}")
    return 0


def _mesh(arguments: argparse.Namespace) -> TriangleMesh:
    found = load_mesh(arguments.mesh, **options.mesh_options(arguments).changed)
    for message in found.messages:
        print_note(message)
    return found


def _write(entry: FigureEntry, folder: Path) -> None:
    picture = _file(folder, entry.number, ".png")
    if entry.picture is not None:
        outputs.write_picture(picture, entry.picture)
    else:
        picture.unlink(missing_ok=True)  # of an earlier run, on another mesh
    text = json.dumps(_described(entry), indent=1) + "\n"
    outputs.write_text(_file(folder, entry.number, ".json"), text)


def _file(folder: Path, number: int, suffix: str) -> Path:
    return folder / f"figure-{number}{suffix}"


class _Figure:
    """A figure of the paper, whose script stops to request matches and then computes the result."""

    def __init__(self, number: int, mesh: TriangleMesh | None, name: str) -> None:
        self.number = number
        self.report: Callable[[str, float], None] = lambda text, share: None
        self.setup = experiments.FigureSetup(mesh, name, report=lambda *now: self.report(*now))
        self.find_matches: Callable[[Sequence[RequestedMatch]], Sequence[Match]] = self.setup.match
        self._error: AbfmError | None = None

    @cached_property
    def script(self) -> Script:
        return experiments.script(self.number, self.setup)

    @cached_property
    def requested(self) -> Sequence[RequestedMatch]:
        return experiments.requested_matches(self.script)

    def needed_matches(self) -> Sequence[RequestedMatch]:
        """Return the requested matches; none after an error, which `findings` raises."""
        try:
            return self.requested
        except AbfmError as error:
            self._error = error
            return ()

    def findings(self) -> Findings:
        """Run the script to its end with the requested matches, and return its result."""
        if self._error is not None:
            raise self._error
        matches = self.find_matches(self.requested)
        return experiments.findings_of(self.script, matches)


def _match_by_batch(figures: Sequence[_Figure], arguments: argparse.Namespace) -> int | None:
    """Solve the matches of all figures as a batch; `findings` then reads their results.

    Return the exit status after a signal; None without a signal.
    """
    folder, rows = arguments.out / _MATCHES, dict[_Figure, list[Row]]()
    with share_progress("figures", arguments.quiet) as report:
        for done, figure in enumerate(figures):
            report(f"preparing the matches of figure {figure.number}", done / len(figures))
            rows[figure] = experiments.rows_of(figure.number, figure.needed_matches(), folder)
    of_all = [row for own in rows.values() for row in own]
    entries, status = solved(of_all, "Matches of the figures", folder, arguments)
    known = iter(entries)
    for figure, own in rows.items():
        own_entries = list(islice(known, len(own)))
        figure.find_matches = partial(experiments.matches_of, entries=own_entries)
    if status is not None:
        print_line("run the same command to resume; finished rows are kept")
    return status


def _compute(figure: _Figure, arguments: argparse.Namespace) -> FigureEntry:
    """Run the script of a figure to its end, and return the figure for the page.

    If it fails, the `problem` is the error; if only one figure is requested, the error is raised.
    """
    number, on_mesh = figure.number, figure.setup.mesh is not None
    title, claim = TITLES[number], experiments.claim(number)
    try:
        with share_progress(f"figure {number}", arguments.quiet) as report:
            figure.report = report
            findings = figure.findings()
            report("drawing", 1.0)
            sheet, view = findings.sheet, options.view_of(arguments)
            if on_mesh or view != BEST_VIEW:
                sheet = replace(sheet, view=view)
            notes, picture, problem = pictures.captions(sheet), None, ""
            try:
                picture = pictures.figure_picture(sheet, notes)
            except DrawingError as error:
                problem = f"no picture: {error}"
    except AbfmError as error:
        if arguments.figure != "all":
            raise
        return FigureEntry(number, title, claim, problem=f"Not possible on this mesh: {error}")
    setting, measures = findings.setting, findings.measures
    return FigureEntry(number, title, claim, setting, measures, picture, problem, notes)


def _described(entry: FigureEntry) -> dict[str, Any]:
    texts = {name: getattr(entry, name) for name in ("title", "claim", "setting", "problem")}
    measures = [measure.to_dict() for measure in entry.measures]
    return {"figure": entry.number, **texts, "notes": list(entry.notes), "measures": measures}


def _print(entry: FigureEntry) -> None:
    print(f"figure {entry.number}: {entry.title}")
    for measure in entry.measures:
        line = f"  {measure.value:10.4g}  {measure.name}"
        if measure.bound is not None:
            line += f"  (at most {measure.bound:g}: {_WORDS[bool(measure.passes)]})"
        if measure.reproduces is not None:
            line += f"  [{_WORDS[measure.reproduces]}: {measure.claim}]"
        print(line)
    for note in (*entry.notes, *filter(None, [entry.problem])):
        print_note(f"figure {entry.number}: {note}")
    sys.stdout.flush()
