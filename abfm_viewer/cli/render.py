"""`abfm render`: a picture or a movie of a result or a project."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from abfm import ParameterError
from abfm.errors import printable
from abfm.types import FloatArray
from abfm_viewer import pictures
from abfm_viewer.cli import options
from abfm_viewer.cli.exit_status import UsageError
from abfm_viewer.cli.progress import frame_progress
from abfm_viewer.computing.defaults import best_front
from abfm_viewer.document.document import EXTRAPOLATION, Document
from abfm_viewer.files import outputs
from abfm_viewer.session.opening import read_document
from abfm_viewer.session.player import SECONDS_PER_CYCLE

if TYPE_CHECKING:
    from PIL import Image

SUMMARY = "draw a result or a project"
DESCRIPTION = """\
Draw a result or a project: a picture (.png) or a movie of the flow (.mp4, .gif).

A picture of a result is a sheet with the source, the source on its way to the target, and the
target. Pictures of a project and all movies show what the window shows: every surface in its slot,
as the project has it.

Examples:
  abfm render match.npz --out match.png
  abfm render match.npz --out match.png --size 2400x800 --time 0.5 --time 1.5
  abfm render match.npz --out match.mp4 --seconds 4 --to 2
  abfm render match.npz --out streaks.gif --streaks --fade --from 0 --to 0
  abfm render my.abfm --out my.png --size 3840x2160 --transparent
"""
_MOVIES = (".mp4", ".gif")
_SIZE = {".png": (1600, 900), ".mp4": (1280, 720), ".gif": (800, 450)}
_SECONDS, _FPS = 4.0, 30.0
_OF_MOVIES = {
    "--seconds": "seconds",
    "--fps": "fps",
    "--from": "start",
    "--to": "end",
    "--turntable": "turntable",
}
_OF_WINDOWS = ("transparent", "no_color_bar", "no_labels", "streaks", "fade")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "input", metavar="RESULT.npz|PROJECT.abfm", help="what `abfm match` wrote, or the app saved"
    )
    parser.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="FILE",
        help="the picture (.png) or movie (.mp4, .gif)",
    )
    parser.add_argument(
        "--size", type=options.size, metavar="WxH", help="in pixels, such as 1600x900"
    )
    parser.add_argument(
        "--time",
        type=float,
        action="append",
        metavar="T",
        help="time of a picture, 0 to 2 tau (default: the project's own, tau of a result); on a "
        "sheet a time to show "
        "besides 0 and tau, repeatable (default: quarters of tau)",
    )
    parser.add_argument(
        "--style", choices=("sheet", "window"), help="of a picture (default: by the input)"
    )
    parser.add_argument(
        "--channel",
        type=int,
        metavar="C",
        help="which pair of functions (default: 0, or the active)",
    )
    parser.add_argument(
        "--up", choices=("x", "y", "z"), help="axis that points upwards (default: y, or as it is)"
    )
    window = parser.add_argument_group("pictures and movies of the window's style")
    window.add_argument("--transparent", action="store_true", help="a picture without a ground")
    window.add_argument("--no-color-bar", action="store_true", help="leave the colour bars out")
    window.add_argument("--no-labels", action="store_true", help="leave the surfaces' names out")
    window.add_argument(
        "--streaks",
        action="store_true",
        help="streaks along the field on the advected surface (line integral convolution); in a "
        "movie they move",
    )
    window.add_argument(
        "--fade", action="store_true", help="with --streaks: they fade where the field is slow"
    )
    movies = parser.add_argument_group("movies")
    movies.add_argument("--seconds", type=options.positive, metavar="S", help="length (default: 4)")
    movies.add_argument(
        "--fps", type=options.positive, metavar="N", help="frames a second (default: 30)"
    )
    movies.add_argument(
        "--from", type=float, dest="start", metavar="T", help="first time (default: 0)"
    )
    movies.add_argument(
        "--to", type=float, dest="end", metavar="T", help="last time, at most 2 tau (default: tau)"
    )
    movies.add_argument(
        "--turntable",
        type=options.angle,
        metavar="DEGREES",
        help="how far the surfaces turn meanwhile (default: 0)",
    )
    parser.add_argument(
        "--progress", action="store_true", help="print a line of JSON for every frame"
    )
    parser.add_argument("--quiet", action="store_true", help="no progress")


def run(arguments: argparse.Namespace) -> int:
    """Draw and write."""
    outputs.check(arguments.out, [".png", *_MOVIES])
    path, suffix = Path(arguments.input), arguments.out.suffix
    of_project, is_movie = path.suffix == ".abfm", suffix in _MOVIES
    style = arguments.style or ("window" if of_project or is_movie else "sheet")
    _check_options(arguments, style, is_movie)
    document, known = read_document(path)
    document = _chosen(arguments, document)
    if is_movie:
        _movie(arguments, document, known)
        return 0
    picture = (
        _sheet(arguments, document) if style == "sheet" else _picture(arguments, document, known)
    )
    outputs.write_picture(arguments.out, picture)
    print(f"wrote {printable(arguments.out)} ({picture.width} x {picture.height})")
    return 0


def _check_options(arguments: argparse.Namespace, style: str, is_movie: bool) -> None:
    """Refuse options that would do nothing."""
    for option, name in _OF_MOVIES.items():
        if not is_movie and getattr(arguments, name) is not None:
            raise UsageError(f"{option} is for movies, and {arguments.out} is a picture")
    for name in _OF_WINDOWS:
        if style == "sheet" and getattr(arguments, name):
            raise UsageError(f"--{name.replace('_', '-')} is not for sheets; add --style window")
    if arguments.fade and not arguments.streaks:
        raise UsageError("--fade is for streaks; add --streaks")
    if is_movie:
        _check_movie(arguments, style)


def _check_movie(arguments: argparse.Namespace, style: str) -> None:
    suffix = arguments.out.suffix
    if style == "sheet":
        raise UsageError("--style sheet is for pictures; a movie shows what the window shows")
    if arguments.transparent:
        raise UsageError(f"--transparent is for pictures (.png); a {suffix} file has a ground")
    if arguments.time:
        raise UsageError("--time is for pictures; a movie takes --from and --to")
    slowest, fastest = outputs.SLOWEST, outputs.FASTEST[suffix]
    if arguments.fps is not None and not slowest <= arguments.fps <= fastest:
        raise UsageError(
            f"--fps {arguments.fps:g}: a {suffix} file takes {slowest:g} to {fastest:g}"
        )


def _chosen(arguments: argparse.Namespace, document: Document) -> Document:
    """Return the document with the channel, the times and the streaks that were asked for."""
    if arguments.channel is not None:
        count = max(len(document.channels), 1)
        if not 0 <= arguments.channel < count:
            raise ParameterError(
                f"--channel {arguments.channel}: there are channels 0 to {count - 1}"
            )
        document = replace(document, channel=arguments.channel)
    if arguments.streaks:
        moving = arguments.out.suffix in _MOVIES
        view = replace(
            document.view, coloring="function", streaks=True, fade=arguments.fade, animate=moving
        )
        document = replace(document, view=view)
    end = EXTRAPOLATION * document.parameters.tau
    times = [("--time", time) for time in arguments.time or []]
    times += [("--from", arguments.start), ("--to", arguments.end)]
    for name, time in times:
        if time is not None and not 0 <= time <= end:
            raise ParameterError(
                f"{name} is {time:g}; expected 0 to {end:g}, which is {EXTRAPOLATION:g} tau"
            )
    return document


def _sheet(arguments: argparse.Namespace, document: Document) -> Image.Image:
    if document.result is None:
        raise ParameterError(
            f"{arguments.input} holds no result to make a sheet of; add --style window"
        )
    return pictures.match_picture(
        document.result, arguments.time, arguments.size, document.channel, arguments.up or "y"
    )


def _picture(
    arguments: argparse.Namespace, document: Document, known: dict[str, FloatArray]
) -> Image.Image:
    if len(arguments.time or []) > 1:
        raise UsageError(
            "--time is given more than once, and a picture of the window shows one time"
        )
    choices = pictures.PictureOptions(
        arguments.transparent, not arguments.no_color_bar, not arguments.no_labels
    )
    seen, size = _turned_up(arguments, document), arguments.size or _SIZE[".png"]
    with pictures.DocumentRenderer(seen, known, size, choices) as renderer:
        return renderer.picture(arguments.time[0] if arguments.time else document.time)


def _movie(arguments: argparse.Namespace, document: Document, known: dict[str, FloatArray]) -> None:
    fps, start, turntable = (
        arguments.fps or _FPS,
        arguments.start or 0.0,
        arguments.turntable or 0.0,
    )
    end = document.parameters.tau if arguments.end is None else arguments.end
    count = max(round((arguments.seconds or _SECONDS) * fps), 1)
    cycles = max(round(count / fps / SECONDS_PER_CYCLE), 1)
    width, height = arguments.size or _SIZE[arguments.out.suffix]
    choices = pictures.PictureOptions(
        False, not arguments.no_color_bar, not arguments.no_labels, turns=bool(turntable)
    )
    renderer = pictures.DocumentRenderer(
        _turned_up(arguments, document), known, (width, height), choices
    )
    with renderer, frame_progress(count, arguments.quiet, arguments.progress) as report:
        pictures.write_movie(
            arguments.out, renderer.frames(start, end, count, turntable, cycles), fps, count, report
        )
    print(
        f"wrote {printable(arguments.out)} ({width} x {height}, {count} "
        f"frame{'s' if count > 1 else ''})"
    )


def _turned_up(arguments: argparse.Namespace, document: Document) -> Document:
    """Return the document seen from where an axis that was asked for points upwards."""
    if arguments.up is None:
        return document
    result = document.result
    functions = [] if result is None else [result.source[:, 0], result.target[:, 0]]
    front = best_front(document.surface().mesh, *functions, up=arguments.up)
    return replace(document.facing(front), view=replace(document.view, look=None))
