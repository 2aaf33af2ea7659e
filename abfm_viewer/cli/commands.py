"""The commands of `abfm`, and how a command line selects one."""

import argparse
from importlib import import_module
from importlib.metadata import version
from typing import Any

from abfm.errors import did_you_mean
from abfm_viewer.cli.options import Parser

COMMANDS = {
    "match": "abfm.matching.task:MatchTask",
    "register": "abfm.registration.task:RegistrationTask",
    "symmetric": "abfm.registration.symmetric:SymmetricTask",
    "sequence": "abfm.sequences.task:SequenceTask",
    "batch": "batch",
    "population": "population",
    "apply": "apply",
    "demo": "demo",
    "figure": "figure",
    "map": "map",
    "render": "render",
    "report": "report",
    "info": "info",
    "explain": "explain",
    "bench": "bench",
}
"""The module of each command, or the task that it solves. A module is imported when its command is
called or when all commands are listed; all together take as long as a short match.
"""
_INTRODUCTION = """\
Match functions on triangle meshes: find the tangent vector field whose flow transports one function
to another. Register surfaces, and follow functions in time, by the same method.

Examples:
  abfm demo
  abfm match mesh.off --source gaussian:vertex=10 --target gaussian:vertex=200 --out match.npz
  abfm render match.npz --out match.png

"""
_DESCRIPTION = f"""\
{_INTRODUCTION}`abfm COMMAND --help` shows the main options of a command, `--help-all` all.
The window is `abfm-viewer`.

commands:
"""


def run(words: list[str]) -> int:
    if not words:
        print(f"{_INTRODUCTION}`abfm --help` lists all commands. The window is `abfm-viewer`.")
        return 0
    parser = Parser(prog="abfm", description=_DESCRIPTION)
    about = "show the version and exit"
    parser.add_argument(
        "--version", action="version", version=f"abfm {version('abfm')}", help=about
    )
    commands = parser.add_subparsers(
        prog="abfm", metavar="COMMAND", required=True, help=argparse.SUPPRESS
    )
    lines = []
    for name in [word for word in words[:1] if word in COMMANDS] or COMMANDS:
        command = load(name)
        own = commands.add_parser(
            name,
            description=command.DESCRIPTION,
            details=getattr(command, "DETAILS", ""),
            main=getattr(command, "MAIN_OPTIONS", ()),
        )
        own.set_defaults(run=command.run, parser=own)
        lines.append(f"  {name:<12}{command.SUMMARY}")
        command.add_arguments(own)
    parser.description = _DESCRIPTION + "\n".join(lines)
    if not words[0].startswith("-") and words[0] not in COMMANDS:
        parser.error(f"unknown command {words[0]!r}{did_you_mean(words[0], COMMANDS)}")
    arguments = parser.parse_all(words)
    return int(arguments.run(arguments))


def load(name: str) -> Any:
    """Import the command of a name; return its module, or its `Command` if it solves a task."""
    module, is_task, task = COMMANDS[name].partition(":")
    if not is_task:
        return import_module(f"abfm_viewer.cli.{module}")
    # it imports the solver, which other commands do not need
    from abfm_viewer.cli.solve import Command

    return Command(getattr(import_module(module), task))
