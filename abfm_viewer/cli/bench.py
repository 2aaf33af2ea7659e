"""`abfm bench`: the solver against what a user would compare it with."""

import argparse
import json
import os
import sys
from importlib.util import find_spec
from pathlib import Path

from abfm import Control, TriangleMesh
from abfm.errors import brief
from abfm_viewer.cli.batches.running import add_workers, cluster_of
from abfm_viewer.cli.exit_status import UsageError
from abfm_viewer.cli.interrupts import Interrupt, cancelled_by_signals
from abfm_viewer.cli.options import adder, count, positive, seed
from abfm_viewer.files import outputs

_MEASUREMENTS = ("viewer", "success", "measured", "arrival")
_OPTIONS = {
    ("success",): ("versions", "solvable"),
    ("success", "measured"): (
        "meshes",
        "only_given",
        "problems",
        "seed",
        "part",
        "out",
        "jobs",
        "scheduler",
        "scheduler_file",
    ),
}
"""Options by the measurements of which one is needed."""

SUMMARY = (
    "measure the solver against the paper's algorithm and plain L-BFGS, or how often it succeeds"
)
DESCRIPTION = """\
Measure the solver against the paper's algorithm and plain L-BFGS, how it scales, and what its
gradient costs.

Takes about four minutes, alone on the machine: most of it is the time that the baselines get. With
--viewer it measures the window instead: how long it takes to open, what it costs the solver, and
how even its frames are during a solve.

With --success it tries random problems on many meshes, near and far, wide and narrow, and counts
how often the solver succeeds with its default parameters and how often it did as it was before:
about ten minutes. A success leaves at most 0.05 by both witnesses, the discrete flow and flow
lines; beside it stands how often flow lines leave at most 0.1. Every problem is a row of a batch,
solved to its end on all cores, or by --jobs or a cluster, and the same whatever else runs, but for
its seconds: for those take --jobs 1, alone on the machine. After Ctrl-C it reports what is
finished; with --out the same again goes on with what is missing.

With --measured it matches functions as measured ones are: random smooth textures, carried along
random flows that are known, with 20% of noise. It tells how far the map that the defaults find is
from the true one, beside the best of six values of sigma: about ten minutes. Rows of a
batch, as above.

With --arrival it measures how soon a match is there on ever finer meshes, now and as it was before:
a few minutes.

Examples:
  abfm bench --json > bench.json
  abfm bench --arrival
  abfm bench --viewer
  abfm bench --success
  abfm bench --success --out trials --jobs 2
  abfm bench --success --only-given --meshes a.off --problems 10 --part 1/2 --json 1.json
  abfm bench --success --versions now --only-given --meshes humans/ others/ --json now.json
  abfm bench --measured --only-given --meshes humans/ --problems 2
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = adder(parser)
    add("--seconds", "time for each baseline (default: 60)", "S", type=positive, default=60.0)
    add("--viewer", "measure the window (off the screen where there is none)")
    add("--success", "count on random problems how often matches succeed")
    add("--measured", "measure errors of maps between noisy functions, whose truth is known")
    add("--arrival", "measure how soon a match arrives on ever finer meshes")
    choose = adder(parser.add_argument_group("with --success or --measured"))
    choose(
        "--meshes",
        "try these meshes, too: files, and folders, each with lines of its own; they are merged, "
        "cleaned or cut as needed, and what cannot be loaded is named and left out",
        "PATH",
        nargs="+",
        type=Path,
        default=[],
    )
    choose("--only-given", "leave out the bundled and generated meshes")
    choose(
        "--versions",
        "with --success: before, now or both, the default; before takes long",
        "NAME",
        nargs="+",
        choices=("before", "now"),
        default=("before", "now"),
    )
    choose("--solvable", "with --success: only problems that are not known to be in any flow's way")
    choose("--problems", "problems on each mesh (default: 6)", "N", type=count, default=6)
    choose("--seed", "another number gives other problems (default: 0)", type=seed, default=0)
    choose("--part", "only every N-th problem, from the K-th", "K/N", type=_part, default=(1, 1))
    choose("--out", "folder for results, to go on with", "DIR", type=Path)
    add("--json", "print one JSON object, or write it to FILE", "FILE", nargs="?", const="")
    add("--quiet", "no progress")
    add_workers(parser)


def run(arguments: argparse.Namespace) -> int:
    _check(arguments)
    import laboratory

    interrupt, control = Interrupt(), Control()
    out = Path(arguments.json) if arguments.json else None
    if out is not None:
        outputs.check(out, [".json"])

    def tell(line: str) -> None:
        if not arguments.quiet:
            print(line, file=sys.stderr, flush=True)

    if arguments.success or arguments.measured:
        success, measured = laboratory.success, laboratory.measured
        selection = success.Selection(
            arguments.seed, arguments.problems, arguments.part, arguments.solvable
        )
        place = laboratory.trials.Place(arguments.out, cluster_of(arguments), control)
        meshes = _meshes(arguments)
        with cancelled_by_signals(control, "with what was finished") as interrupt:
            if arguments.success:
                versions = {name: success.VERSIONS[name] for name in sorted(arguments.versions)}
                report = success.run_success(meshes, tell, selection, versions, place)
                text = success.format_success(report)
            else:
                report = measured.run_measured(meshes, tell, selection, place)
                text = measured.format_measured(report)
    elif arguments.arrival:
        report = laboratory.run_arrival(tell)
        text = laboratory.format_arrival(report)
    elif arguments.viewer:
        report = laboratory.window.run(tell)
        text = laboratory.window.format_report(report)
    else:
        report = laboratory.run(tell, laboratory.Settings(arguments.seconds))
        text = laboratory.format_report(report)
    as_json = json.dumps(report, allow_nan=False)
    if out is not None:
        outputs.write_text(out, as_json)
    print(as_json if arguments.json == "" else text)
    return interrupt.status or 0


def _check(arguments: argparse.Namespace) -> None:
    if find_spec("laboratory") is None:
        raise UsageError(
            "measurements are run from the repository, and this is an installation without it: "
            "clone it, and type ./run once, then .venv/bin/abfm bench"
        )
    chosen = [f"--{name}" for name in _MEASUREMENTS if getattr(arguments, name)]
    if len(chosen) > 1:
        raise UsageError(f"{chosen[0]} and {chosen[1]} are two measurements; choose one of them")
    for measurements, options in _OPTIONS.items():
        given = [each for each in options if getattr(arguments, each) != _default(arguments, each)]
        if given and not any(getattr(arguments, each) for each in measurements):
            needed = " or ".join(f"--{each}" for each in measurements)
            raise UsageError(f"--{given[0].replace('_', '-')} goes with {needed}; add it")
    if chosen and arguments.seconds != _default(arguments, "seconds"):
        raise UsageError(f"--seconds does not go with {chosen[0]}; leave it out")
    for path in arguments.meshes:
        if not os.path.exists(path):
            raise UsageError(
                f"--meshes: there is no {brief(str(path))}; expected meshes or folders of meshes"
            )


def _default(arguments: argparse.Namespace, name: str) -> object:
    return arguments.parser.get_default(name)


def _meshes(arguments: argparse.Namespace) -> dict[str, TriangleMesh]:
    """Return the meshes that a command line asks for."""
    import laboratory

    meshes = laboratory.meshes
    own: dict[str, TriangleMesh] = {}
    if not arguments.only_given:
        own = meshes.own_meshes() if arguments.success else meshes.few_meshes()
    given = meshes.given_meshes(arguments.meshes, lambda line: print(line, file=sys.stderr))
    twice = sorted(own.keys() & given.keys())
    if twice:
        raise UsageError(f"{twice[0]} is the name of a bundled mesh, too: rename the file")
    if not own | given:
        raise UsageError("--only-given needs --meshes that can be loaded")
    return own | given


def _part(text: str) -> tuple[int, int]:
    k, slash, n = text.partition("/")
    if not (slash and count(k) <= count(n)):
        raise argparse.ArgumentTypeError(f"{text!r} is not a part such as 1/2")
    return int(k), int(n)
