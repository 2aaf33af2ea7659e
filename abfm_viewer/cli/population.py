"""`abfm population`: registration of many subjects to a template."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

from abfm import Population
from abfm.errors import printable
from abfm.population import HELD_OUT_PREFIX
from abfm.population.task import PopulationTask
from abfm.tasks.inputs import FUNCTIONS_HELP
from abfm_viewer import pictures
from abfm_viewer.cli import options, solve
from abfm_viewer.cli.exit_status import print_note
from abfm_viewer.cli.progress import share_progress
from abfm_viewer.errors import DrawingError
from abfm_viewer.files import outputs
from abfm_viewer.reports.pages import population_page

SUMMARY = "iteratively register subjects to a template; report the mean and the outliers"
DESCRIPTION = """\
Register each subject of a table to a template by its functions, and compute the mean. Register to
the mean, and repeat until it hardly changes. The report has means and standard deviations, the
variation of areas and positions, and outliers, which the mean excludes.

Examples:
  abfm population subjects.csv --template fsaverage.sphere.surf.gii --out pop
  abfm population subjects.csv --template mean.ply --channel sulc sulc.csv 1 --out pop --jobs 4

The first line of SUBJECTS.csv names its columns: `name`, `surface`, and one column per channel with
files of values:
  name,surface,sulc,curv
  sub-01,sub-01/lh.sphere,sub-01/lh.sulc,sub-01/lh.curv

The exit status is 0 if the mean has converged, 3 if not, 4 if a subject could not be registered, 2
for bad input.
"""
DETAILS = f"""\
Columns of SUBJECTS.csv (paths begin at the folder of the table):
  name        name of the subject
  surface     its mesh file; without it, the template itself
  mask        weight of each of its vertices, not negative: a file of values or a SPEC
  landmarks   file of corresponding points of the subject and the template, see `abfm register`
  weight      its weight in the mean (default: 1); subjects of weight 0 are also checked
  {HELD_OUT_PREFIX}NAME  channel that is transferred, but not used for registration. Its score is
              its correlation with the mean of the other subjects, before and after registration
  NAME        any other column is a channel to register by: a file of values or a SPEC. Vertices
              with NaN have no weight
The mean field is subtracted, so that the template does not drift.

Channels:
  --channel NAME DST WEIGHT sets the first target and the weight of a channel. DST is a function on
  the template, or auto for that of the subject closest to the mean.

{FUNCTIONS_HELP}
Output:
  DIR/<digest>.npz                       registrations; the same command solves only missing ones
  DIR/population.npz, subjects.csv       the result and a table of the subjects
  DIR/mean.vtu                           means on the template; also mean.shape.gii for GIFTI
  DIR/population.html                    page with pictures

Exit status:
  0    the mean has converged
  2    bad input; nothing is solved
  3    the mean changed by more than --bound in the last round
  4    a subject could not be registered
  130  Ctrl-C ended the run (143: SIGTERM, 129: closed terminal); the same command resumes
"""
MAIN_OPTIONS = (*PopulationTask.main_options, "jobs", "scheduler", "out", "json")
_PICTURE_WIDTH = 400


def add_arguments(parser: options.Parser) -> None:
    options.add_inputs(parser, PopulationTask.inputs)
    parser.require("template")
    options.add_workers(parser)
    options.add_folder(parser, is_required=True)


def run(arguments: argparse.Namespace) -> int:
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
    out = solve.Outputs(files, {"subjects": table}, options.view_of(arguments))
    outputs.check_folder(files[0])
    solved = solve.solve(replace(task, cluster=cluster), out, arguments.quiet, folder)
    facts = {
        "table": printable(Path(arguments.table).name),
        "template": printable(Path(arguments.template).name),
        **solved.to_dict(),
    }
    written = [*solved.outputs, folder / "population.html"]
    drawn = _drawn(solved.result, arguments)
    outputs.write_text(written[-1], population_page(facts, solved.result.facts, drawn))
    if arguments.json:
        print(json.dumps(facts | {"outputs": list(map(str, written))}))
    else:
        report = PopulationTask.report.lines(solved.result)
        print(replace(solved, outputs=written).summary(report))
    return solved.status


def _drawn(found: Population, arguments: argparse.Namespace) -> pictures.PopulationPictures | None:
    if arguments.no_pictures:
        return None
    try:
        with share_progress("page", arguments.quiet) as report:
            return pictures.population_pictures(
                found, _PICTURE_WIDTH, options.view_of(arguments), report
            )
    except DrawingError as error:
        print_note(f"the page has no pictures: {error}")
        return None
