"""Options that several commands share, and what they give: the parameters' own, sizes, the mesh."""

import argparse
import math
import sys
from dataclasses import dataclass, fields
from typing import Any

from abfm import Parameters, TriangleMesh, load_mesh
from abfm.errors import one_line
from abfm.parameters import CHOICES


def add_parameters(parser: argparse.ArgumentParser) -> None:
    """Declare one option for every parameter, with the help text and the paper's symbol from its
    definition.
    """
    group = parser.add_argument_group("parameters (symbols of the paper in brackets)")
    for entry in fields(Parameters):
        symbol = f" [{entry.metadata['symbol']}]" if entry.metadata["symbol"] else ""
        choices = CHOICES.get(entry.name)
        group.add_argument(
            "--" + entry.name.replace("_", "-"),
            type={"int": int, "float": float}.get(str(entry.type), str),
            choices=choices,
            metavar="{" + ",".join(choices) + "}"
            if choices
            else {"int": "INT"}.get(str(entry.type), "X"),
            default=entry.default,
            help=f"{entry.metadata['help']}{symbol} (default: {entry.default})".replace("%", "%%"),
        )


def parameters(arguments: argparse.Namespace) -> Parameters:
    """Return the parameters that a command line asks for."""
    return Parameters(
        **{entry.name: getattr(arguments, entry.name) for entry in fields(Parameters)}
    )


def add_mesh(parser: argparse.ArgumentParser) -> None:
    """Declare the mesh file, as an argument of its own, and what to do with several components."""
    parser.add_argument(
        "mesh", metavar="MESH", help="triangle mesh: obj, off, ply, stl, glb, gltf or gii"
    )
    add_largest_component(parser)


def add_largest_component(parser: argparse.ArgumentParser) -> None:
    """Declare what to do with several components."""
    parser.add_argument(
        "--largest-component",
        action="store_true",
        help="of several components use the one with the largest area",
    )


def mesh(arguments: argparse.Namespace) -> TriangleMesh:
    """Read the mesh and say on stderr what was repaired."""
    loaded = load_mesh(arguments.mesh, largest_component=arguments.largest_component)
    for message in loaded.messages:
        print(f"note: {message}", file=sys.stderr)
    return loaded


def size(text: str) -> tuple[int, int]:
    """Read a picture's size: ``1600x900``."""
    width, cross, height = text.partition("x")
    if not cross or not (width.isdecimal() and height.isdecimal()):
        raise argparse.ArgumentTypeError(f"{text!r} is not a size such as 1600x900")
    if not (320 <= int(width) <= 16384 and 240 <= int(height) <= 16384):
        raise argparse.ArgumentTypeError(f"{text!r} is out of range: from 320x240 to 16384x16384")
    return int(width), int(height)


@dataclass(frozen=True)
class Within:
    """A type for argparse: numbers between two, the ends included."""

    kind: type[int] | type[float]
    least: float
    most: float
    expected: str

    def __call__(self, text: str) -> Any:
        try:
            value = self.kind(text)
        except ValueError:
            value = math.nan
        if not self.least <= value <= self.most:
            raise argparse.ArgumentTypeError(f"{one_line(text, 40)} is not {self.expected}")
        return value


positive = Within(float, math.ulp(0), 86400, "a number above 0 and at most 86400")
"""Of seconds or frames."""
angle = Within(float, -360_000, 360_000, "an angle up to 360000 degrees")
seed = Within(int, 0, 1e39, "a whole number from 0 on")
count = Within(int, 1, 1_000_000, "a whole number from 1 to 1000000")
