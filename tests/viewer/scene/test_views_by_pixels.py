"""Every surface is where it belongs, by pixels: in its slot, and in the free part of the window."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from abfm import load_mesh
from abfm.assets import asset_path
from abfm_viewer.document.document import LAYOUTS, Front, Look, triple
from abfm_viewer.scene import opengl
from abfm_viewer.scene.opengl import ps
from abfm_viewer.scene.scene import Scene
from abfm_viewer.session.session import Session
from abfm_viewer.shown.shown import Shown
from abfm_viewer.window.areas import areas

SIZES = [(1000, 700), (1280, 800), (2560, 1440)]
SCALES = [1.0, 2.0]
MENU, NAME, BARS = 20.0, 24.0, 56.0  # heights at a scale of 1, about those of the window
SMALLER = 8  # so many times, as drawing takes as long as there are pixels
BODY = load_mesh(asset_path("human_A.off"))


@pytest.fixture
def scene():
    """Plain bodies in slots, without a window."""
    opengl.start(opengl.OFFSCREEN, 64, 64)
    session = Session(BODY, "body", at_once=True)
    front = Front((0.0, 0.0, 1.0), (0.0, 1.0, 0.0))
    session.editor.amend(surfaces=session.document.facing(front).surfaces)
    shown = Shown(session)
    yield Scene(shown)
    opengl.clear()
    shown.close()
    session.close()


def looks(count):
    """From random sides."""
    for rotation in Rotation.random(count, np.random.default_rng(count)).as_matrix():
        yield Look(Front(triple(rotation[2]), triple(rotation[1])))


def drawn():
    """Where something is drawn, (H, W), apart from panels, names and bars."""
    pixels = ps.screenshot_to_buffer(transparent_bg=False)[..., :3].astype(int)
    return np.abs(pixels - pixels[0, 0]).max(axis=-1) > 3


def in_slots(mask, slots):
    """How many pixels each slot has, and how many are outside all of them."""
    outside, counts = mask.copy(), []
    for slot in slots.values():
        left, top, right, bottom = np.round(slot.rect).astype(int)
        counts.append(int(mask[top:bottom, left:right].sum()))
        outside[top:bottom, left:right] = False
    return counts, int(outside.sum())


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("layout", LAYOUTS)
def test_surfaces_lie_in_their_slots_from_every_side_and_however_near(scene, layout, size, scale):
    session, six = scene._session, layout == "automatic"
    view = replace(session.view, layout=layout, blend=six, transport=six, error=six, look=None)
    session.editor.amend(view=view)
    rect = tuple(end / SMALLER for end in areas(size, MENU * scale, scale).scene)
    scene.name_height, scene.room_below = NAME * scale / SMALLER, BARS * scale / SMALLER
    ps.set_window_size(*(length // SMALLER for length in size))
    for look in looks(25):
        session.editor.amend(view=replace(view, look=look))
        scene.update(rect)
        counts, outside = in_slots(drawn(), scene.view.slots)
        assert outside == 0
        assert min(counts) > 0
    for slot in scene.view.slots.values():
        assert rect[0] <= slot.rect[0] < slot.rect[2] <= rect[2]
        assert (
            rect[1]
            <= slot.name[1]
            <= slot.rect[1]
            < slot.rect[3]
            <= rect[3] - scene.room_below + 1e-6
        )
