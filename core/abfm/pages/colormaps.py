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
# percentiles of values at the ends of the colours, which exclude extreme noise
_SHOWN_PERCENTILES = 0.2, 99.8
CHECKER_COLORS = ((0.85, 0.86, 0.88), (0.10, 0.22, 0.50))  # two colours in linear light
DARK_CHECKER_COLORS = ((0.40, 0.41, 0.43), (0.06, 0.13, 0.34))


@dataclass(frozen=True)
class ColorRange:
    colormap: str
    low: float
    high: float


def for_background(colormap: str, is_dark: bool) -> str:
    return _DARK_NAMES.get(colormap, colormap) if is_dark else colormap


def color_range(*functions: FloatArray) -> ColorRange:
    """Return a colour map, and one range of values for all functions.

    The range has all finite values. It is symmetric about 0 if values have both signs, and starts
    at 0 if the minimum is slightly above 0.
    """
    known = [function[np.isfinite(function)] for function in functions]
    low = min((float(values.min()) for values in known if values.size), default=0.0)
    high = max((float(values.max()) for values in known if values.size), default=0.0)
    largest = max(-low, high)
    if min(-low, high) > 0.05 * largest:
        return ColorRange("abfm diverging", -largest, largest)
    if high - low <= 1e-12 * max(largest, 1e-300):
        # 0.5 is rounded away next to large numbers, but a colour bar needs a length
        margin = max(0.5, 1e-12 * largest)
        return ColorRange("abfm sequential", low - margin, high + margin)
    is_almost_0 = -1e-9 * largest < low < 0.02 * largest
    return ColorRange("abfm sequential", 0.0 if is_almost_0 else low, high)


def without_extremes(values: FloatArray) -> FloatArray:
    """Return the finite values, clipped to the percentiles 0.2 and 99.8, for `color_range`."""
    known = values[np.isfinite(values)]
    return np.clip(known, *np.percentile(known, _SHOWN_PERCENTILES)) if known.size else known


def typical_range(*functions: FloatArray) -> ColorRange:
    """Return the `color_range` of functions without their extreme values."""
    return color_range(*map(without_extremes, functions))


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


def gradient(colormap: str) -> list[str]:
    """Return the colours of a colour map, from low to high, as CSS colours for a gradient."""
    colors = np.round(255 * table(colormap, _STOPS)).astype(int)
    return [f"rgb({red} {green} {blue})" for red, green, blue in colors.tolist()]


def colors_of(values: NDArray[Any], colors: ColorRange, unknown: BoolArray) -> FloatArray:
    """Return the colours (N, 3), in linear light, of values (N,); unknown values are grey."""
    table = linear_table(colors.colormap, _TABLE_ENTRIES)
    share = (values - colors.low) / (colors.high - colors.low)
    entries = np.clip(np.nan_to_num(share) * (_TABLE_ENTRIES - 1) + 0.5, 0, _TABLE_ENTRIES - 1)
    found = table[entries.astype(np.int64)]
    found[unknown] = NO_VALUES
    return found


def polyscope_name(colormap: str) -> str:
    """Return the name of a colour map in polyscope, which does not accept its built-in names."""
    return colormap if colormap.startswith("abfm") else f"abfm {colormap}"


def colormap_images() -> dict[str, NDArray[np.uint8]]:
    """Return all colour maps by name as images (1, 1024, 3) in linear light, without gamma."""
    tables = {name: linear_table(name, 1024)[None] for name in _TABLES}
    return {name: np.round(255 * table).astype(np.uint8) for name, table in tables.items()}
