"""Sheets of panels, plots, labels and colour bars as one picture, of matches and of figures."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from PIL import Image, ImageDraw, ImageFont

import abfm
from abfm import Match, TriangleMesh
from abfm.io.sheets import Frame, Panel, Plot, Sheet, Up, Values
from abfm.types import FloatArray
from abfm_viewer import pictures
from abfm_viewer.appearance.abbreviation import abbreviated
from abfm_viewer.appearance.theme import LIGHT_PALETTE
from abfm_viewer.pictures.canvas import Font, letter, rgb
from abfm_viewer.pictures.panels import cameras, color_ranges, panel_pictures
from abfm_viewer.scene.annotations import Pen, bar_parts
from abfm_viewer.scene.surfaces import Camera
from abfm_viewer.widgets.widget_record import Rect

# of sheets without a size, in pixels
WIDTH_MAX = 2000
PANEL_HEIGHT_MAX = 640
# of matches
DEFAULT_WIDTH = 1800
_DEFAULT_HEIGHT = 700
_SCALE_MIN = 0.6
_SHEET_ASPECT = 2.4
_MOMENTS = 6  # of a sequence, on a sheet
_ASPECTS = (0.45, 1.9)  # least and greatest width over height of a figure's panel
# in pixels at a scale of 1
MARGIN = 30
GAP = 18
LABEL = 46
_TEXT_SIZE = 24
_SMALL_TEXT_SIZE = 20
_TEXT_SIZE_MIN = 13
_LINE_HEIGHT = 28
_TICK_LENGTH = 6
# room of colour bars
_ROOM_BELOW = 110
_ROOM_BESIDE = 100
_BAR_LENGTH = 380
_UPRIGHT_LENGTH = 560
_BAR_WIDTH = 20
_BAR_GAP = 90
_OFFSET_ABOVE = 29
_OFFSET_BEFORE = 22
_FRAMES: dict[Frame, tuple[str, float]] = {  # colours and widths
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
    """Size of a sheet in pixels, its scale, and places of its cells and colour bars."""

    width: int
    height: int
    scale: float
    rows: tuple[tuple[Place, ...], ...]
    bars: tuple[Rect, ...]
    upright: bool


def laid_out(
    rows: Sequence[Sequence[float]],
    bars: int,
    upright: bool = False,
    size: tuple[int | None, int | None] = (None, None),
    scale: float = 1.0,
) -> Layout:
    """Lay out cells of one height, whose widths over heights are given row by row.

    So many colour bars are below, or one to the right if it is upright. A sheet without a size
    (width, height) is as large as its cells need: at most `WIDTH_MAX`, they at most
    `PANEL_HEIGHT_MAX`.
    """
    width, height = size
    margin, gap, label = scale * MARGIN, scale * GAP, scale * LABEL
    beside, below = scale * _ROOM_BESIDE * upright, scale * _ROOM_BELOW * (bars > 0 and not upright)
    free = (width or WIDTH_MAX) - 2 * margin - beside
    tall = min((free - gap * (len(row) - 1)) / sum(row) for row in rows)
    if width is None:
        tall = min(tall, PANEL_HEIGHT_MAX)
    if height is not None:
        tall = min(tall, (height - 1.5 * margin - below + gap) / len(rows) - label - gap)
    step = max(round(tall), 1) + label + gap
    widths = [[max(round(aspect * tall), 1) for aspect in row] for row in rows]
    totals = [sum(row) + gap * (len(row) - 1) for row in widths]
    width = width or round(max(totals) + 2 * margin + beside)
    top = margin if height is None else (height - below - len(rows) * step + gap) / 2
    places = []
    for number, (row, total) in enumerate(zip(widths, totals, strict=True)):
        left, line = (width - beside - total) / 2, []
        for cell in row:
            line.append(Place(int(left), int(top + number * step), cell, max(round(tall), 1)))
            left += cell + gap
        places.append(tuple(line))
    end = top + len(rows) * step
    height = height or round(end - gap + below + margin / 2)
    if upright:
        middle = (top + end - label - gap) / 2
        half = min((end - label - gap - top) / 2, scale * _UPRIGHT_LENGTH / 2)
        left = (width - beside + max(totals)) / 2 + scale * _OFFSET_BEFORE
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
    up: Up | None = None,
) -> Image.Image:
    """Source (blue frame), the source on its way, at tau (black frame), and target (red frame).

    Parameters
    ----------
    times
        When to show the source besides 0 and tau; by default at quarters of tau.
    size
        Width and height in pixels; by default a wide sheet that fits the shape.
    channel, up
        Which of several pairs of functions to show, and the axis that points upwards.
    """
    tau = match.parameters.tau
    moments = sorted({*(tau * np.array([0.25, 0.5, 0.75]) if times is None else times), tau})

    def panel(function: FloatArray, label: str, frame: Frame = "other") -> Panel:
        values = Values(function.reshape(len(function), -1)[:, channel])
        meant = match.facts.tone if frame == "result" else "ink"
        return Panel(match.mesh, values, label, frame, tone="" if meant == "ink" else meant)

    panels = [panel(match.source, "source", "source")]
    for time, values in zip(moments, match.advect(moments), strict=True):
        if time == tau:
            panels.append(panel(values, f"t = {time:.4g}, {match.facts.headline}", "result"))
        else:
            panels.append(panel(values, f"t = {time:.4g}"))
    return _one_row(Sheet(((*panels, panel(match.target, "target", "target")),), up), size)


def sequence_picture(
    sequence: abfm.Sequence,
    times: Sequence[float] | None = None,
    size: tuple[int, int] | None = None,
    channel: int = 0,
    up: Up | None = None,
) -> Image.Image:
    """Draw the function at some times, by default evenly spread over all, with arrows of the field
    then, which fade where frames do not determine it. Other parameters are those of
    `match_picture`.
    """
    begin, end = float(sequence.times[0]), float(sequence.times[-1])
    panels = []
    for time in np.linspace(begin, end, _MOMENTS).tolist() if times is None else times:
        function = sequence.at(time).reshape(len(sequence.mesh.vertices), -1)[:, channel]
        i = sequence.interval(time)
        field, share = sequence.velocity[i], sequence.determined[i]
        label = f"t = {time:.4g} {sequence.unit_of_time}".rstrip()
        panels.append(Panel(sequence.mesh, Values(function), label, arrows=field, determined=share))
    changing = sequence.frames[:, :, channel].std(axis=0)
    return _one_row(Sheet((tuple(panels),), up, seen=(changing,)), size)


SHEETS: Mapping[type, Callable[..., Image.Image]] = {
    Match: match_picture,
    abfm.Sequence: sequence_picture,
}
"""What draws a sheet of a result by its type, with the parameters of `match_picture`."""


def _one_row(sheet: Sheet, size: tuple[int, int] | None) -> Image.Image:
    """Draw panels of one surface, in lines that fit the size."""
    views = cameras(sheet)
    (view,) = views.values()
    layout = grid(len(sheet.rows[0]), view.aspect, size)
    return sheet_picture(sheet, views, layout, ImageFont.load_default)


def figure_picture(sheet: Sheet, notes: Sequence[str] = ()) -> Image.Image:
    """Draw a figure, with notes below it; a `DrawingError` says why the machine cannot."""
    views = cameras(sheet, _ASPECTS)
    usual = max(next(iter(views.values())).aspect if views else 1.0, 0.7)

    def aspect(cell: Panel | Plot) -> float:
        return views[cell.mesh].aspect if isinstance(cell, Panel) else cell.width * usual

    aspects = [[aspect(cell) for cell in row] for row in sheet.rows]
    return sheet_picture(
        sheet, views, laid_out(aspects, len(color_ranges(sheet))), pictures.plot_font, notes
    )


def grid(count: int, aspect: float, size: tuple[int, int] | None = None) -> Layout:
    """Lay out panels as large as a size allows, or on a sheet of pleasant proportions."""
    width, height = size or (DEFAULT_WIDTH, None)
    scale = 1.0
    if height is not None:
        scale = max(_SCALE_MIN, min(width / DEFAULT_WIDTH, height / _DEFAULT_HEIGHT))
    candidates = []
    for columns in sorted({math.ceil(count / rows) for rows in range(1, count + 1)}):
        rows = [[aspect] * columns] * math.ceil(count / columns)
        candidates.append(laid_out(rows, 1, True, (width, height), scale))
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
    """Draw the cells of a sheet, row by row, at the places of a layout, and notes below them."""
    ranges, scale = color_ranges(sheet), layout.scale
    small = font(scale * _SMALL_TEXT_SIZE)
    lines = wrapped(notes, layout.width - 2 * MARGIN, small.getlength)
    room = _LINE_HEIGHT * len(lines) + MARGIN // 2 if lines else 0
    picture = Image.new("RGB", (layout.width, layout.height + room), "white")
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
        fits = place.width + scale * GAP - 4
        sizes_down = [scale * size for size in range(_TEXT_SIZE, _TEXT_SIZE_MIN - 1, -1)]
        fitting = (size for size in sizes_down if font(size).getlength(cell.label) <= fits)
        written = font(next(fitting, sizes_down[-1]))
        middle = (place.left + place.width / 2, place.top + place.height + scale * LABEL / 2)
        label = abbreviated(cell.label, fits, written.getlength)
        draw.text(middle, label, fill=color, font=written, anchor="mm")
    inks = replace(LIGHT_PALETTE, muted=LIGHT_PALETTE.ink)
    pen = Pen(scale, 1.2 * scale * _SMALL_TEXT_SIZE, small.getlength, inks, scale * _TICK_LENGTH)
    for (title, colors), rect in zip(ranges.items(), layout.bars, strict=True):
        letter(picture, bar_parts(title, colors, rect, pen, layout.upright), pen, small)
    for number, line in enumerate(lines):
        start = (MARGIN, layout.height + _LINE_HEIGHT * (number + 0.5))
        draw.text(start, line, fill=_INK, font=small, anchor="lm")
    return picture


def wrapped(texts: Sequence[str], width: float, width_of: Callable[[str], float]) -> list[str]:
    """Break texts into lines of a width in pixels at most; a long word stays."""
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
