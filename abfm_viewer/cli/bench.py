"""`abfm bench`: benchmarks of the solver and of the window."""

import argparse
import json
import os
import sys
from importlib.util import find_spec
from pathlib import Path

from abfm import TriangleMesh
from abfm.errors import brief
from abfm.workers import Control
from abfm_viewer.cli.exit_status import Interrupt, UsageError, cancelled_by_signals
from abfm_viewer.cli.options import add_workers, adder, cluster_of, count, positive, seed
from abfm_viewer.files import outputs

_WORKERS = ("jobs", "scheduler", "scheduler_file")
_TRIALS = ("meshes", "only_given", "problems", "seed", "out", *_WORKERS)
_OPTIONS = {"viewer": (), "success": ("solvable", *_TRIALS), "measured": _TRIALS, "arrival": ()}
"""Options of each benchmark besides --json and --quiet."""

SUMMARY = "benchmark the solver, its success rate, map errors and the window"
DESCRIPTION = """\
Compare the solver with the algorithm of the paper and with plain L-BFGS, on meshes of increasing
size. This takes about four minutes; run it alone on the machine. Other benchmarks:
  --success   count matches of random problems with default parameters (about ten minutes)
  --measured  measure errors of maps between noisy functions with a known map (about ten minutes)
  --arrival   measure the seconds to a match on finer and finer meshes (a few minutes)
  --viewer    measure the window: launch, frames during a match, and solver speed

Examples:
  abfm bench --json > bench.json
  abfm bench --success --out trials --jobs 2
  abfm bench --success --only-given --meshes humans/ others/ --json success.json
  abfm bench --measured --only-given --meshes humans/ --problems 2
"""
DETAILS = """\
With --success, a match succeeds if its residuals, by the discrete flow and along flow lines, are at
most 0.05.
With --measured, the default parameters are compared with the best of six values of sigma.

The problems of --success and --measured are rows of a batch. All cores solve them, or --jobs
processes, or a cluster. All numbers except seconds are the same in every run; use --jobs 1 to
measure seconds. After Ctrl-C the report has the finished problems. With --out, the same command
resumes.
"""
MAIN_OPTIONS = (
    "success",
    "measured",
    "arrival",
    "viewer",
    "meshes",
    "only-given",
    "problems",
    "jobs",
    "out",
    "json",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = adder(parser)
    about = "seconds for each compared method (default: 60)"
    add("--seconds", about, "S", type=positive, default=60.0)
    add("--viewer", "measure the window, off-screen if there is no screen")
    add("--success", "count matches of random problems")
    add("--measured", "measure errors of maps between noisy functions")
    add("--arrival", "measure the seconds to a match on finer and finer meshes")
    choose = adder(parser.add_argument_group("with --success or --measured"))
    about = (
        "also use these meshes, files or folders, each folder with its own rows. Meshes are "
        "merged, cleaned or cut if needed. Files that cannot be loaded are reported and skipped"
    )
    choose("--meshes", about, "PATH", nargs="+", type=Path, default=[])
    choose("--only-given", "skip the bundled and generated meshes")
    choose("--solvable", "with --success: skip problems that are known to be unsolvable")
    choose("--problems", "number of problems per mesh (default: 6)", "N", type=count, default=6)
    choose("--seed", "seed of the random problems (default: 0)", type=seed, default=0)
    choose("--out", "folder for the results, from which later runs resume", "DIR", type=Path)
    about = "print the report as one JSON object, or write it to FILE"
    add("--json", about, "FILE", nargs="?", const="")
    add("--quiet", "do not show progress")
    add_workers(parser)


def run(arguments: argparse.Namespace) -> int:
    _check(arguments)
    from benchmarks import arrival, map_errors, solver, success, window
    from benchmarks.trials import Trials

    interrupt, control = Interrupt(), Control()
    out = Path(arguments.json) if arguments.json else None
    if out is not None:
        outputs.check(out, [".json"])

    def log(line: str) -> None:
        if not arguments.quiet:
            print(line, file=sys.stderr, flush=True)

    if arguments.success or arguments.measured:
        of_run = arguments.seed, arguments.problems, arguments.out, cluster_of(arguments)
        trials = Trials(_meshes(arguments), log, *of_run, control)
        with cancelled_by_signals(control, "with the finished problems") as interrupt:
            if arguments.success:
                report = success.run(trials, arguments.solvable)
                text = success.report_text(report)
            else:
                report = map_errors.run(trials)
                text = map_errors.report_text(report)
    elif arguments.arrival:
        report = arrival.run(log)
        text = arrival.report_text(report)
    elif arguments.viewer:
        report = window.run(log)
        text = window.report_text(report)
    else:
        report = solver.run(log, solver.Settings(arguments.seconds))
        text = solver.report_text(report)
    as_json = json.dumps(report, allow_nan=False)
    if out is not None:
        outputs.write_text(out, as_json)
    print(as_json if arguments.json == "" else text)
    return interrupt.status or 0


def _check(arguments: argparse.Namespace) -> None:
    # other projects also install a package of this name
    if find_spec("benchmarks") is None or find_spec("benchmarks.paper_algorithm") is None:
        raise UsageError(
            "benchmarks need the repository, which this installation lacks; clone it, run ./run "
            "once, then .venv/bin/abfm bench"
        )
    modes = [name for name in _OPTIONS if getattr(arguments, name)]
    if len(modes) > 1:
        raise UsageError(
            f"--{modes[0]} and --{modes[1]} are different benchmarks; give one of them"
        )
    allowed = _OPTIONS[modes[0]] if modes else ("seconds",)
    for name in ("seconds", *_OPTIONS["success"]):
        if name not in allowed and getattr(arguments, name) != arguments.parser.get_default(name):
            option = f"--{name.replace('_', '-')}"
            needed = " or ".join(f"--{mode}" for mode, own in _OPTIONS.items() if name in own)
            advice = f"needs {needed}" if needed else f"has no effect with --{modes[0]}"
            raise UsageError(f"{option} {advice}")
    for path in arguments.meshes:
        if not os.path.exists(path):
            raise UsageError(
                f"--meshes: {brief(str(path))} does not exist; expected meshes or folders of meshes"
            )


def _meshes(arguments: argparse.Namespace) -> dict[str, TriangleMesh]:
    from benchmarks.meshes import bundled_meshes, given_meshes, three_meshes

    own: dict[str, TriangleMesh] = {}
    if not arguments.only_given:
        own = bundled_meshes() if arguments.success else three_meshes()
    given = given_meshes(arguments.meshes, lambda line: print(line, file=sys.stderr))
    repeated = sorted(own.keys() & given.keys())
    if repeated:
        raise UsageError(f"{repeated[0]} is also the name of a bundled mesh; rename the file")
    if not own | given:
        raise UsageError("--only-given needs --meshes with at least one mesh that can be loaded")
    return own | given
