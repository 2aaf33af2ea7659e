"""`abfm population`: subjects on a template."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

from abfm import Population
from abfm.errors import printable
from abfm.population import HELD_OUT_PREFIX
from abfm.population.task import PopulationTask
from abfm_viewer import pictures
from abfm_viewer.cli import options, solve
from abfm_viewer.cli.exit_status import UsageError, print_note
from abfm_viewer.cli.progress import share_progress
from abfm_viewer.errors import DrawingError
from abfm_viewer.files import outputs
from abfm_viewer.reports.pages import population_page

SUMMARY = "iteratively register subjects to a template; report the mean and the outliers"
DESCRIPTION = f"""\
Register each subject of a table to a template by its functions, compute the mean, register to the
mean, and repeat this until it hardly changes. The mean field is subtracted, so that the template
does not drift. The report has means and deviations, the variation of areas, the variance of
position and of value, and the outliers, which are left out of the mean.

Examples:
  abfm population subjects.csv --template fsaverage.sphere.surf.gii --out pop
  abfm population subjects.csv --template mean.ply --channel sulc sulc.csv 1 --out pop --jobs 4

The first line of SUBJECTS.csv names its columns; paths begin at the table's folder:
  name        of the subject
  surface     its mesh file; the template itself where it is empty, or there is no such column
  mask        weights of its vertices, not negative: a file or a function
  landmarks   a file of corresponding points of it and of the template, as of `abfm register`
  weight      its weight in the mean (1); subjects of weight 0 are also judged
  {HELD_OUT_PREFIX}NAME  a channel that is transferred, but not registered by: its score is its
              correlation with the mean of the others, before and after
  NAME        any other is a channel to register by: a file of values, or a function as text; a
              vertex with NaN has no weight
Registrations are rows of a batch in DIR, each DIR/<digest>.npz: run again, the command solves only
missing ones.
The output is DIR/population.npz, subjects.csv, mean.vtu, for a GIFTI template mean.shape.gii, and
the page population.html.

The exit status is 0 when the mean has converged; 3 when it still changed by more than --bound in
the last round; 4 when a subject could not be registered; 2 for bad input, of which nothing is
solved; and 130 or 143 after Ctrl-C or SIGTERM.
"""
_PICTURE_WIDTH = 400


def add_arguments(parser: argparse.ArgumentParser) -> None:
    options.add_inputs(parser, PopulationTask.inputs)
    options.add_workers(parser)
    options.add_folder(parser, is_required=True)


def run(arguments: argparse.Namespace) -> int:
    """Register, write and report."""
    if arguments.template is None:
        raise UsageError("--template is missing: the surface that subjects come to")
    folder: Path = arguments.out
    row = solve.row_of(arguments, PopulationTask)
    table = folder / "subjects.csv"
    outputs.check_not_read(table, [arguments.table])
    cluster = options.cluster_of(arguments)
    task = row.task()
    assert isinstance(task, PopulationTask)
    outputs.make_folder(folder)
    files = [folder / "population.npz", folder / "mean.vtu"]
    if arguments.template.lower().endswith((".gii", ".gii.gz")):
        files.append(folder / "mean.shape.gii")
    out = solve.Outputs(files, {"subjects": table}, arguments.up)
    outputs.check_folder(files[0])
    solved = solve.solve(replace(task, cluster=cluster), out, arguments.quiet, folder)
    facts = {
        "table": printable(Path(arguments.table).name),
        "template": printable(Path(arguments.template).name),
        **solved.to_dict(),
    }
    written = [*solved.outputs, folder / "population.html"]
    drawn = _drawn(solved.found, arguments)
    outputs.write_text(written[-1], population_page(facts, solved.found.facts, drawn))
    if arguments.json:
        print(json.dumps(facts | {"outputs": list(map(str, written))}))
    else:
        print(replace(solved, outputs=written).summary())
    return solved.status


def _drawn(found: Population, arguments: argparse.Namespace) -> pictures.PopulationPictures | None:
    if arguments.no_pictures:
        return None
    try:
        with share_progress("page", arguments.quiet) as report:
            return pictures.population_pictures(found, _PICTURE_WIDTH, arguments.up, report)
    except DrawingError as error:
        print_note(f"the page has no pictures: {error}")
        return None
