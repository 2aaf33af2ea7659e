"""`abfm sweep`: one match with all combinations of some options."""

import argparse
import csv
import re
import shlex
from pathlib import Path
from typing import Any

from abfm.batch import combinations
from abfm.batch.columns import MESH_OPTIONS
from abfm.errors import ParameterError, brief, did_you_mean, printable
from abfm.parameters import FIELDS, option
from abfm_viewer.cli import options
from abfm_viewer.cli.batches.running import add_cluster, solve
from abfm_viewer.cli.exit_status import UsageError
from abfm_viewer.cli.match import add_problem

SUMMARY = "solve all combinations of some options' values"
DESCRIPTION = """\
Match with all combinations of some options' values: a table of problems as `abfm batch` has it,
which is made of the options, with the same output and exit status.

Examples:
  abfm sweep spot.obj --source gaussian:vertex=12 --target gaussian:vertex=900 \\
      --over alpha=0.003,0.01,0.03 --over sigma=0.01,0.1 --out sweep
  abfm sweep spot.obj --source hks:time=0.01 \\
      --over 'target=eigenfunction:3,"gaussian:vertex=7,width=0.2"' --out targets
"""
_OWN = ("source", "target", "mask", "start", *MESH_OPTIONS, "max-distortion")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    options.add_mesh(parser)
    add = options.adder(parser)
    add(
        "--over",
        "values of an option, repeatable; one that has a comma itself stands in double quotes",
        "NAME=A,B,...",
        action="append",
        required=True,
    )
    add_problem(parser)
    options.add_max_distortion(options.adder(parser.add_argument_group("distortion")))
    add_cluster(parser)


def run(arguments: argparse.Namespace) -> int:
    """Make the table and solve it."""
    if arguments.out is None:
        raise UsageError("--out is missing: the folder of the results")
    over: dict[str, list[str]] = {}
    for word in arguments.over:
        name, values = _swept(word)
        if name in over:
            raise UsageError(f"--over {name} is given twice; give all its values in one")
        over[name] = values
    try:
        rows = combinations(_fixed(arguments), over)
    except ParameterError as error:
        raise UsageError(re.sub("^column ", "--", str(error))) from error
    if "largest-component" not in over:
        options.mesh(arguments)  # refused here, it would fail every row
    title = f"{printable(Path(arguments.mesh).name)}, over {' and '.join(over)}"
    return solve(rows, title, arguments)


def _fixed(arguments: argparse.Namespace) -> list[tuple[str, Any]]:
    """Return the options that were given, which all rows share."""
    given = vars(arguments)
    found = [("mesh", arguments.mesh)]
    found += [(name, given[name.replace("-", "_")]) for name in _OWN]
    found += [("channel", shlex.join(words)) for words in arguments.channel]
    for name, value in options.given_parameters(arguments).items():
        found.append((option(name), "auto" if value is None else value))
    return [(name, value) for name, value in found if value is not None and value is not False]


def _swept(word: str) -> tuple[str, list[str]]:
    """Read ``NAME=A,B,...``."""
    names = [*_OWN, *map(option, FIELDS)]
    name, sign, text = word.partition("=")
    name = option(name.strip().lower().removeprefix("--"))
    if not (sign and name):
        raise UsageError(f"--over {brief(word)} is not NAME=A,B,...")
    if name not in names:
        raise UsageError(
            f"--over: a match has no option {brief(name)} to vary{did_you_mean(name, names)}"
        )
    try:
        (values,) = csv.reader([text], skipinitialspace=True, strict=True)
    except (csv.Error, ValueError):
        values = []
    values = [value.strip() for value in values]
    if not values or not all(values):
        raise UsageError(f"--over {brief(word)}: expected values with commas between")
    if len(set(values)) < len(values):
        raise UsageError(f"--over {brief(word)} has a value twice")
    return name, values
