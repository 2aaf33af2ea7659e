"""The command line as a whole: which commands there are, and how one is chosen."""

from importlib import import_module
from importlib.metadata import version
from typing import Any

from abfm.errors import did_you_mean
from abfm_viewer.cli.options import Parser

_COMMANDS = {
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
    "bench": "bench",
}
"""The module of each, or the task that it solves; loaded when it is called, or when all are listed,
as together they take as long as a short match.
"""
_DESCRIPTION = """\
Match two functions on a triangle mesh: find the vector field whose flow carries the one to the
other. Register one surface to another by functions on both.

Try `abfm demo` first; then
  abfm match mesh.off --source gaussian:vertex=10 --target gaussian:vertex=200 --out match.npz
  abfm render match.npz --out match.png
"""


def run(words: list[str]) -> int:
    parser = Parser(prog="abfm", description=_DESCRIPTION)
    parser.add_argument("--version", action="version", version=f"abfm {version('abfm')}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name in [word for word in words[:1] if word in _COMMANDS] or _COMMANDS:
        command = _command(_COMMANDS[name])
        own = commands.add_parser(name, help=command.SUMMARY, description=command.DESCRIPTION)
        own.set_defaults(run=command.run, parser=own)
        command.add_arguments(own)
    if not words:
        parser.print_help()
        return 0
    if not words[0].startswith("-") and words[0] not in _COMMANDS:
        parser.error(f"there is no command {words[0]!r}{did_you_mean(words[0], _COMMANDS)}")
    arguments = parser.parse_whole(words)
    return int(arguments.run(arguments))


def _command(name: str) -> Any:
    module, is_task, task = name.partition(":")
    if not is_task:
        return import_module(f"abfm_viewer.cli.{module}")
    # with the library's solver, which other commands do not need
    from abfm_viewer.cli.solve import Command

    return Command(getattr(import_module(module), task))
