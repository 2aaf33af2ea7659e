"""Surfaces in windows of every size and scale, turned, zoomed and moved by a mouse: by pixels,
where they belong.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import cycle, product

import numpy as np
import pytest

from abfm_viewer.automation import Driver
from abfm_viewer.document.document import LAYOUTS
from abfm_viewer.scene.opengl import ps
from abfm_viewer.scene.scene import Placing
from tests.shapes import ellipsoid

LARGEST = (2560, 1440)
SIZES = [(1000, 700), LARGEST]
SCALES = [1.0, 2.0]
PLAIN = ellipsoid(2, 1.0, 0.7, 0.55)  # drawing takes as long as there are pixels and faces
DRAGS = (0.9, -0.8, 0.1)  # downwards, in halves of a slot
MOVING = (1, 2)  # the right button, and the middle one
NOTCHES = 12  # of the wheel: the surface is then larger than its slot


def stray(slots, margin=0):
    """How many pixels of each surface are in its slot, and how many are outside of all slots."""
    pixels = np.ascontiguousarray(ps.screenshot_to_buffer(transparent_bg=False)).view(np.uint32)[
        ..., 0
    ]
    drawn = pixels != pixels[0, 0]
    counts = []
    for slot in slots.values():
        left, top, right, bottom = (
            round(end + far)
            for end, far in zip(slot.rect, (-margin, -margin, margin, margin), strict=True)
        )
        part = drawn[max(top, 0) : bottom, max(left, 0) : right]
        counts.append(int(part.sum()))
        part[:] = False
    return counts, int(drawn.sum())


@pytest.fixture
def undrawn(monkeypatch):
    """Nothing is drawn anew by frames, of which each takes most of a second at such sizes; call
    it to catch up.
    """
    place, latest = Placing.place, []
    monkeypatch.setattr(Placing, "place", lambda *what: latest.append(what))

    def catch_up():
        place(*latest[-1])
        latest.clear()

    return catch_up


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_the_mouse_leaves_every_surface_in_its_slot(size, undrawn):
    """In the largest window for the six surfaces of the automatic layout alone: drawing takes
    seconds there.
    """
    with Driver(PLAIN, size=size) as gui:
        down = cycle(DRAGS)
        layouts = LAYOUTS if size < LARGEST else ("automatic",)
        for (scale, button), layout in product(zip(SCALES, MOVING, strict=True), layouts):
            six = layout == "automatic"
            view = replace(gui.session.view, ui_scale=scale, layout=layout, look=None)
            gui.session.editor.amend(view=replace(view, blend=six, transport=six, error=six))
            gui.frames(2)
            slots, area = gui.window.scene.view.slots, gui.window.parts.scene
            (x, y), (width, height) = slots["advected"].middle, slots["advected"].half
            lowest = area[3] - gui.window.scene.room_below + 1e-6
            for slot in slots.values():
                assert area[0] <= slot.rect[0] < slot.rect[2] <= area[2]
                assert area[1] <= slot.name[1] < slot.rect[3] <= lowest
            gui.input.drag((x, y), (x + 0.6 * width, y + next(down) * height), steps=1)
            turned = gui.session.view.look
            assert turned.front != gui.session.surface().front
            undrawn()
            counts, outside = stray(slots)
            assert (min(counts) > 0, outside) == (True, 0), (scale, layout)
            gui.input.move(x + width / 2, y)
            gui.input.wheel(NOTCHES)
            assert gui.session.view.look.zoom == pytest.approx(1.15**NOTCHES)
            gui.input.drag((x, y), (x - width / 2, y + height), steps=1, button=button)
            assert gui.session.view.look.target is not None
            undrawn()
            counts, outside = stray(slots, margin=1)
            assert (min(counts) > 0, outside) == (True, 0), (scale, layout)
            assert gui.session.view.look.front == turned.front
        assert gui.errors == {}
