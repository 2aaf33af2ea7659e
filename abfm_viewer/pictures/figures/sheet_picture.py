"""A figure's sheet as one picture: panels in coloured frames, plots, labels and colour bars."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw

from abfm.experiments.sheet import Frame, Panel, Plot, Sheet
from abfm_viewer.appearance.abbreviation import cut
from abfm_viewer.appearance.colormaps import ColorRange, table
from abfm_viewer.pictures.figures.layout import BARS, GAP, LABEL, MARGIN, Layout, Place, laid_out
from abfm_viewer.pictures.figures.panel_pictures import cameras, panel_pictures
from abfm_viewer.pictures.figures.plot_pictures import font, plot_picture
from abfm_viewer.pictures.figures.ranges import captions, color_ranges, panels
from abfm_viewer.pictures.sheet import ticks

_FRAMES: dict[Frame, tuple[str, int]] = {
    "source": ("#2455c3", 5),
    "target": ("#c62828", 5),
    "result": ("#111111", 5),
    "field": ("#8a909c", 5),
    "other": ("#d0d4db", 2),
}
"""Colour and width in pixels of each frame."""
_INK = "#1d222b"
_TEXT, _SMALL, _SMALLEST = 24, 20, 13
_LINE = 28
_BAR_WIDTH, _BAR_HEIGHT, _BAR_GAP = 380, 20, 90


def sheet_picture(sheet: Sheet) -> Image.Image:
    """Draw a figure.

    Raises
    ------
    DrawingError
        Where the machine cannot draw.
    """
    views = cameras(sheet)
    ranges = color_ranges(sheet)
    usual = next(iter(views.values())).aspect if views else 1.0
    aspects = [
        [views[cell.mesh].aspect if isinstance(cell, Panel) else cell.width * max(usual, 0.7) for cell in row]
        for row in sheet.rows
    ]
    layout = laid_out(aspects, bool(ranges))
    lines = wrapped(captions(sheet), layout.width - 2 * MARGIN)
    room = _LINE * len(lines) + MARGIN // 2 if lines else 0
    picture = Image.new("RGB", (layout.width, layout.height + room), "white")
    draw = ImageDraw.Draw(picture)
    cells = [
        (cell, place)
        for row, line in zip(sheet.rows, layout.rows, strict=True)
        for cell, place in zip(row, line, strict=True)
    ]
    sizes = [(place.width, place.height) for cell, place in cells if isinstance(cell, Panel)]
    drawings = iter(panel_pictures(sheet, sizes, ranges, views) if panels(sheet) else [])
    for cell, place in cells:
        corner = (place.left, place.top)
        if isinstance(cell, Plot):
            picture.paste(plot_picture(cell, (place.width, place.height), _SMALL), corner)
        else:
            drawing = next(drawings)
            picture.paste(drawing, corner, drawing)
            _draw_frame(draw, cell.frame, place)
        _write_label(draw, cell, place)
    _draw_bars(draw, layout, ranges)
    for number, line in enumerate(lines):
        draw.text((MARGIN, layout.height + _LINE * (number + 0.5)), line, fill=_INK, font=font(_SMALL), anchor="lm")
    return picture


def wrapped(texts: Sequence[str], width: float) -> list[str]:
    """Texts broken into lines of a width in pixels at most, as a sheet's captions are written; a long word stays."""
    lines = []
    for text in texts:
        line = ""
        for word in text.split():
            longer = f"{line} {word}".strip()
            if line and font(_SMALL).getlength(longer) > width:
                lines.append(line)
                longer = word
            line = longer
        lines.append(line)
    return lines


def _draw_frame(draw: ImageDraw.ImageDraw, frame: Frame, place: Place) -> None:
    color, width = _FRAMES[frame]
    corners = (place.left, place.top, place.left + place.width - 1, place.top + place.height - 1)
    draw.rectangle(corners, outline=color, width=width)


def _write_label(draw: ImageDraw.ImageDraw, cell: Panel | Plot, place: Place) -> None:
    plain = isinstance(cell, Plot) or cell.frame == "other"
    color = _INK if isinstance(cell, Plot) or plain else _FRAMES[cell.frame][0]
    room = place.width + GAP - 4
    size = next((size for size in range(_TEXT, _SMALLEST, -1) if font(size).getlength(cell.label) <= room), _SMALLEST)
    middle = (place.left + place.width / 2, place.top + place.height + LABEL / 2)
    draw.text(middle, cut(cell.label, room, font(size).getlength), fill=color, font=font(size), anchor="mm")


def _draw_bars(draw: ImageDraw.ImageDraw, layout: Layout, ranges: dict[str, ColorRange]) -> None:
    """The colour bars, side by side below everything."""
    count = len(ranges)
    room = (layout.width - 2 * _BAR_GAP) / max(count, 1)
    width = round(min(_BAR_WIDTH, room - _BAR_GAP / 2))
    for number, (title, colors) in enumerate(ranges.items()):
        middle = _BAR_GAP + (number + 0.5) * room
        left, top = round(middle - width / 2), layout.bars_top + BARS // 2 - _BAR_HEIGHT - 6
        for column, color in enumerate(np.round(255 * table(colors.colormap, width)).astype(int)):
            draw.line((left + column, top, left + column, top + _BAR_HEIGHT), fill=tuple(color))
        draw.rectangle((left, top, left + width, top + _BAR_HEIGHT), outline=_INK)
        draw.text((middle, top - 6), title, fill=_INK, font=font(_SMALL), anchor="ms")
        for value in readable(ticks(colors.low, colors.high), colors, width):
            x = left + (value - colors.low) / (colors.high - colors.low) * width
            draw.line((x, top + _BAR_HEIGHT, x, top + _BAR_HEIGHT + 6), fill=_INK)
            draw.text((x, top + _BAR_HEIGHT + 9), _number(value), fill=_INK, font=font(_SMALL - 2), anchor="mt")


def readable(values: list[float], colors: ColorRange, width: int) -> list[float]:
    """Those of a bar's ticks whose numbers stand apart in its width in pixels: all, or every second, third, ..."""
    if len(values) < 2:
        return values
    apart = (values[1] - values[0]) / (colors.high - colors.low) * width
    needed = max(font(_SMALL - 2).getlength(_number(value)) for value in values) + _SMALL / 2
    every = math.ceil(needed / apart)
    step = values[1] - values[0]
    return [value for value in values if round(value / step) % every == 0]


def _number(value: float) -> str:
    return f"{value:.4g}"
