"""Plots of a report: how often a map changes areas or shapes so much, and what closeness costs."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from abfm.types import FloatArray
from abfm_viewer.pictures.plots import CURVE_COLORS, drawn, name_axes, new_axes, points_of

_TEXT = 0.027  # of the width
_BINS = 60
_AXIS_RATIO = 1.5
_AXIS_LENGTH_MIN = 0.25
_MARKS = ("--", ":")
_BAR_COLOR = "#7d93c9"
_MARK_COLOR = CURVE_COLORS[0]
_CHOSEN_COLOR = CURVE_COLORS[2]


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
    figure, axes = new_axes(size)
    weights = 100 * areas / areas.sum()
    heights, edges = np.histogram(np.clip(values, *ends), _BINS, ends, weights=weights)
    axes.stairs(heights, edges, fill=True, color=_BAR_COLOR)
    for (name, lines), style in zip(marks.items(), _MARKS, strict=False):
        for number, place in enumerate(lines):
            label = None if number else name
            axes.axvline(place, color=_MARK_COLOR, linestyle=style, linewidth=1.5, label=label)
    axes.set_xlim(*ends)
    return _finished(figure, axes, title, "% of the area", size)


def path_picture(
    cost: FloatArray, left: FloatArray, chosen: int, size: tuple[int, int]
) -> Image.Image:
    """Draw what steps (S,) of a path leave in percent against how much they change areas."""
    figure, axes = new_axes(size)
    axes.plot(cost, 100 * left, "o-", color=_BAR_COLOR, markersize=6, linewidth=1.5)
    one, other = cost[chosen], 100 * left[chosen]
    axes.plot([one], [other], "o", color=_CHOSEN_COLOR, markersize=9, label="chosen")
    axes.set_ylim(0, 112 * left.max())
    title = "mean |log2 J| of the flow"
    return _finished(figure, axes, title, "residual, %", size)


def _finished(
    figure: Figure, axes: Axes, x_title: str, y_title: str, size: tuple[int, int]
) -> Image.Image:
    points = points_of(_TEXT * size[0])
    name_axes(axes, x_title, y_title, points)
    axes.legend(fontsize=0.9 * points, frameon=False)
    return drawn(figure)
