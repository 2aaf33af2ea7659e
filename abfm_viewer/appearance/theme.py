"""Colours of the window, light and dark: text, panels, the surfaces' ground, lines of plots."""

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
    smoothness: Color  # the terms of the energy in its plot; the total is muted
    closeness: Color


LIGHT = Palette(
    ground=_hex("#ffffff"),
    panel=_hex("#f4f5f7"),
    field=_hex("#e6e9ee"),
    hovered=_hex("#dce2ea"),
    pressed=_hex("#cdd8e8"),
    border=_hex("#d0d4db"),
    ink=_hex("#1d222b"),
    muted=_hex("#4d5563"),
    accent=_hex("#2455c3"),
    accent_hovered=_hex("#1c46a5"),
    accent_ink=_hex("#ffffff"),
    source=_hex("#2455c3"),
    target=_hex("#b31f1f"),
    failure=_hex("#8a1c9e"),
    good=_hex("#12633a"),
    marker=_hex("#0b8f6a"),
    smoothness=_hex("#0097ad"),
    closeness=_hex("#9a6700"),
)
DARK = Palette(
    ground=_hex("#1b1e24"),
    panel=_hex("#262a32"),
    field=_hex("#333945"),
    hovered=_hex("#3a414e"),
    pressed=_hex("#434d5d"),
    border=_hex("#3c424d"),
    ink=_hex("#e8eaee"),
    muted=_hex("#bfc6d1"),
    accent=_hex("#7ea6ff"),
    accent_hovered=_hex("#9bbaff"),
    accent_ink=_hex("#10141c"),
    source=_hex("#a3beff"),
    target=_hex("#ffaba3"),
    failure=_hex("#e8a6f7"),
    good=_hex("#69d39a"),
    marker=_hex("#38d9a9"),
    smoothness=_hex("#1c93a6"),
    closeness=_hex("#e0a526"),
)


def linear(color: Color) -> tuple[float, float, float]:
    """Return a colour in linear light, as polyscope wants it."""
    red, green, blue = (channel**2.2 for channel in color[:3])
    return red, green, blue


def palette(theme: Theme) -> Palette:
    """Return the colours of a theme."""
    return LIGHT if theme == "light" else DARK
