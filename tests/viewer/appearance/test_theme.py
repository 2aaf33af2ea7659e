"""The colours of the window: what can be read, and what means one thing only."""

from __future__ import annotations

import colorsys

import pytest

from abfm_viewer.appearance.theme import Color, palette
from abfm_viewer.document.document import THEMES

_READABLE = 4.5  # WCAG 2.1, level AA


def luminance(color: Color) -> float:
    """Relative luminance as WCAG 2.1 defines it."""
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in color[:3]]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one: Color, other: Color) -> float:
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def hue(color: Color) -> float:
    return 360 * colorsys.rgb_to_hsv(*color[:3])[0]


@pytest.mark.parametrize("theme", THEMES)
@pytest.mark.parametrize("name", ["failure", "good", "ink", "muted"])
def test_what_a_verdict_is_written_in_can_be_read(theme, name):
    colors = palette(theme)
    for behind in (colors.panel, colors.ground):
        assert contrast(getattr(colors, name), behind) >= _READABLE


@pytest.mark.parametrize("theme", THEMES)
def test_failure_has_a_hue_of_its_own(theme):
    colors = palette(theme)
    for name in ("source", "target", "accent", "accent_hovered", "good", "marker"):
        apart = abs(hue(colors.failure) - hue(getattr(colors, name))) % 360
        assert min(apart, 360 - apart) > 45, name
