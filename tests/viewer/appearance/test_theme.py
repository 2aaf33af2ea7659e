"""The colours of the window: what can be read, and what means one thing only."""

from __future__ import annotations

import colorsys
from itertools import combinations, product
from typing import get_args

import pytest

from abfm_viewer.appearance.theme import Color, palette
from abfm_viewer.document.document import THEMES
from abfm_viewer.widgets.toolkit import Kind
from tests.viewer.contrast import SIGHTS, contrast, difference

GROUNDS = ("panel", "field", "hovered", "pressed", "ground")
CURVES = ("muted", "smoothness", "closeness")  # of the energy and its terms
# in CIELAB, where 2.3 is just noticeable side by side; thin lines need several times as much
APART = 20.0
# at least, of texts, and of marks without which a widget could not be understood
READ, SEEN = 4.5, 3.0


@pytest.mark.parametrize(("theme", "ink", "ground"), [*product(THEMES, get_args(Kind), GROUNDS)])
def test_texts_stand_out_from_every_ground(theme, ink, ground):
    colors = palette(theme)
    assert contrast(getattr(colors, ink), getattr(colors, ground)) >= READ


@pytest.mark.parametrize("theme", THEMES)
def test_the_one_button_and_the_marks_of_sliders(theme):
    colors = palette(theme)
    assert contrast(colors.accent_ink, colors.accent) >= READ
    assert contrast(colors.accent_ink, colors.accent_hovered) >= READ
    assert contrast(colors.accent, colors.panel) >= SEEN
    assert contrast(colors.accent, colors.field) >= SEEN
    assert contrast(colors.marker, colors.field) >= SEEN


@pytest.mark.parametrize("theme", THEMES)
def test_curves_of_the_energy_stand_out_from_the_plot_and_from_each_other_for_every_eye(theme):
    colors = palette(theme)
    curves = [getattr(colors, name) for name in CURVES]
    for curve in curves:
        assert contrast(curve, colors.ground) >= SEEN
    for sight, (one, other) in product(SIGHTS, combinations(curves, 2)):
        assert difference(one, other, sight) > APART, sight


@pytest.mark.parametrize("theme", THEMES)
def test_the_terms_of_the_energy_have_not_the_hues_of_source_target_and_failure(theme):
    colors = palette(theme)
    for term, reserved in product(("smoothness", "closeness"), ("source", "target", "failure")):
        apart = abs(hue(getattr(colors, term)) - hue(getattr(colors, reserved))) % 360
        assert min(apart, 360 - apart) > 25, (term, reserved)


def hue(color: Color) -> float:
    return 360 * colorsys.rgb_to_hsv(*color[:3])[0]


@pytest.mark.parametrize("theme", THEMES)
def test_failure_has_a_hue_of_its_own(theme):
    colors = palette(theme)
    for name in ("source", "target", "accent", "accent_hovered", "good", "marker"):
        apart = abs(hue(colors.failure) - hue(getattr(colors, name))) % 360
        assert min(apart, 360 - apart) > 45, name
