"""Plots of sheets and of reports, and the font of figures, by matplotlib."""

import io
import math
from collections.abc import Mapping, Sequence
from itertools import cycle

import numpy as np
from matplotlib import font_manager
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from PIL import Image, ImageFont

from abfm.io.sheets import Plot
from abfm.types import FloatArray

CURVE_COLORS = ("#111111", "#2455c3", "#c62828", "#1b7a43", "#b26a00", "#6b3fa0")
_FAINT_COLOR = "#8a909c"  # the colour of all faint curves, which differ in style
_STYLES = ("--", ":", "-.", (0, (8, 3)), (0, (5, 2, 1, 2, 1, 2)))
_DPI = 100
_TEXT_SHARE = 0.027  # of a report's plot, of its width
_BINS = 60
_AXIS_RATIO = 1.5
_AXIS_LENGTH_MIN = 0.25
_MARKS = ("--", ":")
_BAR_COLOR = "#7d93c9"
_CHOSEN_COLOR = CURVE_COLORS[2]


def plot_font(pixels: float) -> ImageFont.FreeTypeFont:
    """The font of plots in another size: it has the paper's Greek letters."""
    return ImageFont.truetype(font_manager.findfont("DejaVu Sans"), pixels)


def plot_picture(plot: Plot, size: tuple[int, int], text: float) -> Image.Image:
    """Draw a plot in a size (width, height) and with a height of text in pixels, on white."""
    (figure, axes), points = _new_axes(size), _points_of(text)
    colors, styles = cycle(CURVE_COLORS), cycle(_STYLES)
    for curve in plot.curves:
        color, style = (_FAINT_COLOR, next(styles)) if curve.faint else (next(colors), "-")
        axes.plot(
            curve.x, curve.y, label=curve.name, color=color, linestyle=style, linewidth=points / 7
        )
    if plot.log_y:
        axes.set_yscale("log")
    if plot.top is not None and axes.get_ylim()[1] > plot.top:
        axes.set_ylim(-0.05 * plot.top, plot.top)
    _name_axes(axes, plot.x_title, plot.y_title, points)
    axes.margins(x=0)
    if len(plot.curves) > 1:
        small = {"fontsize": 0.9 * points, "frameon": False}
        legend = axes.legend(**small)
        figure.draw_without_rendering()
        if _covers_curves(legend, axes):
            beside = max(int(0.9 * size[0] / legend.get_window_extent().width), 1)
            columns = math.ceil(len(plot.curves) / math.ceil(len(plot.curves) / beside))
            legend.remove()
            figure.legend(loc="outside upper center", ncols=columns, **small)
    figure.draw_without_rendering()
    title = axes.yaxis.label.get_window_extent()
    room = 2 * min((title.y0 + title.y1) / 2, size[1] - (title.y0 + title.y1) / 2)
    # in a low plot it would be cut off
    axes.yaxis.label.set_fontsize(points * min(1, room / max(title.height, 1)))
    return _drawn(figure)


def histogram_picture(
    values: FloatArray,
    areas: FloatArray,
    marks: Mapping[str, Sequence[float]],
    title: str,
    size: tuple[int, int],
) -> Image.Image:
    """Draw how much area has which value (F,), in percent, to half as far again as the marks, which
    are upright lines by name; what lies beyond is in the outermost bins.
    """
    places = np.concatenate([*marks.values()])
    end = max(_AXIS_RATIO * places.max(), _AXIS_LENGTH_MIN)
    ends = (-end if places.min() < 0 else 0.0, end)
    figure, axes = _new_axes(size)
    weights = 100 * areas / areas.sum()
    heights, edges = np.histogram(np.clip(values, *ends), _BINS, ends, weights=weights)
    axes.stairs(heights, edges, fill=True, color=_BAR_COLOR)
    for (name, lines), style in zip(marks.items(), _MARKS, strict=False):
        for number, place in enumerate(lines):
            label = None if number else name
            axes.axvline(place, color=CURVE_COLORS[0], linestyle=style, linewidth=1.5, label=label)
    axes.set_xlim(*ends)
    return _finished(figure, axes, title, "% of the area", size)


def path_picture(
    cost: FloatArray, left: FloatArray, chosen: int, size: tuple[int, int]
) -> Image.Image:
    """Draw what steps (S,) of a path leave in percent against how much they change areas."""
    figure, axes = _new_axes(size)
    axes.plot(cost, 100 * left, "o-", color=_BAR_COLOR, markersize=6, linewidth=1.5)
    one, other = cost[chosen], 100 * left[chosen]
    axes.plot([one], [other], "o", color=_CHOSEN_COLOR, markersize=9, label="chosen")
    axes.set_ylim(0, 112 * left.max())
    title = "mean |log2 J| of the flow"
    return _finished(figure, axes, title, "residual, %", size)


def _finished(
    figure: Figure, axes: Axes, x_title: str, y_title: str, size: tuple[int, int]
) -> Image.Image:
    points = _points_of(_TEXT_SHARE * size[0])
    _name_axes(axes, x_title, y_title, points)
    axes.legend(fontsize=0.9 * points, frameon=False)
    return _drawn(figure)


def _new_axes(size: tuple[int, int]) -> tuple[Figure, Axes]:
    """Begin a plot of a size (width, height) in pixels."""
    figure = Figure(figsize=(size[0] / _DPI, size[1] / _DPI), dpi=_DPI, layout="constrained")
    return figure, figure.add_subplot()


def _points_of(text: float) -> float:
    """Return the size of a font, in points, that has a height of text in pixels."""
    return text * 72 / _DPI


def _name_axes(axes: Axes, x_title: str, y_title: str, points: float) -> None:
    """Write the titles of axes, and draw a grid below the curves."""
    axes.set_xlabel(x_title, fontsize=points)
    axes.set_ylabel(y_title, fontsize=points)
    axes.tick_params(which="both", labelsize=0.9 * points)
    axes.grid(color="#e3e6eb", linewidth=1)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _drawn(figure: Figure) -> Image.Image:
    stream = io.BytesIO()
    figure.savefig(stream, format="png")
    return Image.open(stream).convert("RGB")


def _covers_curves(legend: Legend, axes: Axes) -> bool:
    """Return whether a curve runs through the legend where it is least in the way."""
    box = legend.get_window_extent()
    for line in axes.get_lines():
        corners = line.get_transform().transform(line.get_xydata())
        along = np.linspace(0, len(corners) - 1, 50 * len(corners))
        x, y = (np.interp(along, np.arange(len(corners)), values) for values in corners.T)
        if ((box.x0 < x) & (x < box.x1) & (box.y0 < y) & (y < box.y1)).any():
            return True
    return False
