"""Colour maps for lit surfaces, suitable for printing and colour-blind readers.

A neutral value is light grey, or dark grey on dark backgrounds. The lightness changes monotonically
with the distance from the neutral value.
"""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from abfm.types import BoolArray, FloatArray

NAMES = ("abfm sequential", "abfm diverging", "viridis", "magma", "coolwarm", "gray")
_DARK_NAMES = {name: f"{name} dark" for name in NAMES[:2]}
# Uniformly spaced colours (101, 3) in linear light. They interpolate a few stops in Oklab, and are
# stored because importing SciPy for the interpolation would be slow.
_STOPS = 16  # colours of a CSS gradient
_TABLE_ENTRIES = 1024  # fine enough that steps are invisible
_ROWS = np.loadtxt(Path(__file__).with_name("colormaps.csv"), delimiter=",")
_TABLES = dict(zip((*NAMES, *_DARK_NAMES.values()), np.split(_ROWS, 8, axis=1), strict=True))
NO_VALUES = 0.3  # grey of unknown values, in linear light
_CLIPPED_MIN = 0.02  # values so far beyond an end, relative to the range, count as clipped
CHECKER_COLORS = ((0.85, 0.86, 0.88), (0.10, 0.22, 0.50))  # two colours in linear light
DARK_CHECKER_COLORS = ((0.40, 0.41, 0.43), (0.06, 0.13, 0.34))


@dataclass(frozen=True)
class ColorRange:
    """A colour map, the values at its ends, and the smallest and largest shown value, if known."""

    colormap: str
    low: float
    high: float
    minimum: float | None = None
    maximum: float | None = None

    @property
    def full(self) -> tuple[float, float]:
        """The range of all shown values, which contains this range."""
        minimum = self.low if self.minimum is None else self.minimum
        maximum = self.high if self.maximum is None else self.maximum
        return min(self.low, minimum), max(self.high, maximum)

    @property
    def clipped(self) -> tuple[bool, bool]:
        """Whether values lie beyond the low end, and beyond the high end."""
        (low, high), slack = self.full, _CLIPPED_MIN * (self.high - self.low)
        return low < self.low - slack, high > self.high + slack


def for_background(colormap: str, is_dark: bool) -> str:
    return _DARK_NAMES.get(colormap, colormap) if is_dark else colormap


def place_colors(vertices: FloatArray, positions: FloatArray) -> FloatArray:
    """Return colours (V, 3) in linear light, with x, y, z of positions (V, 3) as red, green, blue.

    The colours are those of positions in the bounding box of ``vertices``.
    """
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    return np.asarray(np.clip((positions - low) / np.maximum(high - low, 1e-300), 0, 1) ** 2.2)


@lru_cache(maxsize=32)
def table(colormap: str, size: int = 256) -> FloatArray:
    """Return colours (size, 3) of a colour map, from low to high, as sRGB from 0 to 1."""
    linear = linear_table(colormap, size)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def linear_table(colormap: str, size: int) -> FloatArray:
    """Return the colours of `table` in linear light, as polyscope expects them."""
    rows = _TABLES[colormap]
    place = np.linspace(0, len(rows) - 1, size)
    return np.stack([np.interp(place, np.arange(len(rows)), channel) for channel in rows.T], axis=1)


def gradient(colors: ColorRange) -> str:
    """Return the CSS gradient of a colour bar, with arrows of length ``--arrow`` if clipped."""
    rgb = np.round(255 * table(colors.colormap, _STOPS)).astype(int)
    stops = [f"rgb({red} {green} {blue})" for red, green, blue in rgb.tolist()]
    below, above = colors.clipped
    stops[0] += " var(--arrow)" if below else ""
    stops[-1] += " calc(100% - var(--arrow))" if above else ""
    return f"linear-gradient(to right, {', '.join(stops)})"


def colors_of(values: NDArray[Any], colors: ColorRange, unknown: BoolArray | None) -> FloatArray:
    """Return the colours (N, 3), in linear light, of values (N,); unknown values are grey."""
    table = linear_table(colors.colormap, _TABLE_ENTRIES)
    share = (values - colors.low) / (colors.high - colors.low)
    entries = np.clip(np.nan_to_num(share) * (_TABLE_ENTRIES - 1) + 0.5, 0, _TABLE_ENTRIES - 1)
    found = table[entries.astype(np.int64)]
    if unknown is not None:
        found[unknown] = NO_VALUES
    return found


def polyscope_name(colormap: str) -> str:
    """Return the name of a colour map in polyscope, which does not accept its built-in names."""
    return colormap if colormap.startswith("abfm") else f"abfm {colormap}"


def colormap_images() -> dict[str, NDArray[np.uint8]]:
    """Return all colour maps by name as images (1, 1024, 3) in linear light, without gamma."""
    tables = {name: linear_table(name, 1024)[None] for name in _TABLES}
    return {name: np.round(255 * table).astype(np.uint8) for name, table in tables.items()}
