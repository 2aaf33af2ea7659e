"""The parser, whose errors are one line, and options that several commands share."""

import argparse
import math
import os
import re
import sys
from collections.abc import Callable, Collection, Mapping
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

from abfm import Match, Parameters, TriangleMesh, load_mesh
from abfm.errors import ParameterError, brief, did_you_mean, one_line, printable
from abfm.functions import function
from abfm.functions.circular import split_channels
from abfm.functions.family import quoted
from abfm.mesh.options import MERGE, MeshOptions
from abfm.parameters import FIELDS, MAIN_FIELDS, is_whole, option
from abfm.reading.parameters import parameter_reader
from abfm.types import FloatArray
from abfm_viewer.cli.exit_status import UsageError

MESH = (
    "triangle mesh: obj, off, ply, stl, glb, gltf, gii, vtk, vtp, vtu, or of FreeSurfer or MNI; "
    "also compressed (.gz)"
)
_DISTANCE = re.compile(r"auto|[-+.\d][-+.\de]*", re.IGNORECASE)
_UNSET = object()
"""What an option is that was not given."""


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


def add_channels(parser: argparse.ArgumentParser, source: str, target: str) -> None:
    """Declare the options that `channels` reads."""
    add = adder(parser.add_argument_group("functions"))
    add("--source", source, "SPEC")
    add("--target", target, "SPEC")
    add(
        "--channel",
        "one more source and target for the same flow, with the weight of its mismatch; repeatable",
        ("SRC", "DST", "WEIGHT"),
        nargs=3,
        action="append",
        default=[],
    )
    add_circular(add)


def add_circular(add: Callable[..., None]) -> None:
    """Declare the period of values."""
    about = "values are phases, which repeat after this period, and are compared by their cosine"
    add(
        "--circular",
        f"{about} and sine (without a number: 2 pi)",
        "PERIOD",
        type=positive,
        nargs="?",
        const=math.tau,
    )


def channels(
    arguments: argparse.Namespace, may_lack: bool = False
) -> tuple[list[str], list[str], list[float]]:
    """Return sources, targets and weights; none only where they may be lacking."""
    if (arguments.source is None) != (arguments.target is None):
        raise UsageError("--source and --target need each other")
    first = [] if arguments.source is None else [(arguments.source, arguments.target, "1")]
    if not (found := [*first, *arguments.channel]) and not may_lack:
        raise UsageError(f"give --source and --target; see {arguments.parser.prog} --help")
    weights = []
    for *_, word in found:
        try:
            weights.append(float(word))
        except ValueError:
            raise UsageError(
                f"--channel: its third word is the weight, a number, not {brief(word)}"
            ) from None
    sources, targets = ([pair[side] for pair in found] for side in range(2))
    return split_channels(sources, targets, weights, arguments.circular)


def add_up(add: Callable[..., None]) -> None:
    """Declare the axis that points upwards on pictures and pages."""
    about = "axis that points upwards on pictures and pages (default: z, seen from the side, for a"
    add("--up", f"{about} cortex of known hemisphere; otherwise y)", choices=("x", "y", "z"))


def add_max_distortion(add: Callable[..., None]) -> None:
    add(
        "--max-distortion",
        "the closest field with |log2 J| of areas and |log2 R| of shapes at most N on 99%% of the "
        "faces, and none folded",
        "N",
        type=bound,
    )


def weight(mesh: TriangleMesh, given: str | None) -> FloatArray | None:
    """Return how much vertices count, (V,), by a function or its file."""
    if given is None:
        return None
    return function(mesh, f"file:{quoted(given)}" if os.path.isfile(given) else given)


def add_parameters(
    parser: argparse.ArgumentParser,
    usual: Parameters | None = None,
    names: Collection[str] = tuple(FIELDS),
    about: Mapping[str, str] | None = None,
) -> None:
    """Declare the parameters, or those of these names, with the help and symbol of their
    definition, for `given_parameters`. ``usual`` are the defaults that the help shows, and
    ``about`` replaces the help of some.
    """
    add = adder(parser.add_argument_group("parameters (symbols of the paper in brackets)"))
    defaults, chosen = (usual or Parameters()).to_dict(), getattr(usual, "automatic", ())
    readers = {name: partial(_parameter, parameter_reader(name, chosen)) for name in names}
    for name in (name for name in names if name in MAIN_FIELDS):
        entry = FIELDS[name]
        value = None if name in chosen else defaults[name]
        symbol = f" [{entry.metadata['symbol']}]" if entry.metadata["symbol"] else ""
        what = (about or {}).get(name, entry.metadata["help"])
        if value is not None:
            what = what.partition("; not given")[0]  # which is no choice then
        default = "auto" if value is None else value
        text = f"{what}{symbol} (default: {default})".replace("%", "%%")
        metavar = "INT" if is_whole(entry) else "X"
        add(f"--{option(name)}", text, metavar, type=readers.pop(name), default=_UNSET)
    text = f"set one of {', '.join(readers)}, which the README describes; repeatable"
    add("--set", text, "NAME=VALUE", type=partial(_setting, readers), action="append", default=[])


def _parameter(read: Callable[[str], Any], text: str) -> Any:
    try:
        return read(text)
    except ParameterError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _setting(readers: Mapping[str, Callable[[str], Any]], word: str) -> tuple[str, Any]:
    """Read ``NAME=VALUE``."""
    name, sign, text = word.partition("=")
    name = name.strip().replace("-", "_")
    if name in MAIN_FIELDS:
        raise argparse.ArgumentTypeError(f"{name} has its own option, --{option(name)}")
    if not sign or name not in readers:
        nearest = did_you_mean(name, readers) or f": expected one of {', '.join(readers)}"
        raise argparse.ArgumentTypeError(f"{brief(word)} is not NAME=VALUE{nearest}")
    return name, readers[name](text.strip())


def given_parameters(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the parameters that were given, by name; None is auto."""
    found = {name: getattr(arguments, name, _UNSET) for name in MAIN_FIELDS}
    own = {name: value for name, value in found.items() if value is not _UNSET}
    return own | dict(arguments.set)


def add_mesh(parser: argparse.ArgumentParser) -> None:
    """Declare the mesh file, as an argument of its own, and how it is read."""
    adder(parser)("mesh", MESH, "MESH")
    add_mesh_options(parser)


def add_mesh_options(parser: argparse.ArgumentParser) -> None:
    """Declare how meshes are read."""
    add = adder(parser.add_argument_group("meshes"))
    for entry in fields(MeshOptions):
        metavar = entry.metadata["metavar"]
        settings: dict[str, Any] = {"type": partial(_mesh_option, entry.name)} if metavar else {}
        if entry.name == MERGE:
            settings["nargs"] = "?"
        name = f"--{entry.name.replace('_', '-')}"
        add(name, entry.metadata["help"], metavar or None, **settings)


def _mesh_option(name: str, text: str) -> Any:
    try:
        return MeshOptions.value(name, text)
    except ParameterError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def mesh_options(arguments: argparse.Namespace) -> MeshOptions:
    """Return how meshes are to be read."""
    return MeshOptions(**{each.name: getattr(arguments, each.name) for each in fields(MeshOptions)})


def warn_of_doubt(path: str, match: Match | None) -> None:
    """Say on stderr what a file says of its match that the field does not bear out."""
    if match is not None and match.doubt:
        told = f"warning: {printable(path)} is not believed, and was judged anew: {match.doubt}"
        print(told, file=sys.stderr)


def mesh(arguments: argparse.Namespace, path: str | None = None) -> TriangleMesh:
    """Read the mesh, or one of several by its path, and print what was repaired on stderr."""
    loaded = load_mesh(path or arguments.mesh, **mesh_options(arguments).given)
    whose = f"{printable(path)}: " if path else ""
    for message in loaded.messages:
        print(f"note: {whose}{message}", file=sys.stderr)
    return loaded


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
bound = partial(_within, float, 1e-9, 1000, "a number above 0 and at most 1000")
angle = partial(_within, float, -360_000, 360_000, "an angle up to 360000 degrees")
seed = partial(_within, int, 0, 1e39, "a whole number from 0 on")
count = partial(_within, int, 1, 1_000_000, "a whole number from 1 to 1000000")
processes = partial(_within, int, 1, 4096, "a number of processes, 1 to 4096")
gamma = partial(_within, float, 0, 1e6, "a number from 0 to 1000000")
width = partial(_within, int, 32, 2000, "a whole number from 32 to 2000")
texels = partial(_within, int, 4, 16384, "a whole number from 4 to 16384")
_weight = partial(_within, float, 0, sys.float_info.max, "weights of channels such as 1,0.5")


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


def weights(text: str) -> list[float]:
    """Read weights of channels: ``1,0.5``."""
    return [_weight(each) for each in text.split(",")]
