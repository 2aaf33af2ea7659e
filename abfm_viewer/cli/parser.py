"""An argument parser whose errors are one line with the nearest right word."""

import argparse
from typing import Any, NoReturn

from abfm.errors import did_you_mean
from abfm_viewer.cli.exit_status import UsageError


class Parser(argparse.ArgumentParser):
    """Raises `UsageError` instead of printing the whole usage and leaving."""

    # argparse has its own for subcommands
    def __init__(self, prog: str, description: str, **settings: Any) -> None:
        super().__init__(
            prog,
            description=description,
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
            **settings,
        )

    def error(self, message: str) -> NoReturn:
        """Refuse the command line."""
        raise UsageError(f"{message}; see {self.prog} --help")

    def parse_whole(self, words: list[str]) -> argparse.Namespace:
        """Parse a command line of which every word must be understood; its `parser` is the one
        in charge.
        """
        arguments, unknown = self.parse_known_args(words)
        if unknown:
            command: Parser = arguments.parser
            name = unknown[0].partition("=")[0]
            command.error(
                f"{unknown[0]!r} is not "
                f"understood{did_you_mean(name, command._option_string_actions)}"
            )
        return arguments
