"""What is written over the surfaces, in the window and in pictures: their names and the colour bars."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import polyscope.imgui as imgui

from abfm_viewer.appearance.abbreviation import cut
from abfm_viewer.appearance.colormaps import ColorRange, table
from abfm_viewer.appearance.theme import Color, Palette
from abfm_viewer.scene.scene import Scene
from abfm_viewer.widgets.toolkit import Ui
from abfm_viewer.widgets.widget_record import Rect

_STEPS = 64
# Lengths in pixels at a scale of 1.
_BAR_WIDTH, _BAR_HEIGHT, _APART, _LEFT, _BELOW, _ABOVE, _LINE_GAP = 200, 12, 48, 18, 14, 10, 3


@dataclass(frozen=True)
class Bar:
    """A colour bar: what it is of, and its range."""

    title: str
    colors: ColorRange


@dataclass(frozen=True)
class Text:
    """A line of text by its left upper corner."""

    left: float
    top: float
    text: str
    color: Color


@dataclass(frozen=True)
class Strip:
    """A rectangle with the colours of a map from left to right."""

    rect: Rect
    colormap: str


@dataclass(frozen=True)
class Pen:
    """How large things are written.

    Attributes
    ----------
    scale : float
        Of all lengths but the text's.
    line : float
        Height of a line.
    width : callable
        That of a text.
    """

    scale: float
    line: float
    width: Callable[[str], float]

    @property
    def bar_room(self) -> float:
        """Height of what the colour bars cover at the bottom."""
        return 2 * self.line + self.scale * (_ABOVE + _BAR_HEIGHT + 2 * _LINE_GAP + _BELOW)


def bars(scene: Scene) -> list[Bar]:
    """The colour bars that the surfaces need, without repetition."""
    found: dict[str, Bar] = {}
    for name in scene.names:
        paint = scene.paints.get(name)
        if paint is not None and paint.colors is not None:
            found[paint.bar] = Bar(paint.bar, paint.colors)
    return list(found.values())


def laid_out(
    scene: Scene, rect: Rect, colors: Palette, pen: Pen, color_bar: bool = True, labels: bool = True
) -> list[Text | Strip]:
    """Everything to write, in a rectangle of the window or picture."""
    found: list[Text | Strip] = [*_names(scene, rect, colors, pen)] if labels else []
    if color_bar:
        found += _bars(bars(scene), rect, colors, pen)
    return found


def _names(scene: Scene, rect: Rect, colors: Palette, pen: Pen) -> list[Text]:
    """Those of the surfaces; in a row each has the room up to its neighbours'."""
    places = scene.labels()
    centers = sorted(x for x, _ in places.values())
    room = min((right - left for left, right in pairwise(centers)), default=rect[2] - rect[0]) - 4 * pen.scale
    inks = {"source": colors.source, "target": colors.target}
    found = []
    for name, (x, y) in places.items():
        paint = scene.paints.get(name)
        title = paint.title if paint else name
        if scene.stacked:
            left, top = x - pen.width(title) - pen.line, y - pen.line / 2
        else:
            title = cut(title, room, pen.width)
            left, top = x - pen.width(title) / 2, max(y - 1.6 * pen.line, rect[1] + 6 * pen.scale)
        found.append(Text(left, top, title, inks.get(name, colors.ink)))
    return found


def _bars(needed: list[Bar], rect: Rect, colors: Palette, pen: Pen) -> list[Text | Strip]:
    """Colour bars side by side, narrower where there is little room."""
    found: list[Text | Strip] = []
    left, apart, count = rect[0] + _LEFT * pen.scale, _APART * pen.scale, max(len(needed), 1)
    room = (rect[2] - _LEFT * pen.scale - left - (count - 1) * apart) / count
    for bar in needed:
        width = min(max(_BAR_WIDTH * pen.scale, pen.width(bar.title)), max(room, apart))
        found += _bar(bar, left, rect[3], width, colors, pen)
        left += width + apart
    return found


def _bar(bar: Bar, left: float, bottom: float, width: float, colors: Palette, pen: Pen) -> list[Text | Strip]:
    gap = _LINE_GAP * pen.scale
    numbers = bottom - _BELOW * pen.scale - pen.line
    bottom = numbers - gap
    top = bottom - _BAR_HEIGHT * pen.scale
    found: list[Text | Strip] = [
        Text(left, top - gap - pen.line, cut(bar.title, width, pen.width), colors.muted),
        Strip((left, top, left + width, bottom), bar.colors.colormap),
    ]
    low, high = bar.colors.low, bar.colors.high
    texts = [f"{value:.3g}" for value in (low, (low + high) / 2, high)]
    first, middle, last = map(pen.width, texts)
    crowded = (width - middle) / 2 < max(first, last) + pen.line / 2
    for text, share in zip(texts, (0.0, 0.5, 1.0), strict=True):
        if share != 0.5 or not crowded:
            found.append(Text(left + share * (width - pen.width(text)), numbers, text, colors.ink))
    return found


def window_pen(ui: Ui) -> Pen:
    """The pen of the window, at its present scale."""
    return Pen(ui.scale, imgui.GetTextLineHeight(), lambda text: float(imgui.CalcTextSize(text)[0]))


def draw_annotations(ui: Ui, scene: Scene, rect: Rect, color_bar: bool = True) -> None:
    """Draw names and colour bars behind the panels."""
    canvas = imgui.GetBackgroundDrawList()
    pen = window_pen(ui)
    for one in laid_out(scene, rect, ui.colors, pen, color_bar):
        if isinstance(one, Text):
            canvas.AddText((one.left, one.top), _u32(one.color), one.text)
            continue
        left, top, right, bottom = one.rect
        edges = np.linspace(left, right, _STEPS + 1)
        for color, start, end in zip(table(one.colormap, _STEPS), edges[:-1], edges[1:], strict=True):
            red, green, blue = map(float, color)
            canvas.AddRectFilled((start, top), (end + 0.5, bottom), _u32((red, green, blue, 1.0)))


def _u32(color: Color) -> int:
    return int(imgui.GetColorU32(color))
