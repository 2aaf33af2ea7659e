"""The ranges of a sheet's colour bars, and what must be said of values that they do not reach."""

from collections import defaultdict

import numpy as np

from abfm.io.sheets import Coordinates, Panel, Sheet, Streaks, Values
from abfm.types import FloatArray
from abfm_viewer.appearance.colormaps import ColorRange, color_range

CLAMPED = 0.1
"""How far values may lie beyond the colours, as a share of their range, before a sheet says so.

Advection overshoots by a few per cent even where it is right, and so much more nobody sees in a
colour.
"""


def panels(sheet: Sheet) -> list[Panel]:
    """All panels of a sheet, row by row."""
    return [cell for row in sheet.rows for cell in row if isinstance(cell, Panel)]


def color_ranges(sheet: Sheet) -> dict[str, ColorRange]:
    """The range of each colour bar, by its title, in the order in which they are first used.

    It is that of the sources and targets, where there are some: what overshoots them has the colour
    of the bar's end, and `captions` says how far it goes.
    """
    every: dict[str, list[FloatArray]] = defaultdict(list)
    ends: dict[str, list[FloatArray]] = defaultdict(list)
    for panel in panels(sheet):
        bar, values = function(panel)
        if values is not None:
            every[bar].append(values)
            if panel.frame in ("source", "target"):
                ends[bar].append(values)
    return {bar: color_range(*(ends[bar] or functions)) for bar, functions in every.items()}


def captions(sheet: Sheet) -> list[str]:
    """The sheet's notes, and a line for each panel of which colours hide more than `CLAMPED`: how
    far it really goes.

    Colours of places are clamped to the mesh's bounding box.
    """
    ranges = color_ranges(sheet)
    said = list(sheet.notes)
    for panel in panels(sheet):
        bar, values = function(panel)
        if values is not None:
            colors = ranges[bar]
            low, high = float(values.min()), float(values.max())
            if max(colors.low - low, high - colors.high) > CLAMPED * (colors.high - colors.low):
                said.append(
                    f"Beyond the colours: {_named(panel, bar)} goes from {low:,.4g} to "
                    f"{high:,.4g}, the colours from {colors.low:,.4g} to {colors.high:,.4g}."
                )
        elif isinstance(panel.paint, Coordinates):
            beyond = _outside(panel.mesh.vertices, panel.paint.positions)
            if beyond > CLAMPED:
                said.append(
                    f"Beyond the colours: the places of '{panel.label}' lie up to {beyond:,.3g} "
                    "times the bounding box's extent outside it."
                )
    return said


def function(panel: Panel) -> tuple[str, FloatArray | None]:
    """Return the colour bar's title and the values of a panel; None where it has none."""
    paint = panel.paint
    return (paint.bar, paint.values) if isinstance(paint, Values | Streaks) else ("", None)


def _named(panel: Panel, bar: str) -> str:
    is_known = bar in ("function", panel.label)
    return f"'{panel.label}'" if is_known else f"'{panel.label}' ({bar})"


def _outside(vertices: FloatArray, positions: FloatArray) -> float:
    """Return how far places (V, 3) lie outside the vertices' bounding box, as a multiple of its
    extent in that direction.

    A direction in which the box is flat, to a hundredth of its largest extent, counts as that wide.
    """
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    extent = np.maximum(high - low, 0.01 * (high - low).max())
    return float((np.maximum(low - positions, positions - high) / extent).max())
