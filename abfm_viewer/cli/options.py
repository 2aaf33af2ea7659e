"""Options that several commands share, and what they give: the parameters' own, sizes, the mesh."""

import argparse
import sys
from dataclasses import fields

from abfm import Parameters, TriangleMesh, load_mesh
from abfm.errors import one_line
from abfm.parameters import CHOICES

_DAY, _THOUSAND_TURNS, _MANY = 86400.0, 360000.0, 1_000_000


def add_parameters(parser: argparse.ArgumentParser) -> None:
    """One option for every parameter, with the help text and the paper's symbol from its definition."""
    group = parser.add_argument_group("parameters (symbols of the paper in brackets)")
    for entry in fields(Parameters):
        symbol = f" [{entry.metadata['symbol']}]" if entry.metadata["symbol"] else ""
        choices = CHOICES.get(entry.name)
        group.add_argument(
            "--" + entry.name.replace("_", "-"),
            type={"int": int, "float": float}.get(str(entry.type), str),
            choices=choices,
            metavar="{" + ",".join(choices) + "}" if choices else {"int": "INT"}.get(str(entry.type), "X"),
            default=entry.default,
            help=f"{entry.metadata['help']}{symbol} (default: {entry.default})".replace("%", "%%"),
        )


def parameters(arguments: argparse.Namespace) -> Parameters:
    """The parameters that a command line asks for."""
    return Parameters(**{entry.name: getattr(arguments, entry.name) for entry in fields(Parameters)})


def add_mesh(parser: argparse.ArgumentParser) -> None:
    """The mesh file, as an argument of its own, and what to do with several components."""
    parser.add_argument("mesh", metavar="MESH", help="triangle mesh: obj, off, ply, stl, glb, gltf or gii")
    add_largest_component(parser)


def add_largest_component(parser: argparse.ArgumentParser) -> None:
    """What to do with several components."""
    parser.add_argument(
        "--largest-component", action="store_true", help="of several components use the one with the largest area"
    )


def mesh(arguments: argparse.Namespace) -> TriangleMesh:
    """Read the mesh and say on stderr what was repaired."""
    loaded = load_mesh(arguments.mesh, largest_component=arguments.largest_component)
    for message in loaded.messages:
        print(f"note: {message}", file=sys.stderr)
    return loaded


def size(text: str) -> tuple[int, int]:
    """A picture's size: ``1600x900``."""
    width, cross, height = text.partition("x")
    if not cross or not (width.isdecimal() and height.isdecimal()):
        raise argparse.ArgumentTypeError(f"{text!r} is not a size such as 1600x900")
    if not (320 <= int(width) <= 16384 and 240 <= int(height) <= 16384):
        raise argparse.ArgumentTypeError(f"{text!r} is out of range: from 320x240 to 16384x16384")
    return int(width), int(height)


def positive(text: str) -> float:
    """A number above 0, of seconds or frames: a day at most."""
    value = float(text)
    if not 0 < value <= _DAY:
        raise argparse.ArgumentTypeError(f"{one_line(text, 40)} is not a number above 0 and at most {_DAY:g}")
    return value


def angle(text: str) -> float:
    """An angle in degrees: a thousand turns at most."""
    value = float(text)
    if not abs(value) <= _THOUSAND_TURNS:
        raise argparse.ArgumentTypeError(f"{one_line(text, 40)} is not an angle up to {_THOUSAND_TURNS:g} degrees")
    return value


def seed(text: str) -> int:
    """A whole number that is not negative."""
    if not (text.isdecimal() and len(text) < 40):
        raise argparse.ArgumentTypeError(f"{one_line(text, 40)} is not a whole number from 0 on")
    return int(text)


def count(text: str) -> int:
    """A whole number above 0: a million at most."""
    if not (text.isdecimal() and len(text) < 10 and 0 < int(text) <= _MANY):
        raise argparse.ArgumentTypeError(f"{one_line(text, 40)} is not a whole number from 1 to {_MANY}")
    return int(text)
