"""What is written over the surfaces: their names and the colour bars."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import polyscope.imgui as imgui

from abfm_viewer.colormaps import ColorRange, table
from abfm_viewer.scene import Scene
from abfm_viewer.theme import Color
from abfm_viewer.ui import Rect, Ui

_BAR_WIDTH, _BAR_HEIGHT, _STEPS = 200, 12, 64


@dataclass(frozen=True)
class Bar:
    """A colour bar: what it is of, and its range."""

    title: str
    colors: ColorRange


def bars(scene: Scene) -> list[Bar]:
    """The colour bars that the surfaces need, without repetition."""
    found: dict[str, Bar] = {}
    for name in scene.names:
        paint = scene.paints.get(name)
        if paint is not None and paint.colors is not None:
            found[paint.bar] = Bar(paint.bar, paint.colors)
    return list(found.values())


def draw_annotations(ui: Ui, scene: Scene, rect: Rect, color_bar: bool = True) -> None:
    """Draw names and colour bars behind the panels."""
    canvas = imgui.GetBackgroundDrawList()
    inks = {"source": ui.colors.source, "target": ui.colors.target}
    for name, (x, y) in scene.labels().items():
        paint = scene.paints.get(name)
        text = paint.title if paint else name
        width, height = imgui.CalcTextSize(text)
        y = max(y - 1.6 * height, rect[1] + ui.px(6))
        canvas.AddText((x - width / 2, y), _u32(inks.get(name, ui.colors.ink)), text)
    if color_bar:
        left = rect[0] + ui.px(18)
        for bar in bars(scene):
            _draw_bar(ui, bar, left, rect[3] - ui.px(14))
            left += ui.px(_BAR_WIDTH + 48)


def _draw_bar(ui: Ui, bar: Bar, left: float, bottom: float) -> None:
    canvas = imgui.GetBackgroundDrawList()
    line = imgui.GetTextLineHeight()
    width, height = ui.px(_BAR_WIDTH), ui.px(_BAR_HEIGHT)
    top = bottom - line - height - ui.px(4)
    colors = table(bar.colors.colormap, _STEPS)
    edges = np.linspace(left, left + width, _STEPS + 1)
    for color, start, end in zip(colors, edges[:-1], edges[1:], strict=True):
        red, green, blue = map(float, color)
        canvas.AddRectFilled((start, top), (end + 0.5, top + height), _u32((red, green, blue, 1.0)))
    canvas.AddText((left, top - line - ui.px(3)), _u32(ui.colors.muted), bar.title)
    for value, share in ((bar.colors.low, 0.0), ((bar.colors.low + bar.colors.high) / 2, 0.5), (bar.colors.high, 1.0)):
        text = f"{value:.3g}"
        offset = share * width - share * imgui.CalcTextSize(text)[0]
        canvas.AddText((left + offset, top + height + ui.px(3)), _u32(ui.colors.ink), text)


def _u32(color: Color) -> int:
    return int(imgui.GetColorU32(color))
