"""What is written over the surfaces, in the window and in pictures: names and colour bars."""

from collections.abc import Sequence
from functools import cache
from itertools import pairwise

import numpy as np
import polyscope.imgui as imgui

from abfm_viewer.appearance.abbreviation import cut
from abfm_viewer.appearance.colormaps import table
from abfm_viewer.appearance.theme import Color
from abfm_viewer.document.document import triple
from abfm_viewer.scene.color_bars import (
    GAP,
    Line,
    Part,
    Pen,
    Strip,
    Text,
    bar_parts,
    bars_in_a_line,
)
from abfm_viewer.scene.scene import Scene
from abfm_viewer.widgets.toolkit import Ui
from abfm_viewer.widgets.widget_record import Rect

_STEPS = 64
# Lengths in pixels at a scale of 1.
_BAR_WIDTH, _BAR_HEIGHT, _APART, _LEFT, _BELOW, _ABOVE = 200, 12, 48, 18, 14, 10


_MOST = 0.25  # of the height: where bars would take more, each is one line


def bar_room(pen: Pen, height: float) -> float:
    """Height of what the colour bars cover at the bottom of so much."""
    room = 2 * pen.line + pen.scale * (_ABOVE + _BAR_HEIGHT + 2 * GAP + _BELOW)
    return room if room <= _MOST * height else pen.line + 4 * GAP * pen.scale


def name_height(pen: Pen) -> float:
    """Return the height of a surface's name, with the room around it."""
    return pen.line + 4 * GAP * pen.scale


def laid_out(
    scene: Scene, rect: Rect, pen: Pen, color_bar: bool = True, labels: bool = True
) -> list[Part]:
    """Lay out everything to write, in a rectangle of the window or picture."""
    names = _names(scene, pen) if labels else []
    borders = [Line(ends, pen.inks.border, pen.scale) for ends in scene.borders()]
    return [*borders, *names, *(_bars(scene, rect, pen) if color_bar else [])]


def _names(scene: Scene, pen: Pen) -> list[Text]:
    """Write the names of the surfaces, in the middle above them, or ending at their left."""
    inks = {"source": pen.inks.source, "target": pen.inks.target}
    found = []
    for name, (left, top, right, bottom) in scene.labels().items():
        title = cut(_title(scene, name), right - left - 4 * pen.scale, pen.width)
        length = pen.width(title)
        start = right - length if scene.view.is_beside else (left + right - length) / 2
        ink = inks.get(name, pen.inks.ink)
        found.append(Text(start, (top + bottom - pen.line) / 2, title, ink))
    return found


def _title(scene: Scene, name: str) -> str:
    return scene.paints[name].title if name in scene.paints else f"{name}: computing"


def _bars(scene: Scene, rect: Rect, pen: Pen) -> list[Part]:
    """Lay out a bar for each range, side by side, narrower where there is little room."""
    paints = [scene.paints[name] for name in scene.shown if name in scene.paints]
    ranges = {paint.bar: paint.colors for paint in paints if paint.colors is not None}
    left, apart, count = rect[0] + _LEFT * pen.scale, _APART * pen.scale, max(len(ranges), 1)
    room = (rect[2] - _LEFT * pen.scale - left - (count - 1) * apart) / count
    bottom = rect[3] - (_BELOW + GAP) * pen.scale - pen.line
    covered = bar_room(pen, rect[3] - rect[1])
    if covered < 2 * pen.line:
        top = rect[3] - (covered + pen.line) / 2
        line = (left, top, rect[2] - _LEFT * pen.scale / 2, top + pen.line)
        return bars_in_a_line(ranges, line, pen)
    found: list[Part] = []
    top = bottom - _BAR_HEIGHT * pen.scale
    for title, shown in ranges.items():
        right = left + min(max(_BAR_WIDTH * pen.scale, pen.width(title)), max(room, apart))
        found += bar_parts(
            title, shown, (left, bottom - _BAR_HEIGHT * pen.scale, right, bottom), pen
        )
        left = right + apart
    return found


def window_pen(ui: Ui) -> Pen:
    """Return the pen of the window, at its present scale."""
    line = imgui.GetTextLineHeight()
    return Pen(ui.scale, line, lambda text: float(imgui.CalcTextSize(text)[0]), ui.colors)


def draw_annotations(ui: Ui, scene: Scene, rect: Rect, color_bar: bool = True) -> None:
    """Draw names, colour bars and lines between slots behind the panels."""
    canvas = imgui.GetBackgroundDrawList()
    tell_names(ui, scene)
    parts = laid_out(scene, rect, window_pen(ui), color_bar)
    tell_titles(parts, imgui.GetTextLineHeight())
    for one in parts:
        if isinstance(one, Text):
            canvas.AddText((one.left, one.top), _u32(one.color), one.text)
        elif isinstance(one, Line):
            for start, end in pairwise(one.points):
                canvas.AddLine(start, end, _u32(one.color), one.width)
        elif isinstance(one, Strip):
            left, top, right, bottom = one.rect
            edges = np.linspace(left, right, _STEPS + 1)
            for color, start, end in zip(_shades(one.colormap), edges[:-1], edges[1:], strict=True):
                canvas.AddRectFilled((start, top), (end + 0.5, bottom), color)


def tell_names(ui: Ui, scene: Scene) -> None:
    """Show the whole name where the mouse is over one that is cut."""
    if imgui.GetIO().WantCaptureMouse:
        return
    x, y = imgui.GetMousePos()
    for name, (left, top, right, bottom) in scene.labels().items():
        title = _title(scene, name)
        is_cut = ui.text_width(title) > right - left - ui.px(4)
        if is_cut and left <= x < right and top <= y < bottom:
            imgui.SetTooltip(title)


def tell_titles(parts: Sequence[Part], around: float) -> None:
    """Show the whole title where the mouse is at a colour bar that has no room for it."""
    if imgui.GetIO().WantCaptureMouse:
        return
    x, y = imgui.GetMousePos()
    for one in parts:
        if isinstance(one, Strip) and one.title:
            left, top, right, bottom = one.rect
            if left - around <= x < right + around and top - around <= y < bottom + around:
                imgui.SetTooltip(one.title)


@cache
def _shades(colormap: str) -> list[int]:
    return [_u32((*triple(color), 1.0)) for color in table(colormap, _STEPS)]


def _u32(color: Color) -> int:
    return int(imgui.GetColorU32(color))
