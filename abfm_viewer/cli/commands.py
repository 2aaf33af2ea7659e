"""The command line as a whole: which commands there are, and how one is chosen."""

from importlib.metadata import version

from abfm.errors import did_you_mean
from abfm_viewer.cli import bench, demo, figure, info, match, render
from abfm_viewer.cli.batches import batch, sweep
from abfm_viewer.cli.films import sequence
from abfm_viewer.cli.options import Parser
from abfm_viewer.cli.populations import population
from abfm_viewer.cli.reports import report
from abfm_viewer.cli.surfaces import apply, map, register

_COMMANDS = {
    "match": match,
    "register": register,
    "sequence": sequence,
    "batch": batch,
    "sweep": sweep,
    "population": population,
    "apply": apply,
    "demo": demo,
    "figure": figure,
    "map": map,
    "render": render,
    "report": report,
    "info": info,
    "bench": bench,
}
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
    for name, command in _COMMANDS.items():
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
