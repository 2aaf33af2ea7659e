"""`abfm demo`: the main job on a bundled mesh, as a self-test."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from abfm import Match, Parameters, load_mesh
from abfm.assets import asset_path
from abfm.functions import function
from abfm_viewer.cli import outputs
from abfm_viewer.cli.solving import solve
from abfm_viewer.errors import DrawingError

SUMMARY = "the main job on a bundled mesh: a self-test that needs no screen"
DESCRIPTION = """\
Match two Gaussians on a bundled mesh with default parameters, and write the result and a picture of it.

The exit status is 1 when the mismatch ends above 0.05. Where the machine has no OpenGL, only the picture is missing.

Example:
  abfm demo --out out
"""
FAILED = 1
LARGEST_MISMATCH = 0.05
# From the chest to a thigh, a quarter of the body away.
SOURCE, TARGET = "gaussian:vertex=394,width=0.1", "gaussian:vertex=472,width=0.1"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--out", type=Path, default=Path("out"), metavar="DIR", help="folder, made if missing (default: out)"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object about the result")
    parser.add_argument("--quiet", action="store_true", help="no progress")


def run(arguments: argparse.Namespace) -> int:
    """Match, draw and judge."""
    arguments.out.mkdir(parents=True, exist_ok=True)
    result, picture = arguments.out / "demo.npz", arguments.out / "demo.png"
    for path in (result, picture):
        outputs.check(path, [path.suffix])
    mesh = load_mesh(asset_path("human_A.off"))
    outcome = solve(mesh, function(mesh, SOURCE), function(mesh, TARGET), Parameters(), [result], arguments.quiet)
    drawn, why_not = (False, "") if outcome.status else _draw(outcome.match, picture)
    if why_not:
        print(f"note: no picture: {why_not}", file=sys.stderr)
    if arguments.json:
        shown = {"picture": str(picture) if drawn else None, "largest_mismatch": LARGEST_MISMATCH}
        print(json.dumps({"source": SOURCE, "target": TARGET, **outcome.to_dict(), **shown}))
    else:
        print(outcome.summary() + (f", {picture}" if drawn else ""))
    if outcome.match.mismatch > LARGEST_MISMATCH and not outcome.status:
        print(f"abfm: the self-test failed: mismatch above {LARGEST_MISMATCH}", file=sys.stderr)
        return FAILED
    return outcome.status


def _draw(match: Match, path: Path) -> tuple[bool, str]:
    """Whether the picture was drawn, or why not."""
    try:
        from abfm_viewer.pictures import match_picture  # not before: it needs OpenGL

        outputs.write_picture(path, match_picture(match))
    except DrawingError as error:
        return False, str(error)
    return True, ""
