"""Everything that is read can be read: contrast as WCAG 2.2 defines it, in both themes."""

from __future__ import annotations

from itertools import product
from typing import get_args

import pytest

from abfm_viewer.appearance.theme import palette
from abfm_viewer.document.document import THEMES
from abfm_viewer.widgets.texts import Ink
from tests.viewer.contrast import contrast

GROUNDS = ("panel", "field", "hovered", "pressed", "ground")
READ, SEEN = 4.5, 3.0  # at least, of texts, and of marks without which a widget could not be understood


@pytest.mark.parametrize(("theme", "ink", "ground"), product(THEMES, get_args(Ink), GROUNDS))
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
