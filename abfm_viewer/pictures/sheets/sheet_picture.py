"""A sheet as one picture: panels in coloured frames, plots, labels and colour bars."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from PIL import Image, ImageDraw

from abfm import TriangleMesh
from abfm.io.sheets import Frame, Panel, Plot, Sheet
from abfm_viewer import pictures
from abfm_viewer.appearance.abbreviation import cut
from abfm_viewer.appearance.theme import LIGHT
from abfm_viewer.pictures.lettering import Font, letter, rgb
from abfm_viewer.pictures.sheets.layout import GAP, LABEL, MARGIN, Layout
from abfm_viewer.pictures.sheets.panel_pictures import panel_pictures
from abfm_viewer.pictures.sheets.ranges import color_ranges
from abfm_viewer.scene.annotations import Pen, bar_parts
from abfm_viewer.scene.camera import Camera

_FRAMES: dict[Frame, tuple[str, float]] = {  # colours and widths
    "source": ("#2455c3", 5),
    "target": ("#c62828", 5),
    "result": ("#111111", 5),
    "field": ("#8a909c", 5),
    "other": ("#d0d4db", 1.5),
}
_INK = "#1d222b"
_TONES = {"good": rgb(LIGHT.good), "failure": rgb(LIGHT.failure)}
# in pixels at a scale of 1
_TEXT, _SMALL, _SMALLEST, _LINE, _TICK = 24, 20, 13, 28, 6


def sheet_picture(
    sheet: Sheet,
    views: Mapping[TriangleMesh, Camera],
    layout: Layout,
    font: Callable[[float], Font],
    notes: Sequence[str] = (),
) -> Image.Image:
    """Draw the cells of a sheet, row by row, at the places of a layout, and notes below them in
    lines.

    A `DrawingError` says why the machine cannot.
    """
    ranges, scale = color_ranges(sheet), layout.scale
    small = font(scale * _SMALL)
    lines = wrapped(notes, layout.width - 2 * MARGIN, small.getlength)
    room = _LINE * len(lines) + MARGIN // 2 if lines else 0
    picture = Image.new("RGB", (layout.width, layout.height + room), "white")
    draw = ImageDraw.Draw(picture)
    cells = [cell for row in sheet.rows for cell in row]
    places = [place for row in layout.rows for place in row][: len(cells)]
    sizes = [
        (p.width, p.height)
        for cell, p in zip(cells, places, strict=True)
        if isinstance(cell, Panel)
    ]
    drawings = iter(panel_pictures(sheet, sizes, ranges, views))
    for cell, place in zip(cells, places, strict=True):
        corner: tuple[int, int] = (place.left, place.top)
        color: str | tuple[int, int, int] = _INK
        if isinstance(cell, Plot):
            picture.paste(
                pictures.plot_picture(cell, (place.width, place.height), scale * _SMALL), corner
            )
        else:
            drawing = next(drawings)
            picture.paste(drawing, corner, drawing)
            outline, width = _FRAMES[cell.frame]
            end = (place.left + place.width - 1, place.top + place.height - 1)
            draw.rectangle((corner, end), outline=outline, width=max(round(scale * width), 1))
            color = _TONES.get(cell.tone) or (outline if cell.frame != "other" else _INK)
        fits = place.width + scale * GAP - 4
        sizes_down = [scale * size for size in range(_TEXT, _SMALLEST - 1, -1)]
        fitting = (size for size in sizes_down if font(size).getlength(cell.label) <= fits)
        written = font(next(fitting, sizes_down[-1]))
        middle = (place.left + place.width / 2, place.top + place.height + scale * LABEL / 2)
        label = cut(cell.label, fits, written.getlength)
        draw.text(middle, label, fill=color, font=written, anchor="mm")
    inks = replace(LIGHT, muted=LIGHT.ink)
    pen = Pen(scale, 1.2 * scale * _SMALL, small.getlength, inks, scale * _TICK)
    for (title, colors), rect in zip(ranges.items(), layout.bars, strict=True):
        letter(picture, bar_parts(title, colors, rect, pen, layout.upright), pen, small)
    for number, line in enumerate(lines):
        start = (MARGIN, layout.height + _LINE * (number + 0.5))
        draw.text(start, line, fill=_INK, font=small, anchor="lm")
    return picture


def wrapped(texts: Sequence[str], width: float, width_of: Callable[[str], float]) -> list[str]:
    """Break texts into lines of a width in pixels at most; a long word stays."""
    lines = []
    for text in texts:
        line = ""
        for word in text.split():
            longer = f"{line} {word}".strip()
            if line and width_of(longer) > width:
                lines.append(line)
                longer = word
            line = longer
        lines.append(line)
    return lines
