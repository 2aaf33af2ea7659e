"""`abfm explain`: the meaning of verdicts, warnings, numbers and parameters."""

import argparse
import shutil
import textwrap
from pathlib import Path

from abfm import explanations
from abfm.errors import printable
from abfm.outcome import Facts, Outcome
from abfm.wording import capital
from abfm_viewer.cli import options
from abfm_viewer.cli.exit_status import UsageError

SUMMARY = "explain a verdict, a warning, a number or a parameter"
DESCRIPTION = """\
Explain outcomes, causes and warnings, with the next steps, and also numbers and parameters. The
last line of a report names those of its result. Without a name, list all of them.

Examples:
  abfm explain
  abfm explain values-differ
  abfm explain residual
"""
_WIDTH_MAX = 100


def add_arguments(parser: options.Parser) -> None:
    add = options.adder(parser)
    about = "outcomes, causes, warnings, numbers or parameters"
    add("names", about, "[NAME...]", nargs="*", default=[])


def run(arguments: argparse.Namespace) -> int:
    if files := [printable(name) for name in arguments.names if Path(name).suffix]:
        raise UsageError(f"{files[0]} is a file; abfm info {files[0]} prints the names to explain")
    joined = " ".join(arguments.names)  # a name of several words without hyphens
    is_one = explanations.slug(joined) in map(explanations.slug, explanations.names())
    texts = [_explanation(name) for name in ([joined] if is_one else arguments.names)]
    print("\n\n".join(texts) if texts else _overview())
    return 0


def help_lines(facts: Facts) -> list[str]:
    """Return the line with the `abfm explain` command for a result.

    The list is empty if the result needs no explanation.
    """
    is_plain = facts.outcome in (Outcome.MATCHED, Outcome.REGISTERED)
    topics = (facts.topics[1:] if is_plain else ()) or facts.topics  # only the warnings
    names = " ".join(map(explanations.slug, topics))
    return [f"help: abfm explain {names}"] if facts.needs_help else []


def _explanation(name: str) -> str:
    width = min(shutil.get_terminal_size().columns, _WIDTH_MAX)
    lines = [capital(explanations.title(name)), ""]
    for text in explanations.paragraphs(name):
        is_item = text.startswith("- ")
        if is_item and lines[-2].startswith(("- ", "  ")):
            lines.pop()  # no empty line between the items of a list
        lines += [*textwrap.wrap(text, width, subsequent_indent="  " * is_item), ""]
    return "\n".join(lines[:-1])


def _overview() -> str:
    blocks = []
    for group, names in explanations.groups().items():
        lines = (f"  {explanations.slug(n):<25}{explanations.summary(n)}" for n in names)
        blocks.append("\n".join([f"{group}:", *lines]))
    return "\n\n".join(blocks)
