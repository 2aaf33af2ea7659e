"""Sheets of matches, sequences and figures: pictures of panels, plots and colour bars."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from PIL import Image, ImageDraw, ImageFont

import abfm
from abfm import Match, TriangleMesh
from abfm.display import BEST_VIEW, ViewSpec
from abfm.io.sheets import Frame, Panel, Plot, Sheet, Values
from abfm.types import FloatArray
from abfm.wording import share
from abfm_viewer import pictures
from abfm_viewer.appearance.abbreviation import abbreviated
from abfm_viewer.appearance.theme import LIGHT_PALETTE
from abfm_viewer.pictures.canvas import Font, draw_parts, rgb
from abfm_viewer.pictures.panels import cameras, color_ranges, panel_pictures
from abfm_viewer.scene.annotations import Pen, bar_parts
from abfm_viewer.scene.surfaces import Camera
from abfm_viewer.widgets.widget_record import Rect

# maximum sizes of sheets without a given size, in pixels
WIDTH_MAX = 1400
PANEL_HEIGHT_MAX = 450
# sizes of sheets of matches and sequences, in pixels
DEFAULT_WIDTH = 1400
_DEFAULT_HEIGHT = 545
_SCALE_MIN = 0.6
_SHEET_ASPECT = 2.4
_SEQUENCE_TIMES = 6  # number of times on a sheet of a sequence
_ASPECTS = (0.45, 1.9)  # minimum and maximum of width over height of a panel of a figure
# The following sizes are in pixels at a scale of 1.
MARGIN = 30
GAP = 18
LABEL = 46
_TEXT_SIZE = 24
_SMALL_TEXT_SIZE = 20
_TEXT_SIZE_MIN = 13
_LINE_HEIGHT = 28
_TICK_LENGTH = 6
_BARS_HEIGHT = 110  # of colour bars below the cells
_UPRIGHT_BAR_WIDTH = 100  # of an upright colour bar at the right, with its numbers
_BAR_LENGTH = 380
_UPRIGHT_LENGTH = 560
_BAR_WIDTH = 20
_BAR_GAP = 90
_OFFSET_ABOVE = 29
_OFFSET_BEFORE = 22
_FRAMES: dict[Frame, tuple[str, float]] = {  # colours and line widths
    "source": ("#2455c3", 5),
    "target": ("#c62828", 5),
    "result": ("#111111", 5),
    "field": ("#8a909c", 5),
    "other": ("#d0d4db", 1.5),
}
_INK = "#1d222b"
_TONES = {tone: rgb(getattr(LIGHT_PALETTE, tone)) for tone in ("good", "warning", "failure")}


@dataclass(frozen=True)
class Place:
    """A rectangle of a sheet, in pixels from its upper left corner."""

    left: int
    top: int
    width: int
    height: int


@dataclass(frozen=True)
class Layout:
    """The size of a sheet in pixels, its scale, and the places of its cells and colour bars."""

    width: int
    height: int
    scale: float
    rows: tuple[tuple[Place, ...], ...]
    bars: tuple[Rect, ...]
    upright: bool


def lay_out(
    rows: Sequence[Sequence[float]],
    bars: int,
    upright: bool = False,
    size: tuple[int | None, int | None] = (None, None),
    scale: float = 1.0,
) -> Layout:
    """Return the layout of a sheet whose cells have equal height.

    ``rows`` are the aspects (width over height) of the cells in each row, and ``bars`` is the
    number of colour bars. The bars are below the cells, or one bar is at the right if ``upright``.

    ``size`` is the width and height of the sheet; None is as large as its cells need. Without a
    width, a sheet is not wider than `WIDTH_MAX`, and its cells not higher than `PANEL_HEIGHT_MAX`.
    """
    width, height = size
    margin, gap, label = scale * MARGIN, scale * GAP, scale * LABEL
    at_right = scale * _UPRIGHT_BAR_WIDTH * upright
    below = scale * _BARS_HEIGHT * (bars > 0 and not upright)
    free = (width or WIDTH_MAX) - 2 * margin - at_right
    tall = min((free - gap * (len(row) - 1)) / sum(row) for row in rows)
    if width is None:
        tall = min(tall, PANEL_HEIGHT_MAX)
    if height is not None:
        tall = min(tall, (height - 1.5 * margin - below + gap) / len(rows) - label - gap)
    step = max(round(tall), 1) + label + gap
    widths = [[max(round(aspect * tall), 1) for aspect in row] for row in rows]
    totals = [sum(row) + gap * (len(row) - 1) for row in widths]
    width = width or round(max(totals) + 2 * margin + at_right)
    top = margin if height is None else (height - below - len(rows) * step + gap) / 2
    places = []
    for number, (row, total) in enumerate(zip(widths, totals, strict=True)):
        left, line = (width - at_right - total) / 2, []
        for cell in row:
            line.append(Place(int(left), int(top + number * step), cell, max(round(tall), 1)))
            left += cell + gap
        places.append(tuple(line))
    end = top + len(rows) * step
    height = height or round(end - gap + below + margin / 2)
    if upright:
        middle = (top + end - label - gap) / 2
        half = min((end - label - gap - top) / 2, scale * _UPRIGHT_LENGTH / 2)
        left = (width - at_right + max(totals)) / 2 + scale * _OFFSET_BEFORE
        found = [(left, middle - half, left + scale * _BAR_WIDTH, middle + half)]
    else:
        each, high = (width - 2 * scale * _BAR_GAP) / max(bars, 1), end + scale * _OFFSET_ABOVE
        half = min(scale * _BAR_LENGTH, each - scale * _BAR_GAP / 2) / 2
        middles = [scale * _BAR_GAP + (number + 0.5) * each for number in range(bars)]
        found = [
            (middle - half, high, middle + half, high + scale * _BAR_WIDTH) for middle in middles
        ]
    return Layout(width, height, scale, tuple(places), tuple(found), upright)


def match_picture(
    match: Match,
    times: Sequence[float] | None = None,
    size: tuple[int, int] | None = None,
    channel: int = 0,
    view: ViewSpec = BEST_VIEW,
) -> Image.Image:
    """Return a sheet of a match: the source, the source at times of the flow, and the target.

    The panels have frames that are blue for the source, red for the target and black for the
    result. The source is advected to ``times`` (by default quarters of tau), and always to tau.

    ``size`` (width, height) in pixels is by default that of a wide sheet. ``channel`` is the index
    of the shown pair of functions, ``view`` the side from which the surface is shown.
    """
    tau = match.parameters.tau
    shown_times = sorted({*(tau * np.array([0.25, 0.5, 0.75]) if times is None else times), tau})

    def panel(function: FloatArray, label: str, frame: Frame = "other") -> Panel:
        values = Values(function.reshape(len(function), -1)[:, channel])
        tone = match.facts.tone if frame == "result" else "ink"
        return Panel(match.mesh, values, label, frame, tone="" if tone == "ink" else tone)

    panels = [panel(match.source, "source", "source")]
    for time, values in zip(shown_times, match.advect(shown_times), strict=True):
        if time == tau:
            panels.append(panel(values, f"t = {time:.4g}, {_verdict(match)}", "result"))
        else:
            panels.append(panel(values, f"t = {time:.4g}"))
    return _one_row(Sheet(((*panels, panel(match.target, "target", "target")),), view), size)


def _verdict(match: Match) -> str:
    """Return ``residual 4.3%``, or the outcome if it is not good or only landmarks were matched."""
    facts = match.facts
    if not facts.outcome.is_good or match.problem.is_of_landmarks:
        return str(facts.outcome)
    return f"residual {share(facts.worse_residual)}"


def sequence_picture(
    sequence: abfm.Sequence,
    times: Sequence[float] | None = None,
    size: tuple[int, int] | None = None,
    channel: int = 0,
    view: ViewSpec = BEST_VIEW,
) -> Image.Image:
    """Return a sheet of a sequence: the function at several times, with arrows of the field.

    ``times`` are evenly spaced by default. Arrows are fainter where the frames do not determine the
    field. All other parameters are those of `match_picture`.
    """
    begin, end = float(sequence.times[0]), float(sequence.times[-1])
    panels = []
    for time in np.linspace(begin, end, _SEQUENCE_TIMES).tolist() if times is None else times:
        function = sequence.at(time).reshape(len(sequence.mesh.vertices), -1)[:, channel]
        i = sequence.interval(time)
        field, share = sequence.velocity[i], sequence.determined[i]
        label = f"t = {time:.4g} {sequence.unit_of_time}".rstrip()
        panels.append(Panel(sequence.mesh, Values(function), label, arrows=field, determined=share))
    changes = sequence.frames[:, :, channel].std(axis=0)
    return _one_row(Sheet((tuple(panels),), view, view_functions=(changes,)), size)


SHEETS: Mapping[type, Callable[..., Image.Image]] = {
    Match: match_picture,
    abfm.Sequence: sequence_picture,
}
"""Functions that draw a sheet, by the type of the result; their parameters are the same."""


def _one_row(sheet: Sheet, size: tuple[int, int] | None) -> Image.Image:
    """Return the picture of a sheet with panels of one surface, in rows that fit ``size``."""
    views = cameras(sheet)
    (view,) = views.values()
    layout = grid(len(sheet.rows[0]), view.aspect, size)
    return sheet_picture(sheet, views, layout, ImageFont.load_default)


def figure_picture(sheet: Sheet, notes: Sequence[str] = ()) -> Image.Image:
    """Return the picture of a figure with notes below it; raise `DrawingError` if it fails."""
    views = cameras(sheet, _ASPECTS)
    plot_aspect = max(next(iter(views.values())).aspect if views else 1.0, 0.7)

    def aspect(cell: Panel | Plot) -> float:
        return views[cell.mesh].aspect if isinstance(cell, Panel) else cell.width * plot_aspect

    aspects = [[aspect(cell) for cell in row] for row in sheet.rows]
    return sheet_picture(
        sheet, views, lay_out(aspects, len(color_ranges(sheet))), pictures.plot_font, notes
    )


def grid(count: int, aspect: float, size: tuple[int, int] | None = None) -> Layout:
    """Return a layout in which ``count`` panels of an aspect (width over height) are large.

    Without ``size``, the sheet itself has an aspect of about 2.4.
    """
    width, height = size or (DEFAULT_WIDTH, None)
    scale = 1.0
    if height is not None:
        scale = max(_SCALE_MIN, min(width / DEFAULT_WIDTH, height / _DEFAULT_HEIGHT))
    candidates = []
    for columns in sorted({math.ceil(count / rows) for rows in range(1, count + 1)}):
        rows = [[aspect] * columns] * math.ceil(count / columns)
        candidates.append(lay_out(rows, 1, True, (width, height), scale))
    if size is None:
        off = [math.log(one.width / one.height / _SHEET_ASPECT) for one in candidates]
        return candidates[int(np.argmin(np.abs(off)))]
    return max(candidates, key=lambda layout: layout.rows[0][0].width)


def sheet_picture(
    sheet: Sheet,
    views: Mapping[TriangleMesh, Camera],
    layout: Layout,
    font: Callable[[float], Font],
    notes: Sequence[str] = (),
) -> Image.Image:
    """Return the picture of a sheet: its cells at the places of a layout, and notes below them."""
    ranges, scale = color_ranges(sheet), layout.scale
    small = font(scale * _SMALL_TEXT_SIZE)
    lines = wrapped(notes, layout.width - 2 * MARGIN, small.getlength)
    notes_height = _LINE_HEIGHT * len(lines) + MARGIN // 2 if lines else 0
    picture = Image.new("RGB", (layout.width, layout.height + notes_height), "white")
    draw = ImageDraw.Draw(picture)
    cells = [cell for row in sheet.rows for cell in row]
    places = [place for row in layout.rows for place in row][: len(cells)]
    placed = list(zip(cells, places, strict=True))
    sizes = [(place.width, place.height) for cell, place in placed if isinstance(cell, Panel)]
    drawings = iter(panel_pictures(sheet, sizes, ranges, views))
    for cell, place in placed:
        corner = (place.left, place.top)
        color: str | tuple[int, int, int] = _INK
        if isinstance(cell, Plot):
            size = (place.width, place.height)
            picture.paste(pictures.plot_picture(cell, size, scale * _SMALL_TEXT_SIZE), corner)
        else:
            drawing = next(drawings)
            picture.paste(drawing, corner, drawing)
            outline, width = _FRAMES[cell.frame]
            end = (place.left + place.width - 1, place.top + place.height - 1)
            draw.rectangle((corner, end), outline=outline, width=max(round(scale * width), 1))
            color = _TONES.get(cell.tone) or (outline if cell.frame != "other" else _INK)
        width_max = place.width + scale * GAP - 4
        sizes_down = [scale * size for size in range(_TEXT_SIZE, _TEXT_SIZE_MIN - 1, -1)]
        fitting = (size for size in sizes_down if font(size).getlength(cell.label) <= width_max)
        label_font = font(next(fitting, sizes_down[-1]))
        middle = (place.left + place.width / 2, place.top + place.height + scale * LABEL / 2)
        label = abbreviated(cell.label, width_max, label_font.getlength)
        draw.text(middle, label, fill=color, font=label_font, anchor="mm")
    inks = replace(LIGHT_PALETTE, muted=LIGHT_PALETTE.ink)
    pen = Pen(scale, 1.2 * scale * _SMALL_TEXT_SIZE, small.getlength, inks, scale * _TICK_LENGTH)
    for (title, colors), rect in zip(ranges.items(), layout.bars, strict=True):
        draw_parts(picture, bar_parts(title, colors, rect, pen, layout.upright), pen, small)
    for number, line in enumerate(lines):
        start = (MARGIN, layout.height + _LINE_HEIGHT * (number + 0.5))
        draw.text(start, line, fill=_INK, font=small, anchor="lm")
    return picture


def wrapped(texts: Sequence[str], width: float, width_of: Callable[[str], float]) -> list[str]:
    """Break texts into lines of a width in pixels, as measured by ``width_of``; keep long words."""
    lines = []
    for text in texts:
        line, *words = text.split() or [""]
        for word in words:
            longer = f"{line} {word}"
            if width_of(longer) > width:
                lines.append(line)
                longer = word
            line = longer
        lines.append(line)
    return lines
