"""Light and dark colour palettes of the window."""

from dataclasses import dataclass

from abfm_viewer.document.document import Theme

Color = tuple[float, float, float, float]


@dataclass(frozen=True)
class Palette:
    """sRGB colours with alpha; each channel is from 0 to 1."""

    ground: Color  # behind the surfaces
    panel: Color
    field: Color  # sliders, boxes and buttons
    hovered: Color
    pressed: Color
    border: Color
    ink: Color
    muted: Color
    accent: Color  # primary button, grabs of sliders
    accent_hovered: Color
    accent_ink: Color
    source: Color
    target: Color
    failure: Color  # errors and matches that were not reached; no other colour has this hue
    warning: Color  # a good result with a warning, or a nearly good result
    good: Color
    marker: Color
    lines: Color  # in plots: residual along flow lines
    flow: Color  # in plots: residual by the discrete flow


_CODES = {
    "ground": ("ffffff", "1b1e24"),
    "panel": ("f4f5f7", "262a32"),
    "field": ("e6e9ee", "333945"),
    "hovered": ("dce2ea", "3a414e"),
    "pressed": ("cdd8e8", "434d5d"),
    "border": ("d0d4db", "3c424d"),
    "ink": ("1d222b", "e8eaee"),
    "muted": ("4d5563", "bfc6d1"),
    "accent": ("2455c3", "7ea6ff"),
    "accent_hovered": ("1c46a5", "9bbaff"),
    "accent_ink": ("ffffff", "10141c"),
    "source": ("2455c3", "a3beff"),
    "target": ("b31f1f", "ffaba3"),
    "failure": ("8a1c9e", "e8a6f7"),
    "warning": ("854d00", "f2b13c"),
    "good": ("12633a", "69d39a"),
    "marker": ("0b8f6a", "38d9a9"),
    "lines": ("0097ad", "1c93a6"),
    "flow": ("9a6700", "e0a526"),
}


def _palette(column: int) -> Palette:
    return Palette(**{name: _color(codes[column]) for name, codes in _CODES.items()})


def _color(code: str) -> Color:
    red, green, blue = bytes.fromhex(code)
    return red / 255, green / 255, blue / 255, 1.0


LIGHT_PALETTE = _palette(0)
DARK_PALETTE = _palette(1)
# colours of landmarks: dark enough for white numbers, and easily distinguished
_LANDMARK_CODES = (
    "1f5fd0",
    "c4314b",
    "1c7c3c",
    "8a3ffc",
    "b35a00",
    "007d86",
    "b5179e",
    "5f6b00",
    "3f4a5a",
    "7a3b1d",
)
LANDMARKS = tuple(map(_color, _LANDMARK_CODES))
"""Colours of the landmarks by number; they repeat if there are more landmarks."""
ON_LANDMARKS: Color = (1.0, 1.0, 1.0, 1.0)


def linear(color: Color) -> tuple[float, float, float]:
    """Return an sRGB colour in linear light, without alpha."""
    red, green, blue = (channel**2.2 for channel in color[:3])
    return red, green, blue


def palette(theme: Theme) -> Palette:
    return LIGHT_PALETTE if theme == "light" else DARK_PALETTE
