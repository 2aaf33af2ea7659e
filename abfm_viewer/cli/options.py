"""The parser, whose errors are one line, and options that several commands share."""

import argparse
import math
import re
import shlex
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

import abfm
from abfm.batch.cluster import Cluster
from abfm.errors import ParameterError, brief, did_you_mean, one_line
from abfm.mesh.options import MERGE, MeshOptions
from abfm.parameters import FIELDS, MAIN_FIELDS, option
from abfm.tasks.inputs import MESH_INPUTS, Input, by_name
from abfm.tasks.inputs import mesh_options as options_in
from abfm_viewer.cli.exit_status import UsageError, print_note

OUTPUT = "output"
"""Heading of options about files."""
_DISTANCE = re.compile(r"auto|[-+.\d][-+.\de]*", re.IGNORECASE)


class Parser(argparse.ArgumentParser):
    """Raises `UsageError` with the nearest right word, and does not print the usage and leave."""

    # argparse has its own for subcommands
    def __init__(self, prog: str, description: str, **settings: Any) -> None:
        form = argparse.RawDescriptionHelpFormatter
        settings |= {"formatter_class": form, "allow_abbrev": False}
        super().__init__(prog, description=description, **settings)

    def error(self, message: str) -> NoReturn:
        raise UsageError(f"{message}; see {self.prog} --help")

    def parse_whole(self, words: list[str]) -> argparse.Namespace:
        """Parse words that must all be understood; the `parser` of the result is in charge."""
        arguments, unknown = self.parse_known_args(_with_distance(words))
        if unknown:
            command: Parser = arguments.parser
            name = unknown[0].partition("=")[0]
            hint = did_you_mean(name, command._option_string_actions)
            setting = name.removeprefix("--").replace("-", "_")
            if setting in FIELDS and "--set" in command._option_string_actions:
                hint = f"; write --set {setting}=VALUE"
            command.error(f"{unknown[0]!r} is not understood{hint}")
        return arguments


def _with_distance(words: list[str]) -> list[str]:
    """Return the words with ``--merge=auto`` for a ``--merge`` that no distance follows."""
    found = []
    for word, following in zip(words, [*words[1:], ""], strict=False):
        is_alone = word == f"--{MERGE}" and not _DISTANCE.fullmatch(following)
        found.append(f"{word}=auto" if is_alone else word)
    return found


def adder(to: argparse._ActionsContainer) -> Callable[..., None]:
    """Return a short `add_argument`; an option without metavar and settings is a flag."""

    def add(name: str, help: str, metavar: object = None, **settings: Any) -> None:
        value = {"metavar": metavar} if metavar or settings else {"action": "store_true"}
        to.add_argument(name, help=help, **(value | settings))

    return add


def add_up(add: Callable[..., None]) -> None:
    """Declare the axis that points upwards on pictures and pages."""
    about = "axis that points upwards on pictures and pages (default: z, seen from the side, for a"
    add("--up", f"{about} cortex of known hemisphere; otherwise y)", choices=("x", "y", "z"))


def add_folder(parser: argparse.ArgumentParser, is_required: bool = False) -> None:
    """Declare the folder of many results, and what is reported of them."""
    add = adder(parser.add_argument_group(OUTPUT))
    about = "folder for results: made if it is not there"
    add("--out", about, "DIR", type=folder, required=is_required)
    add_up(add)
    add("--no-pictures", "a page without pictures")
    add_report(add)


def add_report(add: Callable[..., None]) -> None:
    """Declare how a result is reported."""
    add("--json", "print one JSON object about the result")
    add("--quiet", "no progress")


def add_workers(parser: argparse.ArgumentParser) -> None:
    """Declare who solves."""
    add = adder(parser.add_argument_group("who solves"))
    what = "so many processes of this machine (default: one for each core)"
    add("--jobs", what, "N", type=processes)
    what = (
        "a Dask cluster's scheduler instead, such as tcp://10.0.0.1:8786; whoever controls it can "
        "run programs on this machine and on its workers: use one that you trust"
    )
    add("--scheduler", what, "ADDRESS", type=address)
    add("--scheduler-file", "the same by the file in which it has its address", "FILE", type=Path)


def cluster_of(arguments: argparse.Namespace) -> Cluster:
    """Return who solves."""
    given = arguments.jobs, arguments.scheduler, arguments.scheduler_file
    if sum(each is not None for each in given) > 1:
        raise UsageError("give one of --jobs, --scheduler and --scheduler-file, or none")
    return Cluster(*given)


def add_inputs(
    parser: argparse.ArgumentParser, inputs: Sequence[Input], without: Iterable[str] = ()
) -> None:
    """Declare an option, or an argument, for each input; `given_texts` returns their texts."""
    groups: dict[str, argparse._ActionsContainer] = {"": parser}
    rare = [each for each in inputs if each.is_rare]
    for each in inputs:
        if each.name in without or each.is_rare:
            continue
        if each.group not in groups:
            groups[each.group] = parser.add_argument_group(each.group)
        help = f"{each.help} (default: {each.default})" if each.default else each.help
        help += "; repeatable" if each.repeats else ""
        words = each.metavar.split()
        settings: dict[str, Any] = {"help": help.replace("%", "%%")}
        if not words:
            settings |= {"action": "store_const", "const": "yes"}
        elif len(words) > 1:
            settings |= {"metavar": tuple(words), "nargs": len(words)}
        else:
            settings |= {"metavar": each.metavar}
        if each.without_value:
            settings |= {"nargs": "?", "const": each.without_value}
        if each.repeats:
            settings |= {"action": "append", "default": []}
        name = each.name if each.is_argument else f"--{each.name}"
        groups[each.group].add_argument(name, **settings)
    if rare:
        names = ", ".join(each.name.replace("-", "_") for each in rare)  # which do not wrap
        text = f"set one of {names}, which the README describes; repeatable"
        add = adder(groups[rare[0].group])
        add("--set", text, "NAME=VALUE", action="append", default=[])


def given_texts(
    arguments: argparse.Namespace, inputs: Sequence[Input]
) -> Iterator[tuple[str, str]]:
    """Yield the names and texts of the inputs that were given."""
    rare, settings = by_name(each for each in inputs if each.is_rare), dict[str, str]()
    own = [option(name) for name in MAIN_FIELDS]
    for word in arguments.set if rare else ():
        name, sign, text = word.partition("=")
        name = option(name.strip())
        if name in own:
            raise UsageError(f"--set {brief(word)}: {name} has its own option, --{name}")
        if name not in rare:
            nearest = did_you_mean(name, [*own, *rare]) or f"; expected one of {', '.join(rare)}"
            raise UsageError(f"--set: {brief(name)} is not known{nearest}")
        if not sign:
            raise UsageError(f"--set {brief(word)} is not NAME=VALUE")
        settings[name] = text.strip()  # the last one counts, as of options
    yield from settings.items()
    for each in inputs:
        if each.is_rare:
            continue
        given = getattr(arguments, each.name.replace("-", "_"), None)
        several = given or [] if each.repeats else [] if given is None else [given]
        for value in several:
            text = shlex.join(value) if isinstance(value, list) else value
            if not text.strip():
                raise UsageError(f"{shown(each)} is empty; give a value or leave it out")
            yield each.name, text


def shown(each: Input) -> str:
    """Return what an input is called on the command line."""
    return each.metavar if each.is_argument else f"--{each.name}"


def add_mesh_options(parser: argparse.ArgumentParser) -> None:
    """Declare how meshes are read."""
    add_inputs(parser, MESH_INPUTS)


def mesh_options(arguments: argparse.Namespace) -> MeshOptions:
    """Return how meshes are to be read."""
    inputs, values = by_name(MESH_INPUTS), dict[str, Any]()
    for name, text in given_texts(arguments, MESH_INPUTS):
        try:
            values[name] = inputs[name].read(text)
        except ParameterError as error:
            raise UsageError(f"--{name}: {error}") from None
    return options_in(values)


def load_result(path: str, *expected: type) -> Any:
    """Read a result of one of these types, and warn of what its field contradicts."""
    found = abfm.load(path, *expected)
    warn_if_recomputed(path, found)
    return found


def warn_if_recomputed(path: str, found: object) -> None:
    """Warn of values in a result's file that the field of its match contradicts."""
    match = getattr(found, "match", found)
    if load_warning := getattr(match, "load_warning", ""):
        text = f"values stored in {path} do not match its field and were recomputed: {load_warning}"
        print_note(text, "warning")


def size(text: str) -> tuple[int, int]:
    """Read a picture's size: ``1600x900``."""
    width, cross, height = text.partition("x")
    if not cross or not (width.isdecimal() and height.isdecimal()):
        raise argparse.ArgumentTypeError(f"{text!r} is not a size such as 1600x900")
    if not (320 <= int(width) <= 16384 and 240 <= int(height) <= 16384):
        raise argparse.ArgumentTypeError(f"{text!r} is out of range: from 320x240 to 16384x16384")
    return int(width), int(height)


def _within(
    kind: type[int] | type[float], least: float, most: float, expected: str, text: str
) -> float:
    try:
        value = kind(text)
    except ValueError:
        value = math.nan
    if not least <= value <= most:
        raise argparse.ArgumentTypeError(f"{one_line(text, 40) or repr(text)} is not {expected}")
    return value


# types for argparse
positive = partial(_within, float, math.ulp(0), 86400, "a number above 0 and at most 86400")
angle = partial(_within, float, -360_000, 360_000, "an angle up to 360000 degrees")
seed = partial(_within, int, 0, 1e39, "a whole number from 0 on")
count = partial(_within, int, 1, 1_000_000, "a whole number from 1 to 1000000")
processes = partial(_within, int, 1, 4096, "a number of processes, 1 to 4096")
width = partial(_within, int, 32, 2000, "a whole number from 32 to 2000")
texels = partial(_within, int, 4, 16384, "a whole number from 4 to 16384")


def folder(text: str) -> Path:
    """Read the name of a folder: an empty one, as of a variable that is not set, would be this."""
    if not text.strip():
        raise argparse.ArgumentTypeError(f"{text!r} names no folder; . is the present one")
    return Path(text)


def address(text: str) -> str:
    """Read a scheduler's address."""
    if not text.strip():
        raise argparse.ArgumentTypeError(f"{text!r} is no address, such as tcp://10.0.0.1:8786")
    return text
