"""`abfm render`: a picture of a result."""

from __future__ import annotations

import argparse
from pathlib import Path

from abfm import ParameterError, load_match
from abfm_viewer.cli import options, outputs

SUMMARY = "draw a result"
DESCRIPTION = """\
Draw a result: the source, the source on its way to the target, and the target.

Examples:
  abfm render match.npz --out match.png
  abfm render match.npz --out match.png --size 2400x800 --time 0.5 --time 1.5
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("result", metavar="RESULT.npz", help="what `abfm match` wrote")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.png", help="the picture")
    parser.add_argument(
        "--size", type=options.size, metavar="WxH", help="in pixels, such as 1600x900 (default: as the shape wants)"
    )
    parser.add_argument(
        "--time",
        type=float,
        action="append",
        metavar="T",
        help="a time to show besides 0 and tau, also beyond tau; repeatable (default: quarters of tau)",
    )
    parser.add_argument("--channel", type=int, default=0, metavar="C", help="which pair of functions (default: 0)")
    parser.add_argument("--up", choices=("x", "y", "z"), default="y", help="axis that points upwards (default: y)")


def run(arguments: argparse.Namespace) -> int:
    """Draw and write."""
    outputs.check(arguments.out, [".png"])
    match = load_match(arguments.result)
    count = match.source.shape[1]
    if not 0 <= arguments.channel < count:
        raise ParameterError(f"--channel {arguments.channel}: the result has channels 0 to {count - 1}")
    from abfm_viewer.pictures import match_picture  # not before: it needs OpenGL

    picture = match_picture(match, arguments.time, arguments.size, arguments.channel, arguments.up)
    outputs.write_picture(arguments.out, picture)
    print(f"wrote {arguments.out} ({picture.width} x {picture.height})")
    return 0
