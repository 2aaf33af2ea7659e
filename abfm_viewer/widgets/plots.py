"""Plots with a logarithmic axis of residuals in percent, and legends."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import polyscope.imgui as imgui
import polyscope.implot as implot

from abfm.types import FloatArray
from abfm_viewer.appearance.axes import share_ticks
from abfm_viewer.appearance.theme import Color
from abfm_viewer.widgets.toolkit import Ui

_HEIGHT_MIN = 150
_HEIGHT_MAX = 240
_TRANSPARENT_COLOR = (0.0, 0.0, 0.0, 0.0)
_FLAGS = (
    implot.ImPlotFlags_NoTitle
    | implot.ImPlotFlags_NoMenus
    | implot.ImPlotFlags_NoLegend  # our own legend wraps in a narrow panel
    | implot.ImPlotFlags_NoBoxSelect
    | implot.ImPlotFlags_NoMouseText
    | implot.ImPlotFlags_NoInputs  # the wheel scrolls the panel
)
# minimum ratio between the ends of the vertical axis, and margin at each end
_AXIS_FACTOR_MIN = 2.0
_MARGIN = 0.1
_RESIDUAL_MAX = 10.0  # larger residuals, of an unstable discrete flow, are not drawn
_HEADROOM = 0.14  # height above the curves for the names of sections, relative to the curves


class Line(NamedTuple):
    """A line in a legend."""

    color: Color
    weight: float  # in pixels
    is_vertical: bool = False


@contextmanager
def plot(ui: Ui, label: str) -> Iterator[bool]:
    """Draw a plot as high as the panel allows; yield whether it is visible."""
    colors = {
        implot.ImPlotCol_FrameBg: _TRANSPARENT_COLOR,
        implot.ImPlotCol_PlotBg: ui.colors.ground,
        implot.ImPlotCol_PlotBorder: ui.colors.border,
        implot.ImPlotCol_AxisGrid: ui.colors.border,
        implot.ImPlotCol_AxisTick: _TRANSPARENT_COLOR,
    }
    for index, color in colors.items():
        implot.PushStyleColor(index, color)
    height = min(max(imgui.GetContentRegionAvail()[1], ui.px(_HEIGHT_MIN)), ui.px(_HEIGHT_MAX))
    is_drawn = bool(implot.BeginPlot(f"##{label}", (-1, height), _FLAGS))
    try:
        yield is_drawn
    finally:
        if is_drawn:
            implot.EndPlot()
        implot.PopStyleColor(len(colors))
        ui.record_item(label, "plot")


def set_up(
    title: str, ends: tuple[float, float], shares: Sequence[FloatArray], has_sections: bool = False
) -> None:
    """Set up a horizontal axis with limits, and a logarithmic axis for residuals in percent.

    ``shares`` are the residuals of all curves, as fractions. If ``has_sections``, space remains
    above the curves for `sections`.
    """
    low, high = _around(np.concatenate([positive(values) for values in shares]))
    high *= (high / low) ** (_HEADROOM if has_sections else 0)
    across, up = implot.ImAxis_X1, implot.ImAxis_Y1
    implot.SetupAxis(across, title, implot.ImPlotAxisFlags_None)
    implot.SetupAxisLimits(across, *map(float, ends), implot.ImPlotCond_Always)
    implot.SetupAxis(up, "residual", implot.ImPlotAxisFlags_None)
    implot.SetupAxisScale(up, implot.ImPlotScale_Log10)
    implot.SetupAxisLimits(up, low, high, implot.ImPlotCond_Always)
    ticks = share_ticks(low, high)
    implot.SetupAxisTicks(up, np.array(ticks), [f"{100 * tick:g}%" for tick in ticks])


def set_up_linear(title: str, ends: tuple[float, float], up_title: str, values: FloatArray) -> None:
    """Set up two linear axes with titles; the vertical one starts at 0."""
    known = values[np.isfinite(values)]
    high = float(known.max()) if len(known) and known.max() > 0 else 1.0
    across, up = implot.ImAxis_X1, implot.ImAxis_Y1
    implot.SetupAxis(across, title, implot.ImPlotAxisFlags_None)
    implot.SetupAxisLimits(across, *map(float, ends), implot.ImPlotCond_Always)
    implot.SetupAxis(up, up_title, implot.ImPlotAxisFlags_None)
    implot.SetupAxisLimits(up, 0.0, 1.1 * high, implot.ImPlotCond_Always)


def span(start: float, end: float, color: Color) -> None:
    (_, top), (_, height) = implot.GetPlotPos(), implot.GetPlotSize()
    left, right = (implot.PlotToPixels(place, 1.0)[0] for place in (start, end))
    implot.PushPlotClipRect()
    corners = (left, top), (right, top + height)
    implot.GetPlotDrawList().AddRectFilled(*corners, imgui.GetColorU32(color))
    implot.PopPlotClipRect()


def sections(ui: Ui, names: Mapping[int, str], end: int) -> None:
    """Mark sections of a plot by a line at each start and a tint of every second one.

    ``names`` are the names of the sections by their start. A name is written at the top of its
    section; if it is too long, it is abbreviated. ``end`` is the end of the last section.
    """
    top = implot.GetPlotPos()[1] + ui.px(2)
    for number, (start, after) in enumerate(pairwise([*names, end])):
        if number % 2:
            span(start, after, (*ui.colors.marker[:3], 0.1))
        if number:
            vertical_lines(f"##section {number}", [start], ui.colors.marker, ui.px(1.5))
        left, right = (float(implot.PlotToPixels(float(x), 1.0)[0]) for x in (start, after))
        name = ui.fitted(names[start], right - left - ui.px(6))
        if name.strip("."):
            draw_list, place = implot.GetPlotDrawList(), (left + ui.px(4), top)
            corner = place[0] + ui.text_width(name), top + imgui.GetTextLineHeight()
            draw_list.AddRectFilled(place, corner, imgui.GetColorU32(ui.colors.ground))
            draw_list.AddText(place, imgui.GetColorU32(ui.colors.marker), name)


def _around(values: FloatArray) -> tuple[float, float]:
    """Return limits of a logarithmic axis for values, with margins for markers."""
    known = values[np.isfinite(values)]
    low, high = (known.min(), known.max()) if len(known) else (0.1, 1.0)
    factor = max((high / low) ** _MARGIN, np.sqrt(max(_AXIS_FACTOR_MIN * low / high, 1.0)))
    return float(low / factor), float(high * factor)


def positive(values: FloatArray) -> FloatArray:
    """Return residuals with NaN in place of those that a plot does not show."""
    return np.where((values > 0) & (values <= _RESIDUAL_MAX), values, np.nan)


def line(
    label: str, y: FloatArray, color: Color, weight: float, x: FloatArray | None = None
) -> None:
    """Draw a line; ``x`` is by default the index of the values."""
    implot.SetNextLineStyle(color, weight)
    implot.PlotLine(label, np.arange(float(len(y))) if x is None else x, positive(y))


def vertical_lines(label: str, places: Sequence[float], color: Color, weight: float) -> None:
    if len(places):
        implot.SetNextLineStyle(color, weight)
        implot.PlotInfLines(label, np.array(places, dtype=np.float64))


def horizontal_line(label: str, value: float, color: Color, weight: float) -> None:
    implot.SetNextLineStyle(color, weight)
    implot.PlotInfLines(label, np.array([value]), implot.ImPlotInfLinesFlags_Horizontal)


def dots(
    label: str, places: tuple[FloatArray, FloatArray], size: float, colors: tuple[Color, Color]
) -> None:
    (x, y), (fill, edge) = places, colors
    implot.SetNextMarkerStyle(implot.ImPlotMarker_Circle, size, fill, size / 3, edge)
    implot.PlotScatter(label, x, positive(y))


def is_under_mouse() -> bool:
    (left, top), (width, height) = implot.GetPlotPos(), implot.GetPlotSize()
    x, y = imgui.GetMousePos()
    inside = left <= x <= left + width and top <= y <= top + height
    return bool(imgui.IsWindowHovered()) and inside


def tooltip(ui: Ui, text: str) -> None:
    """Show a tooltip next to the panel, where it does not cover the plot."""
    place = imgui.GetWindowPos()[0] - ui.px(12), imgui.GetMousePos()[1]
    imgui.SetNextWindowPos(place, imgui.ImGuiCond_Always, (1.0, 0.5))
    imgui.SetTooltip(text)


def legend(ui: Ui, marks: Mapping[str, Color | Line]) -> None:
    """Draw a legend that wraps; a mark is a square of a colour, or a line."""
    high, (_, spacing) = imgui.GetTextLineHeight(), imgui.GetStyle().ItemSpacing
    for number, (name, mark) in enumerate(marks.items()):
        if number:
            ui.same_line_if_fits(name)
        (left, top), draw_list = imgui.GetCursorScreenPos(), imgui.GetWindowDrawList()
        middle, side = top + high / 2, 0.6 * high
        if isinstance(mark, Line):
            ink, side = imgui.GetColorU32(mark.color), side if mark.is_vertical else high
            ends = ((left, middle), (left + side, middle))
            if mark.is_vertical:
                ends = ((left + side / 2, top), (left + side / 2, top + high))
            draw_list.AddLine(*ends, ink, mark.weight)
        else:
            corners = ((left, middle - side / 2), (left + side, middle + side / 2))
            draw_list.AddRectFilled(*corners, imgui.GetColorU32(mark))
        imgui.Dummy((side, side))
        ui.same_line(spacing)
        ui.line(name, "ink")
