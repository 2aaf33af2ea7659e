"""Plots of sheets and reports, and the font of figures, with matplotlib."""

import io
import math
from collections.abc import Mapping, Sequence
from itertools import cycle

import numpy as np
from matplotlib import font_manager
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.ticker import NullFormatter
from PIL import Image, ImageFont

from abfm.io.sheets import Plot
from abfm.types import FloatArray
from abfm_viewer.appearance.axes import factor_ticks

CURVE_COLORS = ("#111111", "#2455c3", "#c62828", "#1b7a43", "#b26a00", "#6b3fa0")
_FAINT_COLOR = "#8a909c"  # of all faint curves, which have different styles
_STYLES = ("--", ":", "-.", (0, (8, 3)), (0, (5, 2, 1, 2, 1, 2)))
_DPI = 100
_TEXT_SHARE = 0.027  # height of text in a plot of a report, relative to the width
_BINS = 60
_AXIS_RATIO = 1.5  # end of the axis of a histogram, relative to its largest vertical line
_AXIS_LENGTH_MIN = 0.25
_LINE_STYLES = ("--", ":")
_BAR_COLOR = "#7d93c9"
_CHOSEN_COLOR = CURVE_COLORS[2]


def plot_font(pixels: float) -> ImageFont.FreeTypeFont:
    """Return the font of plots, which has Greek letters; its size is in pixels."""
    return ImageFont.truetype(font_manager.findfont("DejaVu Sans"), pixels)


def plot_picture(plot: Plot, size: tuple[int, int], text: float) -> Image.Image:
    """Return a picture of a plot on white.

    ``size`` (width, height) and the height ``text`` of the letters are in pixels.
    """
    (figure, axes), points = _new_axes(size), _points_of(text)
    colors, styles = cycle(CURVE_COLORS), cycle(_STYLES)
    for curve in plot.curves:
        color, style = (_FAINT_COLOR, next(styles)) if curve.faint else (next(colors), "-")
        axes.plot(
            curve.x, curve.y, label=curve.name, color=color, linestyle=style, linewidth=points / 7
        )
    if plot.log_y:
        axes.set_yscale("log")
        low, high = np.log10(axes.get_ylim())
        if math.ceil(low) <= high:  # powers of 10 are enough; labels between them would overlap
            axes.yaxis.set_minor_formatter(NullFormatter())
    if plot.top is not None and axes.get_ylim()[1] > plot.top:
        axes.set_ylim(-0.05 * plot.top, plot.top)
    _name_axes(axes, plot.x_title, plot.y_title, points)
    axes.margins(x=0)
    if len(plot.curves) > 1:
        small = {"fontsize": 0.9 * points, "frameon": False}
        legend = axes.legend(**small)
        figure.draw_without_rendering()
        if _covers_curves(legend, axes):
            columns_max = max(int(0.9 * size[0] / legend.get_window_extent().width), 1)
            columns = math.ceil(len(plot.curves) / math.ceil(len(plot.curves) / columns_max))
            legend.remove()
            figure.legend(loc="outside upper center", ncols=columns, **small)
    figure.draw_without_rendering()
    title = axes.yaxis.label.get_window_extent()
    space = 2 * min((title.y0 + title.y1) / 2, size[1] - (title.y0 + title.y1) / 2)
    # smaller in a low plot, where the title would be clipped
    axes.yaxis.label.set_fontsize(points * min(1, space / max(title.height, 1)))
    return _rendered(figure)


def histogram_picture(
    values: FloatArray,
    areas: FloatArray,
    vertical_lines: Mapping[str, Sequence[float]],
    title: str,
    size: tuple[int, int],
) -> Image.Image:
    """Return a histogram of values (F,) of faces, in percent of their areas (F,).

    ``vertical_lines`` are positions of lines by name. The axis ends at 1.5 times the outermost
    line; values beyond it are in the outermost bins. ``size`` is in pixels.
    """
    places = np.concatenate([*vertical_lines.values()])
    end = max(_AXIS_RATIO * places.max(), _AXIS_LENGTH_MIN)
    ends = (-end if places.min() < 0 else 0.0, end)
    figure, axes = _new_axes(size)
    weights = 100 * areas / areas.sum()
    heights, edges = np.histogram(np.clip(values, *ends), _BINS, ends, weights=weights)
    axes.stairs(heights, edges, fill=True, color=_BAR_COLOR)
    for (name, lines), style in zip(vertical_lines.items(), _LINE_STYLES, strict=False):
        for number, place in enumerate(lines):
            label = None if number else name
            axes.axvline(place, color=CURVE_COLORS[0], linestyle=style, linewidth=1.5, label=label)
    axes.set_xlim(*ends)
    return _finished(figure, axes, title, "% of the area", size)


def path_picture(
    area_change: FloatArray, residuals: FloatArray, chosen: int, size: tuple[int, int]
) -> Image.Image:
    """Return a plot of the residuals (S,) of the steps of a match, by their area change.

    ``chosen`` is the index of the selected step. ``size`` is in pixels.
    """
    figure, axes = _new_axes(size)
    axes.plot(area_change, 100 * residuals, "o-", color=_BAR_COLOR, markersize=6, linewidth=1.5)
    one, other = area_change[chosen], 100 * residuals[chosen]
    axes.plot([one], [other], "o", color=_CHOSEN_COLOR, markersize=9, label="chosen")
    axes.set_ylim(0, 112 * residuals.max())
    axes.set_xticks(*factor_ticks(*axes.get_xlim()))
    return _finished(figure, axes, "areas change by a factor of", "residual, %", size)


def _finished(
    figure: Figure, axes: Axes, x_title: str, y_title: str, size: tuple[int, int]
) -> Image.Image:
    points = _points_of(_TEXT_SHARE * size[0])
    _name_axes(axes, x_title, y_title, points)
    axes.legend(fontsize=0.9 * points, frameon=False)
    return _rendered(figure)


def _new_axes(size: tuple[int, int]) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(size[0] / _DPI, size[1] / _DPI), dpi=_DPI, layout="constrained")
    return figure, figure.add_subplot()


def _points_of(text: float) -> float:
    """Return the font size in points for a height of text in pixels."""
    return text * 72 / _DPI


def _name_axes(axes: Axes, x_title: str, y_title: str, points: float) -> None:
    """Set the titles of axes, in a font size in points, and draw a grid below the curves."""
    axes.set_xlabel(x_title, fontsize=points)
    axes.set_ylabel(y_title, fontsize=points)
    axes.tick_params(which="both", labelsize=0.9 * points)
    axes.grid(color="#e3e6eb", linewidth=1)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _rendered(figure: Figure) -> Image.Image:
    stream = io.BytesIO()
    figure.savefig(stream, format="png")
    return Image.open(stream).convert("RGB")


def _covers_curves(legend: Legend, axes: Axes) -> bool:
    box = legend.get_window_extent()
    for line in axes.get_lines():
        corners = line.get_transform().transform(line.get_xydata())
        along = np.linspace(0, len(corners) - 1, 50 * len(corners))
        x, y = (np.interp(along, np.arange(len(corners)), values) for values in corners.T)
        if ((box.x0 < x) & (x < box.x1) & (box.y0 < y) & (y < box.y1)).any():
            return True
    return False
