"""`abfm demo`: a match on a bundled mesh, as a self-test."""

import argparse
import json
import sys
import time
from dataclasses import replace
from pathlib import Path

from abfm import Match, Parameters, Problem, load_mesh
from abfm.assets import asset_path
from abfm.functions import function
from abfm.matching.task import MatchTask
from abfm_viewer import pictures
from abfm_viewer.cli.exit_status import UNMATCHED_STATUS, print_note
from abfm_viewer.cli.options import add_report, adder
from abfm_viewer.cli.progress import frame_progress
from abfm_viewer.cli.solve import Outputs, solve
from abfm_viewer.errors import DrawingError
from abfm_viewer.files import outputs
from abfm_viewer.files.documents import document_of_result

SUMMARY = "match two functions on a bundled mesh, as a self-test without a screen"
DESCRIPTION = """\
Match two Gaussians on a bundled mesh with default parameters, and write the result, a picture and a
movie. Without OpenGL, picture and movie are skipped.

The exit status is 1 if the residual is above 0.05.

Example:
  abfm demo --out out
"""
FAILED_STATUS = 1
RESIDUAL_MAX = 0.05
_MOVIE_SIZE = (640, 480)
_FRAMES = 50
_FPS = 25.0
# On the trunk, close together, so that areas change little; also the default of the window.
SOURCE = "gaussian:vertex=398,width=0.14"
TARGET = "gaussian:vertex=440,width=0.14"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = adder(parser)
    about = "folder for the files, created if missing (default: out)"
    add("--out", about, "DIR", type=Path, default=Path("out"))
    add_report(add)


def run(arguments: argparse.Namespace) -> int:
    outputs.make_folder(arguments.out)
    result, *drawings = (arguments.out / f"demo.{suffix}" for suffix in ("npz", "png", "mp4"))
    for path in (result, *drawings):
        outputs.check(path, [path.suffix])
    mesh = load_mesh(asset_path("human_A.off"))
    problem = Problem(mesh, function(mesh, SOURCE), function(mesh, TARGET), Parameters())
    outcome = solve(MatchTask(problem), Outputs([result]), arguments.quiet)
    match = outcome.result
    assert isinstance(match, Match)
    start = time.perf_counter()
    drawn = outcome.status in (0, UNMATCHED_STATUS) and _draw(arguments.quiet, match, *drawings)
    outcome = replace(outcome, seconds=outcome.seconds + time.perf_counter() - start)
    if arguments.json:
        picture, movie = (str(path) if drawn else None for path in drawings)
        shown = {"picture": picture, "movie": movie, "largest_residual": RESIDUAL_MAX}
        print(json.dumps({"source": SOURCE, "target": TARGET, **outcome.to_dict(), **shown}))
    else:
        written = [*outcome.outputs, *(drawings if drawn else [])]
        print(replace(outcome, outputs=written).summary())
    if outcome.status not in (0, UNMATCHED_STATUS):
        return outcome.status
    if match.worse_residual > RESIDUAL_MAX:
        print(f"abfm: the self-test failed: the residual is above {RESIDUAL_MAX}", file=sys.stderr)
        return FAILED_STATUS
    return 0


def _draw(quiet: bool, match: Match, picture: Path, movie: Path) -> bool:
    """Draw a picture and a movie, or print why not; return whether they were drawn."""
    try:
        outputs.write_picture(picture, pictures.match_picture(match))
        document, known = document_of_result(match, movie.with_suffix(".npz"))
        with (
            pictures.DocumentRenderer(document, known, _MOVIE_SIZE) as renderer,
            frame_progress(_FRAMES, quiet, False) as report,
        ):
            frames = renderer.frames(0.0, match.parameters.tau, _FRAMES, 0.0)
            pictures.write_movie(movie, frames, _FPS, _FRAMES, report)
    except DrawingError as error:
        print_note(f"no picture and no movie: {error}")
        return False
    return True
