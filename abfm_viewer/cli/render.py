"""`abfm render`: a picture or a movie of a result or a project."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from abfm import ParameterError, load_match
from abfm.mesh import FloatArray
from abfm_viewer.cli import options, outputs
from abfm_viewer.document import EXTRAPOLATION, Document

SUMMARY = "draw a result or a project"
DESCRIPTION = """\
Draw a result or a project: a picture (.png) or a movie of the flow (.mp4, .gif).

A picture of a result is a sheet with the source, the source on its way to the target, and the target. Pictures of a
project and all movies show what the window shows: the surfaces side by side, at the project's camera.

Examples:
  abfm render match.npz --out match.png
  abfm render match.npz --out match.png --size 2400x800 --time 0.5 --time 1.5
  abfm render match.npz --out match.mp4 --seconds 4 --to 2
  abfm render my.abfm --out my.png --size 3840x2160 --transparent
"""
_MOVIES = (".mp4", ".gif")
_SIZE = {".png": (1920, 1080), ".mp4": (1280, 720), ".gif": (800, 450)}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("input", metavar="RESULT.npz|PROJECT.abfm", help="what `abfm match` wrote, or the app saved")
    parser.add_argument(
        "--out", type=Path, required=True, metavar="FILE", help="the picture (.png) or movie (.mp4, .gif)"
    )
    parser.add_argument(
        "--size", type=options.size, metavar="WxH", help="in pixels, such as 1600x900 (default: as the kind wants)"
    )
    parser.add_argument(
        "--time",
        type=float,
        action="append",
        metavar="T",
        help="time of a picture, 0 to 2 tau; on a sheet repeatable (default: quarters of tau; a project's own)",
    )
    parser.add_argument("--style", choices=("sheet", "window"), help="of a picture (default: by the input)")
    parser.add_argument("--channel", type=int, default=0, metavar="C", help="which pair of functions (default: 0)")
    parser.add_argument(
        "--up", choices=("x", "y", "z"), default="y", help="axis that points upwards on a sheet (default: y)"
    )
    parser.add_argument("--transparent", action="store_true", help="no ground behind a window's picture")
    parser.add_argument("--no-color-bar", action="store_true", help="no colour bar on a window's picture or movie")
    parser.add_argument("--seconds", type=options.positive, default=4.0, metavar="S", help="of a movie (default: 4)")
    parser.add_argument("--fps", type=options.positive, default=30.0, metavar="N", help="frames a second (default: 30)")
    parser.add_argument("--from", type=float, default=0.0, dest="start", metavar="T", help="first time (default: 0)")
    parser.add_argument("--to", type=float, default=None, metavar="T", help="last time of a movie (default: tau)")
    parser.add_argument(
        "--turntable", type=float, default=0.0, metavar="DEGREES", help="turn the surfaces meanwhile (default: 0)"
    )
    parser.add_argument("--progress", action="store_true", help="tell of every frame as a line of JSON")
    parser.add_argument("--quiet", action="store_true", help="no progress")


def run(arguments: argparse.Namespace) -> int:
    """Draw and write."""
    outputs.check(arguments.out, [".png", *_MOVIES])
    is_project = arguments.input.endswith(".abfm")
    style = arguments.style or ("window" if is_project or arguments.out.suffix in _MOVIES else "sheet")
    if style == "sheet":
        if is_project or arguments.out.suffix in _MOVIES:
            raise ParameterError("--style sheet is for pictures of results (.npz to .png); leave it out")
        return _sheet(arguments)
    if not is_project:
        document, known = _of_result(Path(arguments.input), arguments.channel)
    else:
        from abfm_viewer.project import load_project

        document, known = load_project(arguments.input)
    return _window(arguments, document, known)


def _sheet(arguments: argparse.Namespace) -> int:
    match = load_match(arguments.input)
    _check_channel(arguments.channel, match.source.shape[1])
    for time in arguments.time or []:
        _check_time("--time", time, match.parameters.tau)
    from abfm_viewer.pictures import match_picture  # not before: it needs OpenGL

    picture = match_picture(match, arguments.time, arguments.size, arguments.channel, arguments.up)
    outputs.write_picture(arguments.out, picture)
    print(f"wrote {arguments.out} ({picture.width} x {picture.height})")
    return 0


def _window(arguments: argparse.Namespace, document: Document, known: dict[str, FloatArray]) -> int:
    tau, suffix = document.parameters.tau, arguments.out.suffix
    times = arguments.time or [document.time]
    end = tau if arguments.to is None else arguments.to
    for name, time in (("--time", times[0]), ("--from", arguments.start), ("--to", end)):
        _check_time(name, time, tau)
    if len(times) > 1:
        raise ParameterError(f"--time is given {len(times)} times; a window's picture shows one time")
    from abfm_viewer.document_pictures import DocumentRenderer, PictureOptions  # not before: it needs OpenGL

    size = arguments.size or _SIZE[suffix]
    choices = PictureOptions(arguments.transparent and suffix == ".png", not arguments.no_color_bar)
    renderer = DocumentRenderer(document, known, size, choices)
    try:
        if suffix == ".png":
            picture = renderer.picture(times[0], arguments.turntable)
            outputs.write_picture(arguments.out, picture if choices.transparent else picture.convert("RGB"))
            print(f"wrote {arguments.out} ({picture.width} x {picture.height})")
            return 0
        from abfm_viewer.movies import write_movie

        count = max(round(arguments.seconds * arguments.fps), 2)
        with _progress(arguments, count) as report:
            frames = renderer.frames(arguments.start, end, count, arguments.turntable)
            write_movie(arguments.out, frames, arguments.fps, count, report)
    finally:
        renderer.close()
    print(f"wrote {arguments.out} ({size[0]} x {size[1]}, {count} frames)")
    return 0


def _of_result(path: Path, channel: int) -> tuple[Document, dict[str, FloatArray]]:
    """A document that shows a result."""
    from abfm_viewer.documents import functions_of_result

    match = load_match(path)
    _check_channel(channel, match.source.shape[1])
    channels, mask, known = functions_of_result(match, path)
    document = Document(
        match.mesh,
        path.name,
        channels,
        channel=channel,
        parameters=match.parameters,
        mask=mask,
        result=match,
        time=match.parameters.tau,
    )
    return document, known


def _check_channel(channel: int, count: int) -> None:
    if not 0 <= channel < count:
        raise ParameterError(f"--channel {channel}: the result has channels 0 to {count - 1}")


def _check_time(name: str, time: float, tau: float) -> None:
    if not 0 <= time <= EXTRAPOLATION * tau:
        raise ParameterError(f"{name} {time:g}: expected 0 to {EXTRAPOLATION * tau:g}, which is {EXTRAPOLATION:g} tau")


@contextmanager
def _progress(arguments: argparse.Namespace, count: int) -> Iterator[Callable[[int], None]]:
    """What to call after every frame."""
    if arguments.progress:
        yield lambda frame: print(json.dumps({"frame": frame, "count": count}), flush=True)
    elif arguments.quiet or not sys.stderr.isatty():
        yield lambda frame: None
    else:
        with Progress(console=Console(stderr=True), transient=True) as bar:
            task = bar.add_task("frames", total=count)
            yield lambda frame: bar.update(task, completed=frame)
