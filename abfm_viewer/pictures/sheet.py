"""A sheet of pictures: tiles in a grid with frames and labels, and a colour bar at the right."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from abfm_viewer.appearance.colormaps import ColorRange, table

DEFAULT_WIDTH = 1800
_PLEASANT_ASPECT = 2.4
_INK = "#222222"
# Lengths in the unit of a sheet, which is a pixel on a sheet of the default width.
_MARGIN, _GAP, _LABEL, _BAR, _FONT = 24, 16, 40, 110, 23


@dataclass(frozen=True)
class Grid:
    """Size of a sheet and of its tiles, in pixels; `unit` scales text, gaps and frames."""

    width: int
    height: int
    columns: int
    rows: int
    tile_width: int
    tile_height: int
    unit: float

    def corner(self, index: int) -> tuple[int, int]:
        """Upper left corner of a tile; the grid is centred in what the colour bar leaves."""
        row, column = divmod(index, self.columns)
        step_x, step_y = self.tile_width + self.unit * _GAP, self.tile_height + self.unit * (_LABEL + _GAP)
        left = (self.width - self.unit * _BAR - self.columns * step_x + self.unit * _GAP) / 2
        top = (self.height - self.rows * step_y + self.unit * _GAP) / 2
        return round(left + column * step_x), round(top + row * step_y)


def grid(count: int, aspect: float, size: tuple[int, int] | None = None) -> Grid:
    """Lay out tiles of a given width over height: as large as a size allows, or on a sheet of pleasant proportions."""
    even = {math.ceil(count / rows) for rows in range(1, count + 1)}
    candidates = [_grid(count, columns, aspect, size) for columns in sorted(even)]
    if size is None:
        return min(candidates, key=lambda g: abs(math.log(g.width / g.height / _PLEASANT_ASPECT)))
    return max(candidates, key=lambda g: g.tile_width)


def _grid(count: int, columns: int, aspect: float, size: tuple[int, int] | None) -> Grid:
    rows = math.ceil(count / columns)
    width, height = size or (DEFAULT_WIDTH, 0)
    unit = max(0.6, min(width / DEFAULT_WIDTH, height / 700)) if size else 1.0
    frame_x = unit * (_BAR + 2 * _MARGIN + (columns - 1) * _GAP)
    frame_y = unit * (2 * _MARGIN + rows * _LABEL + (rows - 1) * _GAP)
    tile_width = (width - frame_x) / columns
    if size is None:
        height = round(rows * tile_width / aspect + frame_y)
    else:
        tile_width = min(tile_width, aspect * (height - frame_y) / rows)
    return Grid(width, height, columns, rows, max(1, int(tile_width)), max(1, int(tile_width / aspect)), unit)


@dataclass(frozen=True)
class Tile:
    """A picture of the grid's tile size, the label below it, and the frame: a colour, thin unless it is `bold`."""

    picture: Image.Image
    label: str
    frame: str
    bold: bool


def compose(layout: Grid, tiles: list[Tile], colors: ColorRange) -> Image.Image:
    """Draw a sheet, white, without transparency."""
    sheet = Image.new("RGB", (layout.width, layout.height), "white")
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(_FONT * layout.unit)
    for index, tile in enumerate(tiles):
        x, y = layout.corner(index)
        right, bottom = x + layout.tile_width, y + layout.tile_height
        sheet.paste(tile.picture, (x, y), tile.picture)
        draw.rectangle(
            (x, y, right, bottom), outline=tile.frame, width=max(1, round(layout.unit * (5 if tile.bold else 1.5)))
        )
        ink = tile.frame if tile.bold else _INK
        draw.text(((x + right) / 2, bottom + layout.unit * _LABEL / 2), tile.label, fill=ink, font=font, anchor="mm")
    _draw_color_bar(draw, layout, colors)
    return sheet


def _draw_color_bar(draw: ImageDraw.ImageDraw, layout: Grid, colors: ColorRange) -> None:
    font = ImageFont.load_default(0.85 * _FONT * layout.unit)
    _, top = layout.corner(0)
    bottom = layout.corner(layout.columns * (layout.rows - 1))[1] + layout.tile_height
    middle, half = (top + bottom) / 2, min((bottom - top) / 2, layout.unit * 280)
    low_y, high_y = round(middle + half), round(middle - half)
    right_column, _ = layout.corner(layout.columns - 1)
    left = round(right_column + layout.tile_width + layout.unit * 1.6 * _GAP)
    right = round(left + layout.unit * 20)
    for row, color in enumerate(np.round(255 * table(colors.colormap, low_y - high_y + 1)[::-1]).astype(int)):
        draw.line((left, high_y + row, right, high_y + row), fill=tuple(color))
    draw.rectangle((left, high_y, right, low_y), outline=_INK, width=max(1, round(layout.unit)))
    for value in ticks(colors.low, colors.high):
        y = low_y + (value - colors.low) / (colors.high - colors.low) * (high_y - low_y)
        draw.line((right, y, right + layout.unit * 6, y), fill=_INK, width=max(1, round(1.5 * layout.unit)))
        draw.text((right + layout.unit * 11, y), f"{value:.4g}", fill=_INK, font=font, anchor="lm")


def ticks(low: float, high: float) -> list[float]:
    """Three to seven round numbers between two values."""
    rough = (high - low) / 6
    power = 10 ** math.floor(math.log10(rough))
    step = next(factor * power for factor in (1, 2, 2.5, 5, 10) if factor * power >= rough)
    return [step * k for k in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)]
