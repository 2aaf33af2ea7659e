"""`abfm render`: a picture or a movie of a result or a project."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from abfm import ParameterError
from abfm.errors import printable
from abfm.types import FloatArray
from abfm_viewer import pictures
from abfm_viewer.cli.exit_status import UsageError
from abfm_viewer.cli.options import (
    add_view,
    adder,
    angle,
    positive,
    size,
    view_of,
    warn_if_recomputed,
)
from abfm_viewer.cli.progress import frame_progress
from abfm_viewer.document.document import THEMES, Document
from abfm_viewer.files import outputs
from abfm_viewer.files.contents import PROJECT
from abfm_viewer.files.documents import read_document
from abfm_viewer.session.player import SECONDS_PER_CYCLE
from abfm_viewer.session.saving.export_settings import BACKGROUNDS

if TYPE_CHECKING:
    from PIL import Image

SUMMARY = "draw a picture, a movie or a page of a result or a project"
DESCRIPTION = """\
Draw a result or a project as a picture (.png), a movie of the flow (.mp4, .gif), or an interactive
page for a browser (.html). The page is one file without external resources.

Examples:
  abfm render match.npz --out match.png
  abfm render match.npz --out match.png --size 2400x800 --time 0.5 --time 1.5
  abfm render match.npz --out match.mp4 --seconds 4 --to 2
  abfm render reg.npz --out reg.html
  abfm render sequence.npz --out sequence.png --time 0.1 --time 0.2
  abfm render match.npz --out streaks.gif --streaks --fade --from 0 --to 0
  abfm render my.abfm --out my.png --size 3840x2160 --background transparent
"""
DETAILS = """\
A picture of a match is a sheet of panels: the source, the source at some times of the flow, and the
target. A sheet of a sequence has frames and the field. Pictures of projects and registrations, and
all movies, show the surfaces as the window does (--style window).
"""
MAIN_OPTIONS = (
    "size",
    "time",
    "style",
    "channel",
    "view",
    "up",
    "streaks",
    "background",
    "seconds",
    "from",
    "to",
    "turntable",
)
Known = dict[str, FloatArray]
_MOVIES = (".mp4", ".gif")
_PAGE = ".html"
_PICTURE_OPTIONS = ("size", "dpi", "time", "style", "channel", "progress")
_WINDOW_OPTIONS = ("theme", "background", "no_color_bar", "no_labels", "streaks", "fade")
_MOVIE_OPTIONS = ("seconds", "fps", "start", "end", "turntable")
_SIZE = {".png": (1600, 900), ".mp4": (1280, 720), ".gif": (800, 450)}
_SECONDS = 4.0
_FPS = 30.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = adder(parser)
    what = "result of `abfm match`, `register` or `sequence`, or a project of the app"
    add("input", what, "RESULT.npz|PROJECT.abfm")
    what = "picture (.png), movie (.mp4, .gif) or page (.html) to write"
    add("--out", what, "FILE", type=Path, required=True)
    what = "size in pixels (default: 1600x900, movies 1280x720, .gif 800x450; "
    add("--size", f"{what}sheets by their panels)", "WxH", type=size)
    add("--dpi", "pixels per inch of a printed picture (default: 300)", "N", type=positive)
    what = (
        "time of a picture, 0 to 2 tau for a match (default: that of the project, or tau). It is "
        "repeatable for a sheet (default: quarters of tau, or six times of a sequence)"
    )
    add("--time", what, "T", type=float, action="append")
    what = "style of a picture (default: window for projects and registrations, else sheet)"
    add("--style", what, choices=("sheet", "window"))
    add("--channel", "channel number (default: 0, or the active one of a project)", "C", type=int)
    add_view(add)
    add = adder(parser.add_argument_group("pictures and movies in the style of the window"))
    what = "background: theme (default), white, or transparent (pictures only)"
    add("--background", what, choices=BACKGROUNDS)
    add("--no-color-bar", "omit the colour bars")
    add("--no-labels", "omit the names of the surfaces")
    what = "draw streaks along the field on the advected surface (line integral convolution); "
    add("--streaks", f"{what}they move in a movie")
    add("--theme", "colours of the background and texts (default: light)", choices=THEMES)
    add("--fade", "fade the streaks where the field is slow")
    add = adder(parser.add_argument_group("movies"))
    add("--seconds", "length in seconds (default: 4)", "S", type=positive)
    add("--fps", "frames per second (default: 30)", "N", type=positive)
    add("--from", "first time (default: 0, or the first frame)", "T", type=float, dest="start")
    what = "last time, for a match at most 2 tau (default: tau, or the last frame)"
    add("--to", what, "T", type=float, dest="end")
    what = "angle by which the surfaces turn during the movie (default: 0)"
    add("--turntable", what, "DEGREES", type=angle)
    add = adder(parser)
    add("--progress", "print one line of JSON per frame")
    add("--quiet", "do not show progress")


def run(arguments: argparse.Namespace) -> int:
    out = arguments.out
    outputs.check(out, [".png", *_MOVIES, _PAGE])
    if out.suffix == _PAGE:
        every = (*_PICTURE_OPTIONS, *_WINDOW_OPTIONS, *_MOVIE_OPTIONS)
        _refuse(arguments, every, f"needs a picture or a movie, but {out} is a page")
    elif out.suffix in _MOVIES:
        _check_movie(arguments)
    else:
        _refuse(arguments, _MOVIE_OPTIONS, f"needs a movie, but {out} is a picture")
    if arguments.fade and not arguments.streaks:
        raise UsageError("--fade needs --streaks")
    document, known = read_document(Path(arguments.input))
    warn_if_recomputed(arguments.input, document)
    size = ""
    if out.suffix == _PAGE:
        if document.result is None:
            raise ParameterError(f"{arguments.input} has no result, which a page needs")
        outputs.write(out, document.complete_result, view_of(arguments))
    elif out.suffix in _MOVIES:
        size = _write_movie(arguments, _chosen(arguments, document), known)
    else:
        picture = _picture(arguments, document, known)
        outputs.write_picture(out, picture, arguments.dpi)
        size = f" ({picture.width} x {picture.height})"
    print(f"wrote {printable(out)}{size}")
    return 0


def _refuse(arguments: argparse.Namespace, names: Sequence[str], why: str) -> None:
    for name in names:
        value = getattr(arguments, name)
        if value is not None and value is not False:
            option = {"start": "from", "end": "to"}.get(name, name.replace("_", "-"))
            raise UsageError(f"--{option} {why}")


def _check_movie(arguments: argparse.Namespace) -> None:
    suffix, fps = arguments.out.suffix, arguments.fps
    if arguments.style == "sheet":
        raise UsageError(
            "--style sheet needs a picture (.png); movies have the style of the window"
        )
    why = f"needs a picture (.png); a {suffix} file has no transparency"
    if arguments.background == "transparent":
        raise UsageError(f"--background transparent {why}")
    _refuse(arguments, ("time",), "needs a picture; use --from and --to for a movie")
    _refuse(arguments, ("dpi",), why.split(";")[0])
    slowest, fastest = outputs.FPS_MIN, outputs.FPS_MAX[suffix]
    if fps is not None and not slowest <= fps <= fastest:
        raise UsageError(
            f"--fps {fps:g} is out of range for {suffix} files; expected {slowest:g} to {fastest:g}"
        )


def _chosen(arguments: argparse.Namespace, document: Document) -> Document:
    channel, count = arguments.channel, document.channel_count
    if channel is not None:
        if not 0 <= channel < count:
            raise ParameterError(f"--channel {channel} is out of range; expected 0 to {count - 1}")
        document = replace(document, channel=channel)
    if arguments.streaks:
        moving = {"fade": arguments.fade, "animate": arguments.out.suffix in _MOVIES}
        view = replace(document.view, coloring="function", streaks=True, **moving)
        document = replace(document, view=view)
    times = [("--time", time) for time in arguments.time or []]
    for name, time in [*times, ("--from", arguments.start), ("--to", arguments.end)]:
        if time is not None and not document.start <= time <= document.end:
            raise ParameterError(f"{name} is {time:g}; expected {document.time_range_text}")
    return document


def _picture(arguments: argparse.Namespace, document: Document, known: Known) -> Image.Image:
    """Draw a sheet of a result; draw a project or registration in the style of the window."""
    is_shown = arguments.input.lower().endswith(PROJECT) or document.initial_map is not None
    is_sheet = arguments.style == "sheet" or (arguments.style is None and not is_shown)
    if is_sheet:
        _refuse(arguments, _WINDOW_OPTIONS, "is not possible for sheets; add --style window")
    document = _chosen(arguments, document)
    if is_sheet:
        draw = pictures.SHEETS.get(type(document.result))
        if draw is None:
            raise ParameterError(
                f"{arguments.input} has no result, which a sheet needs; add --style window"
            )
        view = view_of(arguments)
        return draw(document.result, arguments.time, arguments.size, document.channel, view)
    times = arguments.time or [document.time]
    if len(times) > 1:
        raise UsageError(
            "--time is given more than once; a picture in the style of the window shows one time"
        )
    with _renderer(arguments, document, known) as renderer:
        return renderer.picture(times[0])


def _write_movie(arguments: argparse.Namespace, document: Document, known: Known) -> str:
    fps, turn = arguments.fps or _FPS, arguments.turntable or 0.0
    start = document.start if arguments.start is None else arguments.start
    end = document.last_target_time if arguments.end is None else arguments.end
    count = max(round((arguments.seconds or _SECONDS) * fps), 1)
    cycles = max(round(count / fps / SECONDS_PER_CYCLE), 1)
    width, height = arguments.size or _SIZE[arguments.out.suffix]
    with (
        _renderer(arguments, document, known) as renderer,
        frame_progress(count, arguments.quiet, arguments.progress) as report,
    ):
        frames = renderer.frames(start, end, count, turn, cycles)
        pictures.write_movie(arguments.out, frames, fps, count, report)
    many = "frames" if count > 1 else "frame"
    return f" ({width} x {height}, {count} {many})"


def _renderer(
    arguments: argparse.Namespace, document: Document, known: Known
) -> pictures.DocumentRenderer:
    """Return the renderer of a document; --view and --up replace the view of a project."""
    if arguments.view or arguments.up:
        result = document.match
        functions = [] if result is None else [result.source[:, 0], result.target[:, 0]]
        document = document.facing(view_of(arguments), *functions)
    theme = arguments.theme or document.view.theme
    document = replace(document, view=replace(document.view, theme=theme))
    with_bar, with_labels = not arguments.no_color_bar, not arguments.no_labels
    choices = pictures.PictureOptions(
        arguments.background or "theme", with_bar, with_labels, turns=bool(arguments.turntable)
    )
    pixels = arguments.size or _SIZE[arguments.out.suffix]
    return pictures.DocumentRenderer(document, known, pixels, choices)
