"""Checks of pixels: words have contrast, and surfaces stay in their slots."""

from dataclasses import replace
from itertools import cycle, product

import numpy as np
import pytest
from PIL import Image

from abfm_viewer.automation import Driver
from abfm_viewer.document.document import LAYOUTS, THEMES
from abfm_viewer.panels.right_panel import TABS
from abfm_viewer.scene.opengl import ps
from tests.shapes import ellipsoid
from tests.viewer.contrast import contrast
from tests.viewer.sessions import EGG, ENDLESS

_READABLE = 4.5
_WITH_WORDS = ("button", "tab", "checkbox", "combo", "box", "section", "menu", "choice")


@pytest.fixture(scope="module")
def large():
    with Driver(EGG, size=(1280, 800)) as gui:
        yield gui


def contrasts(gui, path):
    """Return the contrast of each widget with text in view, and whether the widget is enabled.

    Keys are sections and labels. The contrast is that of the most frequent and the farthest
    colour.
    """
    gui.screenshot(path)
    picture, found = np.asarray(Image.open(path).convert("RGBA")), {}
    for widget in gui.window.ui.widgets:
        left, top, right, bottom = map(round, widget.rect)
        inside = widget.area[1] <= top and bottom <= widget.area[3]
        if widget.kind in _WITH_WORDS and inside and (widget.text or widget.kind != "box"):
            part = picture[top + 2 : bottom - 2, left + 2 : right - 2].reshape(-1, 4)
            words, counts = np.unique(part.view(np.uint32), return_counts=True)
            colors = (words[:, None].view(np.uint8)[:, :3] / 255).tolist()
            ground = colors[counts.argmax()]
            farthest = max(contrast(ground, color) for color in colors)
            found[widget.section, widget.label, widget.kind] = farthest, widget.enabled
    return found


@pytest.mark.parametrize("theme", THEMES)
@pytest.mark.parametrize("tab", TABS)
def test_words_have_contrast(large, tmp_path, theme, tab):
    large.session.editor.set_view("theme", theme=theme)
    large.window.ui.open_tab = tab
    measured = contrasts(large, tmp_path / "window.png")
    assert len(measured) > 20
    assert [it for it in measured.items() if it[1][1] and it[1][0] < _READABLE] == []


@pytest.mark.parametrize("theme", THEMES)
def test_widgets_behind_a_dialog_look_disabled(large, tmp_path, theme):
    large.session.editor.set_view("theme", theme=theme)
    large.session.editor.amend(parameters=ENDLESS)
    large.click("Match")
    large.wait(lambda s: s.matching.snapshot is not None)
    large.click("Export")
    before = contrasts(large, tmp_path / "free.png")
    large.window.dialogs.show("A title", ["A line."])
    large.frames(2)
    behind = contrasts(large, tmp_path / "behind.png")
    large.click("Close", within="A title")
    large.session.solver.cancel()
    large.wait(lambda s: s.solver.finished)
    used = {name for name, (_, enabled) in before.items() if enabled}
    labels = {label for _, label, _ in used}
    assert {"Pause", "Cancel", "Play", "Picture...", "Functions"} <= labels
    for name in used & behind.keys():
        assert not behind[name][1]
        assert behind[name][0] < 0.6 * before[name][0], name


LARGEST = (2560, 1440)
SIZES = [(1000, 700), LARGEST]
SCALES = [1.0, 2.0]
SMALL_EGG = ellipsoid(2, 1.0, 0.7, 0.55)  # the time of drawing depends on pixels and faces
DRAGS = (0.9, -0.8, 0.1)  # downwards, in half slots
MOVING = (1, 2)  # the right button, and the middle one
NOTCHES = 12  # of the wheel, after which the surface is larger than its slot


def pixels_outside(slots, margin=0):
    """Return the pixels of each surface in its slot, and the pixels outside of all slots."""
    buffer = np.ascontiguousarray(ps.screenshot_to_buffer(transparent_bg=False))
    pixels, counts = buffer.view(np.uint32)[..., 0], []
    drawn = pixels != pixels[0, 0]
    for slot in slots.values():
        left, top, right, bottom = slot.rect
        rows = slice(max(round(top - margin), 0), round(bottom + margin))
        part = drawn[rows, max(round(left - margin), 0) : round(right + margin)]
        counts.append(int(part.sum()))
        part[:] = False
    return counts, int(drawn.sum())


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_mouse_keeps_surfaces_in_their_slots(size):
    """Drags and zooms never draw outside slots; the largest window tests only one layout."""
    with Driver(SMALL_EGG, size=size) as gui:
        down = cycle(DRAGS)
        layouts = LAYOUTS if size < LARGEST else ("automatic",)
        for (scale, button), layout in product(zip(SCALES, MOVING, strict=True), layouts):
            six = layout == "automatic"
            view = replace(gui.session.view, ui_scale=scale, layout=layout, viewpoint=None)
            gui.session.editor.amend(view=replace(view, blend=six, transport=six, error=six))
            gui.frames(2)
            slots, area = gui.window.scene.view.slots, gui.window.parts.scene
            (x, y), (width, height) = slots["advected"].middle, slots["advected"].half
            lowest = area[3] - gui.window.scene.bars_height + 1e-6
            for slot in slots.values():
                assert area[0] <= slot.rect[0] < slot.rect[2] <= area[2]
                assert area[1] <= slot.name[1] < slot.rect[3] <= lowest
            gui.input.drag((x, y), (x + 0.6 * width, y + next(down) * height), steps=1)
            turned = gui.session.view.viewpoint
            assert turned.front != gui.session.surface().front
            counts, outside = pixels_outside(slots)
            assert (min(counts) > 0, outside) == (True, 0), (scale, layout)
            gui.input.move(x + width / 2, y)
            gui.input.wheel(NOTCHES)
            assert gui.session.view.viewpoint.zoom == pytest.approx(1.15**NOTCHES)
            gui.input.drag((x, y), (x - width / 2, y + height), steps=1, button=button)
            assert gui.session.view.viewpoint.target is not None
            counts, outside = pixels_outside(slots, margin=1)
            assert (min(counts) > 0, outside) == (True, 0), (scale, layout)
            assert gui.session.view.viewpoint.front == turned.front
        assert gui.errors == {}
