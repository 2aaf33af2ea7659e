"""The colour maps of every picture: for functions with a zero in the middle, for the others, and some well-known ones.

The first two keep the surface readable under a light: the value that most of a surface has is a light grey, and
lightness falls steadily away from it, so that the pictures also work in print and for colour-blind readers.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image

FloatArray = NDArray[np.float64]

# Colours in Oklab (lightness, green to red, blue to yellow), evenly spaced along the map.
_STOPS = {
    "abfm sequential": [
        (0.93, 0.000, 0.004),
        (0.84, 0.045, 0.085),
        (0.70, 0.130, 0.110),
        (0.55, 0.170, 0.090),
        (0.36, 0.122, 0.052),
    ],
    "abfm diverging": [
        (0.36, -0.010, -0.150),
        (0.62, -0.035, -0.125),
        (0.93, 0.000, 0.002),
        (0.66, 0.150, 0.080),
        (0.38, 0.130, 0.058),
    ],
    "viridis": [
        (0.285, 0.102, -0.091),
        (0.419, 0.016, -0.108),
        (0.535, -0.062, -0.053),
        (0.654, -0.120, 0.023),
        (0.779, -0.135, 0.126),
        (0.918, -0.039, 0.182),
    ],
    "magma": [
        (0.048, -0.003, -0.033),
        (0.309, 0.067, -0.133),
        (0.466, 0.149, -0.077),
        (0.621, 0.181, 0.039),
        (0.789, 0.088, 0.097),
        (0.979, -0.025, 0.075),
    ],
    "coolwarm": [
        (0.475, 0.004, -0.181),
        (0.762, -0.010, -0.119),
        (0.898, 0.000, 0.000),
        (0.767, 0.093, 0.075),
        (0.487, 0.180, 0.074),
    ],
    "gray": [
        (0.252, 0.000, 0.000),
        (0.450, 0.000, 0.000),
        (0.627, 0.000, 0.000),
        (0.792, 0.000, 0.000),
        (0.949, 0.000, 0.000),
    ],
}
NAMES = tuple(_STOPS)
CHECKER_COLORS = ((0.85, 0.86, 0.88), (0.10, 0.22, 0.50))
"""Of the fields of a checkerboard, in linear light."""
_TO_LMS = np.array(
    [[1, 0.3963377774, 0.2158037573], [1, -0.1055613458, -0.0638541728], [1, -0.0894841775, -1.2914855480]]
)
_TO_RGB = np.array(
    [
        [4.0767416621, -3.3077115913, 0.2309699292],
        [-1.2684380046, 2.6097574011, -0.3413193965],
        [-0.0041960863, -0.7034186147, 1.7076147010],
    ]
)


@dataclass(frozen=True)
class ColorRange:
    """A colour map's name and the values at its two ends."""

    colormap: str
    low: float
    high: float


def color_range(*functions: FloatArray) -> ColorRange:
    """One range for several functions: symmetric about 0 when they take both signs, else from least to greatest.

    A least value just above 0 counts as 0, so that a colour bar begins there.
    """
    low = min(float(function.min()) for function in functions)
    high = max(float(function.max()) for function in functions)
    largest = max(-low, high)
    if min(-low, high) > 0.05 * largest:
        return ColorRange("abfm diverging", -largest, largest)
    if high - low <= 1e-12 * max(largest, 1e-300):
        return ColorRange("abfm sequential", low - 0.5, high + 0.5)
    return ColorRange("abfm sequential", 0.0 if -1e-9 * largest < low < 0.02 * largest else low, high)


def place_colors(vertices: FloatArray, positions: FloatArray) -> FloatArray:
    """Places (V, 3) as colours in linear light: x, y, z in the vertices' bounding box as red, green, blue."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    share: FloatArray = np.clip((positions - low) / np.maximum(high - low, 1e-300), 0, 1)
    colors: FloatArray = share**2.2
    return colors


@lru_cache(maxsize=32)
def table(colormap: str, size: int = 256) -> FloatArray:
    """The colours of a map from its low to its high end, (size, 3) sRGB in 0 to 1."""
    linear = linear_table(colormap, size)
    encoded: FloatArray = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return encoded


def linear_table(colormap: str, size: int) -> FloatArray:
    """As `table`, in linear light, as polyscope takes colours."""
    oklab = _monotone_cubic(np.array(_STOPS[colormap]), size)
    linear: FloatArray = np.clip((oklab @ _TO_LMS.T) ** 3 @ _TO_RGB.T, 0, 1)
    return linear


def _monotone_cubic(stops: FloatArray, size: int) -> FloatArray:
    """Evenly spaced stops (n, 3) joined to (size, 3) without overshooting, as SciPy's `PchipInterpolator` does.

    Written out because loading SciPy's would take longer than all of polyscope.
    """
    rise = np.diff(stops, axis=0)
    before, after = rise[:-1], rise[1:]
    same_way = before * after > 0
    slopes = np.zeros_like(stops)
    slopes[1:-1] = 2 * before * after * same_way / np.where(same_way, before + after, 1)
    for end, first, second in ((0, rise[0], rise[1]), (-1, rise[-1], rise[-2])):
        slopes[end] = np.clip((3 * first - second) / 2, np.minimum(0, 3 * first), np.maximum(0, 3 * first))
    position = np.linspace(0, len(rise), size)
    left = np.minimum(position.astype(int), len(rise) - 1)
    t = (position - left)[:, None]
    bend = (1 - t) * slopes[left] - t * slopes[left + 1] + (2 * t - 1) * rise[left]
    joined: FloatArray = stops[left] + t * rise[left] + t * (1 - t) * bend
    return joined


def loaded_name(colormap: str) -> str:
    """What polyscope calls a map of ours: it has maps of some of these names itself, and warns of a second one.

    A warning stops the window until the user answers it.
    """
    return colormap if colormap.startswith("abfm") else f"abfm {colormap}"


@contextmanager
def image_files() -> Iterator[dict[str, str]]:
    """Paths of image files of all maps, by name, for polyscope; they last as long as the context.

    Their values are linear light, because polyscope applies the display's gamma after shading.
    """
    with tempfile.TemporaryDirectory() as folder:
        paths = {name: f"{folder}/{number}.png" for number, name in enumerate(_STOPS)}
        for name, path in paths.items():
            Image.fromarray(np.round(255 * linear_table(name, 1024)[None]).astype(np.uint8)).save(path)
        yield paths
