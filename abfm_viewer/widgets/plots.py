"""Plots with a logarithmic axis of residuals in percent, and legends."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

import numpy as np
import polyscope.imgui as imgui
import polyscope.implot as implot

from abfm.types import FloatArray
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
_MANTISSAS = ((1,), (1, 3), (1, 2, 5), (1, 2, 3, 5), (1, 1.5, 2, 3, 4, 5, 6, 8))
_TICKS_MIN = 3


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
    title: str, ends: tuple[float, float], shares: Sequence[FloatArray], inverted: bool = False
) -> None:
    """Set up a horizontal axis with limits, and a logarithmic axis for residuals in percent.

    ``shares`` are the residuals of all curves, as fractions. If ``inverted``, the horizontal axis
    points to the left.
    """
    low, high = _around(np.concatenate([positive(values) for values in shares]))
    across, up = implot.ImAxis_X1, implot.ImAxis_Y1
    flags = implot.ImPlotAxisFlags_Invert if inverted else implot.ImPlotAxisFlags_None
    implot.SetupAxis(across, title, flags)
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


def _around(values: FloatArray) -> tuple[float, float]:
    """Return limits of a logarithmic axis for values, with margins for markers."""
    known = values[np.isfinite(values)]
    low, high = (known.min(), known.max()) if len(known) else (0.1, 1.0)
    factor = max((high / low) ** _MARGIN, np.sqrt(max(_AXIS_FACTOR_MIN * low / high, 1.0)))
    return float(low / factor), float(high * factor)


def share_ticks(low: float, high: float) -> list[float]:
    """Return round fractions from ``low`` to ``high`` for ticks, at least three if possible."""
    ticks: list[float] = []
    for mantissas in _MANTISSAS:
        decades = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
        places = (float(f"{m}e{decade}") for decade in decades for m in mantissas)
        ticks = [place for place in places if low <= place <= high]
        if len(ticks) >= _TICKS_MIN:
            break
    return ticks


def positive(values: FloatArray) -> FloatArray:
    """Return values with NaN in place of those that a logarithmic axis cannot show."""
    return np.where(np.isfinite(values) & (values > 0), values, np.nan)


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


def legend(ui: Ui, colors: Mapping[str, Color]) -> None:
    side, (_, spacing) = 0.6 * imgui.GetTextLineHeight(), imgui.GetStyle().ItemSpacing
    for number, (name, color) in enumerate(colors.items()):
        if number:
            ui.same_line_if_fits(name)
        left, top = imgui.GetCursorScreenPos()
        top += (imgui.GetTextLineHeight() - side) / 2
        corners, ink = ((left, top), (left + side, top + side)), imgui.GetColorU32(color)
        imgui.GetWindowDrawList().AddRectFilled(*corners, ink)
        imgui.Dummy((side, side))
        ui.same_line(spacing)
        ui.line(name, "ink")
