"""Plots of a sheet, and the font of figures, by matplotlib."""

import io
import math
from itertools import cycle

import numpy as np
from matplotlib import font_manager
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from PIL import Image, ImageFont

from abfm.io.sheets import Plot

CURVE_COLORS = ("#111111", "#2455c3", "#c62828", "#1b7a43", "#b26a00", "#6b3fa0")
_FAINT_COLOR = "#8a909c"  # the colour of all faint curves, which differ in style
_STYLES = ("--", ":", "-.", (0, (8, 3)), (0, (5, 2, 1, 2, 1, 2)))
_DPI = 100


def plot_font(pixels: float) -> ImageFont.FreeTypeFont:
    """The font of plots in another size: it has the paper's Greek letters."""
    return ImageFont.truetype(font_manager.findfont("DejaVu Sans"), pixels)


def plot_picture(plot: Plot, size: tuple[int, int], text: float) -> Image.Image:
    """Draw a plot in a size (width, height) and with a height of text in pixels, on white."""
    (figure, axes), points = new_axes(size), points_of(text)
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
    name_axes(axes, plot.x_title, plot.y_title, points)
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
    return drawn(figure)


def new_axes(size: tuple[int, int]) -> tuple[Figure, Axes]:
    """Begin a plot of a size (width, height) in pixels."""
    figure = Figure(figsize=(size[0] / _DPI, size[1] / _DPI), dpi=_DPI, layout="constrained")
    return figure, figure.add_subplot()


def points_of(text: float) -> float:
    """Return the size of a font, in points, that has a height of text in pixels."""
    return text * 72 / _DPI


def name_axes(axes: Axes, x_title: str, y_title: str, points: float) -> None:
    """Write the titles of axes, and draw a grid below the curves."""
    axes.set_xlabel(x_title, fontsize=points)
    axes.set_ylabel(y_title, fontsize=points)
    axes.tick_params(which="both", labelsize=0.9 * points)
    axes.grid(color="#e3e6eb", linewidth=1)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def drawn(figure: Figure) -> Image.Image:
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
