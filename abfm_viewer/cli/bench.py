"""`abfm bench`: the solver against what a user would compare it with."""

import argparse
import json
import sys
from importlib.util import find_spec
from pathlib import Path

from abfm import Control, TriangleMesh, load_mesh
from abfm_viewer import signals
from abfm_viewer.cli.exit_status import UsageError
from abfm_viewer.cli.match import Kept, cancelled_by_signals
from abfm_viewer.cli.options import adder, count, positive, seed

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
about ten minutes. Every problem is the same whatever else runs. After Ctrl-C it reports what is
finished.

With --arrival it measures how soon a match is there on ever finer meshes, now and as it was before:
a few minutes.

Examples:
  abfm bench --json > bench.json
  abfm bench --arrival
  abfm bench --viewer
  abfm bench --success
  abfm bench --success --only-given --mesh a.off --problems 10 --part 1/2 --json > 1.json
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = adder(parser)
    add("--seconds", "time for each baseline (default: 60)", "S", type=positive, default=60.0)
    add("--viewer", "measure the window (off the screen where there is none)")
    add("--success", "count on random problems how often matches succeed")
    add("--arrival", "measure how soon a match arrives on ever finer meshes")
    choose = adder(parser.add_argument_group("with --success"))
    choose("--mesh", "try this mesh too; may be repeated", "FILE", action="append", default=[])
    choose("--only-given", "leave out the bundled and generated meshes")
    choose("--problems", "problems on each mesh (default: 6)", "N", type=count, default=6)
    choose("--seed", "another number gives other problems (default: 0)", type=seed, default=0)
    choose("--part", "only every N-th problem, from the K-th", "K/N", type=_part, default=(1, 1))
    add("--json", "print one JSON object")
    add("--quiet", "no progress")


def run(arguments: argparse.Namespace) -> int:
    if find_spec("laboratory") is None:
        raise UsageError(
            "measurements are run from the repository, and this is an installation without it: "
            "clone it, and type ./run once, then .venv/bin/abfm bench"
        )
    import laboratory

    kept, control = Kept(), Control()

    def tell(line: str) -> None:
        if not arguments.quiet:
            print(line, file=sys.stderr, flush=True)

    if arguments.success:
        success = laboratory.success
        meshes = _meshes(arguments, {} if arguments.only_given else success.success_meshes())
        selection = success.Selection(arguments.seed, arguments.problems, arguments.part)
        with cancelled_by_signals(control, "with what was finished") as kept:
            report = success.run_success(meshes, tell, selection, stopped=lambda: control.cancelled)
        text = success.format_success(report)
    elif arguments.arrival:
        report = laboratory.run_arrival(tell)
        text = laboratory.format_arrival(report)
    elif arguments.viewer:
        report = laboratory.window.run(tell)
        text = laboratory.window.format_report(report)
    else:
        report = laboratory.run(tell, laboratory.Settings(arguments.seconds))
        text = laboratory.format_report(report)
    print(json.dumps(report, allow_nan=False) if arguments.json else text)
    return 0 if kept.number is None else signals.status(kept.number)


def _meshes(
    arguments: argparse.Namespace, meshes: dict[str, TriangleMesh]
) -> dict[str, TriangleMesh]:
    """Add the meshes that a command line gives to these; a file's name is the mesh's."""
    found = dict(meshes)
    for path in arguments.mesh:
        name = Path(path).name
        if name in found:
            raise UsageError(
                f"two meshes are called {name}: rename one, as problems are told apart by the name"
            )
        found[name] = load_mesh(path, largest_component=True)
    if not found:
        raise UsageError("--only-given needs a --mesh")
    return found


def _part(text: str) -> tuple[int, int]:
    k, slash, n = text.partition("/")
    if not (slash and count(k) <= count(n)):
        raise argparse.ArgumentTypeError(f"{text!r} is not a part such as 1/2")
    return int(k), int(n)
