"""Colours of the window in light and dark: text, panels, surfaces' ground, and the lines of plots."""

from dataclasses import dataclass

from abfm_viewer.document.document import Theme

Color = tuple[float, float, float, float]


def _hex(code: str) -> Color:
    red, green, blue = bytes.fromhex(code[1:])
    return red / 255, green / 255, blue / 255, 1.0


@dataclass(frozen=True)
class Palette:
    """sRGB colours with alpha, each 0 to 1."""

    ground: Color  # behind the surfaces
    panel: Color
    field: Color  # of sliders, boxes and buttons
    hovered: Color
    pressed: Color
    border: Color
    ink: Color
    muted: Color
    accent: Color  # the one button, marks of sliders
    accent_hovered: Color
    accent_ink: Color
    source: Color
    target: Color
    failure: Color  # of what went wrong or was not reached; nothing else has its hue
    good: Color
    marker: Color


LIGHT = Palette(
    ground=_hex("#ffffff"),
    panel=_hex("#f4f5f7"),
    field=_hex("#e3e6eb"),
    hovered=_hex("#d3d9e3"),
    pressed=_hex("#bcc8dc"),
    border=_hex("#d0d4db"),
    ink=_hex("#1d222b"),
    muted=_hex("#5d6675"),
    accent=_hex("#2455c3"),
    accent_hovered=_hex("#1c46a5"),
    accent_ink=_hex("#ffffff"),
    source=_hex("#2455c3"),
    target=_hex("#c62828"),
    failure=_hex("#9320a8"),
    good=_hex("#1b7a43"),
    marker=_hex("#0b8f6a"),
)
DARK = Palette(
    ground=_hex("#1b1e24"),
    panel=_hex("#262a32"),
    field=_hex("#373d48"),
    hovered=_hex("#454d5b"),
    pressed=_hex("#566175"),
    border=_hex("#3c424d"),
    ink=_hex("#e8eaee"),
    muted=_hex("#a3abb9"),
    accent=_hex("#4c7df0"),
    accent_hovered=_hex("#6a94f7"),
    accent_ink=_hex("#ffffff"),
    source=_hex("#86a9ff"),
    target=_hex("#ff8a80"),
    failure=_hex("#dd8cf0"),
    good=_hex("#69d39a"),
    marker=_hex("#38d9a9"),
)


def palette(theme: Theme) -> Palette:
    """The colours of a theme."""
    return LIGHT if theme == "light" else DARK
