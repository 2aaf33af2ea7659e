"""`abfm population`: many subjects on a template, their mean, and who does not fit."""

from __future__ import annotations

import argparse
import json
import re
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np

import abfm
from abfm import Control, Population, read_subjects
from abfm.batch import Entry
from abfm.errors import AbfmError, one_line, printable
from abfm.io import write_csv
from abfm.population import HELD_OUT, Settings, function_text
from abfm.population.settings import BOUND, MOST_ROUNDS
from abfm.workers.control import CancelledError
from abfm.workers.progress import Step, telling
from abfm_viewer import pictures, signals
from abfm_viewer.cli import options
from abfm_viewer.cli.batches.running import add_workers, cluster_of
from abfm_viewer.cli.exit_status import FAILED, UNMATCHED, UsageError
from abfm_viewer.cli.match import cancelled_by_signals
from abfm_viewer.cli.populations import results
from abfm_viewer.cli.progress import share_progress
from abfm_viewer.errors import DrawingError
from abfm_viewer.files import outputs
from abfm_viewer.reports.pages import population_page

SUMMARY = "register subjects to a template, again and again, and tell their mean and who is odd"
DESCRIPTION = f"""\
Register each subject of a table to a template by its functions, make their mean, register to that,
and so on until it hardly changes. The mean field is taken off, so that the template does not drift.
Tells means and deviations, how areas vary, how much of the variance is position and how much value,
and which subjects do not fit: these are left out of the mean.

Examples:
  abfm population subjects.csv --template fsaverage.sphere.surf.gii --out pop
  abfm population subjects.csv --template mean.ply --function sulc=file:sulc.csv --out pop --jobs 4

The first line of SUBJECTS.csv names its columns; paths begin at the table's folder:
  name        of the subject
  surface     its mesh file; the template itself where it is empty, or there is no such column
  mask        how much its vertices count, not negative: a file or a function
  landmarks   a file of points of it and of the template that belong together, as of `abfm register`
  weight      how much it counts in the mean (1); one of weight 0 is judged, too
  {HELD_OUT}NAME  a channel that is carried, but not registered by: its correlation with the mean of
              the others, before and after, is its score
  NAME        any other is a channel to register by: a file of values, or a function as text; where
              a file has NaN, the vertex counts for nothing
Registrations are rows of a batch in DIR, each DIR/<digest>.npz, and so is what is carried by them,
in DIR/carried: run again, it does nothing twice.
Written are DIR/population.npz, subjects.csv, mean.vtu, and for a GIFTI template mean.shape.gii, and
the page population.html.

The exit status is 0 when the mean has come to rest; 3 when it still changed by more than --bound in
the last round; 4 when a subject could not be registered; 2 for bad input, of which nothing is
solved; and 130 or 143 after Ctrl-C or SIGTERM.
"""
_WIDTH, _SUBJECTS = 400, "subjects.csv"
_OURS = ("round", "comparing", "carrying", "summing", "parting")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = options.adder(parser)
    add("table", "a subject a row", "SUBJECTS.csv", type=Path)
    add("--template", f"the surface that subjects come to, a {options.MESH}", "SURFACE")
    options.add_mesh_options(parser)
    add = options.adder(parser.add_argument_group("the template and the mean"))
    what = "the template's own function of a channel, the first target; one for each, or none"
    add("--function", what, "NAME=SPEC", action="append", default=[])
    add(
        "--mask", "how much the template's vertices count, not negative: a function or file", "SPEC"
    )
    what = "how much a channel counts, above 0, beside the others that are registered by (1)"
    add("--weight", what, "NAME=N", action="append", default=[])
    add("--initial", "the initial maps, as of `abfm register`", "WORD[:...]")
    what = f"end when the mean changes by less, over its deviation (default: {BOUND:g})"
    add("--bound", what, "X", type=options.bound, default=BOUND)
    what = f"at most so many rounds (default: {MOST_ROUNDS})"
    add("--rounds", what, "N", type=options.count, default=MOST_ROUNDS)
    options.add_max_distortion(add)
    add("--one-based", "vertex numbers of the column landmarks count from 1, not from 0")
    options.add_parameters(parser)
    add_workers(parser)
    add = options.adder(parser.add_argument_group("output"))
    about = "folder for results: made if it is not there"
    add("--out", about, "DIR", type=options.folder, required=True)
    options.add_up(add)
    add("--no-pictures", "a page without pictures")
    add("--json", "print one JSON object about the population")
    add("--quiet", "no progress")


def run(arguments: argparse.Namespace) -> int:
    """Register, write and tell."""
    if arguments.template is None:
        raise UsageError("--template is missing: the surface that subjects come to")
    folder, began, control = arguments.out, time.perf_counter(), Control()
    outputs.check_not_read(folder / _SUBJECTS, [str(arguments.table)])
    cohort, settings = read_subjects(arguments.table), _settings(arguments)
    cluster = cluster_of(arguments)
    outputs.make_folder(folder)
    outputs.check_folder(folder / "population.npz")
    with (
        cancelled_by_signals(control, "with what is done") as kept,
        _progress(arguments.quiet),
    ):
        try:
            found = abfm.register_population(
                cohort,
                arguments.template,
                folder,
                settings,
                cluster,
                on_change=_tell_failure,
                control=control,
            )
        except CancelledError:
            print("run the same again to go on: what is done is kept", file=sys.stderr)
            return signals.status(kept.number or 0)
    facts = {
        "table": printable(arguments.table.name),
        "template": printable(Path(arguments.template).name),
        "bound": arguments.bound,
        **results.facts(found),
        "seconds": time.perf_counter() - began,
    }
    written = _write(found, facts, arguments)
    if arguments.json:
        print(json.dumps(facts | {"outputs": list(map(str, written))}))
    else:
        names = ", ".join(map(printable, written))
        lines = [*results.lines(found, facts), f"in {facts['seconds']:.1f} s; wrote {names}"]
        print("\n".join(lines))
    if not all(found.digests):
        return FAILED
    return 0 if found.changes[-1] <= settings.bound else UNMATCHED


def _settings(arguments: argparse.Namespace) -> Settings:
    functions = {
        name: function_text(text, Path.cwd())
        for name, text in _named("--function", arguments.function, "SPEC")
    }
    weights = {}
    for name, text in _named("--weight", arguments.weight, "N"):
        try:
            weights[name] = float(text)
        except ValueError:
            option = f"--weight {one_line(name, 40)}={one_line(text, 40)}"
            raise UsageError(f"{option}: expected a number after =") from None
    parameters = options.given_parameters(arguments)
    chosen = {name: "auto" if value is None else value for name, value in parameters.items()}
    chosen |= options.mesh_options(arguments).given
    given = {name.replace("_", "-"): value for name, value in chosen.items()}
    if arguments.one_based:
        given["one-based"] = "yes"
    if arguments.max_distortion is not None:
        given["max-distortion"] = arguments.max_distortion
    return Settings(
        functions,
        function_text(arguments.mask, Path.cwd()) if arguments.mask else "",
        arguments.initial or "",
        given,
        arguments.bound,
        arguments.rounds,
        weights,
    )


def _named(option: str, given: Sequence[str], what: str) -> Iterator[tuple[str, str]]:
    """Yield the names of channels and what an option says of each, at most once."""
    seen = set[str]()
    for each in given:
        name, equals, text = each.partition("=")
        if not equals or not name or not text:
            raise UsageError(f"{option} {one_line(each, 40)}: expected NAME={what}")
        if name in seen:
            raise UsageError(f"{option} {one_line(name, 40)}: it is given twice")
        seen.add(name)
        yield name, text


@contextmanager
def _progress(quiet: bool) -> Iterator[None]:
    """Tell of the steps of the whole; those inside registrations come from many at once."""
    with share_progress("population", quiet) as report:

        def tell(now: Step | None) -> None:
            if now is not None and now.task.startswith(_OURS):
                report(now.task, now.done or 0.0)

        with nullcontext() if quiet else telling(tell):
            yield


def _tell_failure(entry: Entry) -> None:
    if entry.reason:
        print(f"note: {printable(entry.row.name)} failed: {entry.reason}", file=sys.stderr)


def _write(
    found: Population, facts: Mapping[str, Any], arguments: argparse.Namespace
) -> list[Path]:
    folder: Path = arguments.out
    written = [folder / name for name in ("population.npz", _SUBJECTS, "mean.vtu")]
    found.save(written[0])
    write_csv(written[1], _table(facts))
    on_vertices, on_faces = _arrays(found)
    abfm.io.export_vtu(written[2], found.template, on_vertices, on_faces)
    if str(arguments.template).lower().endswith((".gii", ".gii.gz")):
        written.append(folder / "mean.shape.gii")
        whole = found.template.on_file(np.stack(list(on_vertices.values()), axis=1))
        try:
            structure = found.template.structure
            abfm.io.write_values(written[-1], whole, structure, list(on_vertices))
        except AbfmError as error:
            print(f"note: no {written.pop().name}: {error}", file=sys.stderr)
    drawn = None
    if not arguments.no_pictures:
        try:
            with share_progress("page", arguments.quiet) as report:
                drawn = pictures.population_pictures(found, _WIDTH, arguments.up, report)
        except DrawingError as error:
            print(f"note: the page has no pictures: {error}", file=sys.stderr)
    written.append(folder / "population.html")
    outputs.write_text(written[-1], population_page(facts, drawn))
    return written


def _arrays(found: Population) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return values at vertices, (V,) each, and at faces, (F,), by names for files."""
    on_vertices: dict[str, Any] = {}
    for c, channel in enumerate(found.channels):
        name = re.sub(r"[^A-Za-z0-9_.-]", "_", channel.name)
        if f"mean_{name}" in on_vertices:
            name = f"{name}_{c}"
        on_vertices[f"mean_{name}"] = found.mean(c)
        on_vertices[f"deviation_{name}"] = found.deviation(c)
        on_vertices[f"plain_mean_{name}"] = found.plain_mean(c)
    on_faces = {
        "log2_area_mean": found.log2_area_mean,
        "log2_area_deviation": found.log2_area_deviation,
    }
    return on_vertices, on_faces


def _table(facts: Mapping[str, Any]) -> list[list[Any]]:
    """Return the rows of a table of subjects, the worst first."""
    names = [each["name"] for each in facts["channels"]]
    own = [name for name in facts["subjects"][0] if name != "scores"]
    ends = ("before", "after")
    rows = [[*own, *(f"{name} {end}" for name in names for end in ends)]]
    for subject in facts["subjects"]:
        scores = [value for name in names for value in subject["scores"][name]]
        rows.append([*(subject[name] for name in own), *scores])
    return rows
