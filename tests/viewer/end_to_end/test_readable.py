"""What is on the screen can be read, and what cannot be used looks so: contrasts of the pixels
that are drawn.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from PIL import Image

from abfm_viewer.automation import Driver
from abfm_viewer.document.document import THEMES
from abfm_viewer.panels.right_panel import TABS
from tests.viewer.contrast import contrast
from tests.viewer.sessions import EGG, ENDLESS

_READABLE = 4.5
_WITH_WORDS = ("button", "tab", "checkbox", "combo", "box", "section", "menu", "choice")


@pytest.fixture(scope="module")
def large():
    with Driver(EGG, size=(1280, 800)) as gui:
        yield gui


def contrasts(gui, path):
    """Of each widget with words in view, by section and label: of its most frequent colour and
    the farthest from it.
    """
    gui.screenshot(path)
    picture = np.asarray(Image.open(path).convert("RGB"))
    found = {}
    for widget in gui.window.ui.widgets:
        left, top, right, bottom = map(round, widget.rect)
        inside = widget.area[1] <= top and bottom <= widget.area[3]
        if widget.kind in _WITH_WORDS and inside and (widget.text or widget.kind != "box"):
            colors = [
                tuple(color)
                for color in picture[top + 2 : bottom - 2, left + 2 : right - 2]
                .reshape(-1, 3)
                .tolist()
            ]
            (ground, _), *_ = Counter(colors).most_common(1)
            base = np.array(ground) / 255
            found[widget.section, widget.label, widget.kind] = (
                max(contrast(base, np.array(color) / 255) for color in set(colors)),
                widget.enabled,
            )
    return found


@pytest.mark.parametrize("theme", THEMES)
@pytest.mark.parametrize("tab", TABS)
def test_words_stand_out_from_what_is_behind_them(large, tmp_path, theme, tab):
    large.session.editor.set_view("theme", theme=theme)
    large.window.ui.open_tab = tab
    measured = contrasts(large, tmp_path / "window.png")
    assert len(measured) > 20
    faint = {
        name: round(value, 2)
        for name, (value, enabled) in measured.items()
        if enabled and value < _READABLE
    }
    assert faint == {}


@pytest.mark.parametrize("theme", THEMES)
def test_what_is_behind_a_dialog_looks_as_if_it_could_not_be_used(large, tmp_path, theme):
    large.session.editor.set_view("theme", theme=theme)
    large.session.editor.amend(parameters=ENDLESS)
    large.click("Match")
    large.wait(lambda s: s.solver.snapshot is not None)
    large.click("Export")
    before = contrasts(large, tmp_path / "free.png")
    large.window.dialogs.show("A title", ["A line."])
    large.frames(2)
    behind = contrasts(large, tmp_path / "behind.png")
    large.click("Close", within="A title")
    large.session.solver.cancel()
    large.wait(lambda s: s.solver.finished)
    used = {name for name, (_, enabled) in before.items() if enabled}
    assert {"Pause", "Cancel", "Play", "Save picture...", "Functions"} <= {
        label for _, label, _ in used
    }
    for name in used & behind.keys():
        assert not behind[name][1]
        assert behind[name][0] < 0.6 * before[name][0], name
