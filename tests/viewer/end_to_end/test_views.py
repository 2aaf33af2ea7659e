"""Seeing surfaces large, from other sides, without some of them, and in other ways, by mouse,
menu and keys.
"""

from __future__ import annotations

import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from abfm.workers.progress import step
from abfm_viewer.computing import evaluation
from abfm_viewer.computing.defaults import default_functions
from abfm_viewer.computing.solver import State
from abfm_viewer.document.document import Channel
from abfm_viewer.panels.right_panel import STEPS
from abfm_viewer.widgets import popups
from abfm_viewer.widgets.toolkit import Ui
from abfm_viewer.window.view_actions import AXES, axis_front
from tests.shapes import torus

SURFACES = ("source", "advected", "target")


def middle(gui, name):
    return gui.window.scene.view.slots[name].middle


def picture(gui, folder):
    gui.screenshot(folder / "a.png")
    left, top, right, bottom = map(int, gui.window.parts.scene)
    return np.asarray(Image.open(folder / "a.png").convert("RGB"), int)[top:bottom, left:right]


def test_a_double_click_shows_one_surface_large_and_another_all_again(gui):
    steps = gui.session.editor.moves
    gui.input.move(*middle(gui, "target"))
    gui.input.click(2)
    assert gui.window.scene.shown == ("target",)
    left, _, right, _ = gui.window.parts.scene
    slot = gui.window.scene.view.slots["target"]
    assert (slot.rect[0], slot.rect[2]) == (left, right)
    assert gui.window.scene.pick(middle(gui, "target")).surface == "target"
    gui.input.move(*middle(gui, "target"))
    gui.input.click(2)
    assert gui.window.scene.shown == SURFACES
    assert gui.session.editor.moves == steps
    assert gui.session.notices.cards == ()  # an error in the frame of the click would be one


def test_escape_shows_all_again_and_cancels_a_run_only_then(running):
    running.input.move(*middle(running, "source"))
    running.input.click(2)
    assert running.window.scene.shown == ("source",)
    running.key("escape")
    assert running.window.scene.shown == SURFACES
    assert running.session.solver.running
    running.key("escape")
    running.wait(lambda s: s.solver.finished)


def test_escape_closes_a_menu_or_a_list_and_leaves_the_run(running):
    for label, kind in (("View", "menu"), ("Samples", "menu"), ("size", "combo")):
        running.click("Export", within=STEPS)
        running.click(label)
        running.key("escape")
        assert running.text_of(label, kind=kind) != "open"
        assert not popups.is_open()
        running.frames(3)
        assert running.session.solver.state is State.RUNNING
    running.key("escape")
    running.wait(lambda s: s.solver.finished)


def test_a_drag_beside_a_surface_leaves_it_upright_and_one_on_it_turns_it_freely(gui):
    def upright():
        return gui.window.scene.view.rotation @ gui.window.scene.view.upright

    (x, y), before = middle(gui, "source"), gui.window.scene.view.rotation
    _, top, _, bottom = gui.window.scene.view.slots["source"].rect
    for end in ((x + 70, top + 3), (x, bottom - 3), (x - 60, bottom - 10), (x, top - 300)):
        gui.input.drag((x + 70, bottom - 3), end)
        across, up, _ = upright()
        assert across == pytest.approx(0, abs=1e-9)
        assert up >= -1e-9
    assert np.abs(gui.window.scene.view.rotation - before).max() > 0.1
    gui.key("r")
    gui.input.drag((x + 10, y), (x + 10, y + 20), (x - 10, y + 20))
    assert abs(upright()[0]) > 0.01


def test_axes_are_looked_from_by_menu_and_key_and_undo_returns(gui):
    gui.input.drag((100, 200), (130, 210))
    turned = gui.session.view.look
    for axis in AXES:
        sign, name = (-1 if axis.startswith("-") else 1), axis[-1]
        for by_key in (False, True):
            if by_key:
                gui.key(name if sign > 0 else f"shift+{name}")
            else:
                gui.menu("View", "Look from", axis)
            front = gui.session.view.look.front
            assert front == axis_front(axis)
            np.testing.assert_allclose(np.linalg.det(front.axes), 1)
            assert sign * front.direction["xyz".index(name)] == 1
            gui.key("ctrl+z")
            assert gui.session.view.look == turned


def test_reset_is_a_step_and_a_drag_is_none(gui):
    steps = gui.session.editor.moves
    gui.input.drag((100, 200), (130, 210))
    assert gui.session.editor.moves == steps
    turned = gui.session.view.look
    gui.menu("View", "Reset camera")
    assert gui.session.view.look is None
    gui.key("ctrl+z")
    assert gui.session.view.look == turned
    gui.session.editor.set_parameter(alpha=2.0)
    gui.input.drag((100, 200), (100, 220))
    again = gui.session.view.look
    gui.key("ctrl+z")
    assert gui.session.view.look == again != turned  # what the mouse does meanwhile stays
    gui.key("r")
    assert gui.session.view.look is None


@pytest.mark.parametrize(
    ("label", "name", "key"), [("Wireframe", "wireframe", "w"), ("Flat shading", "flat", "f")]
)
def test_wireframe_and_flat_shading_come_and_go(gui, label, name, key, tmp_path):
    before = picture(gui, tmp_path)
    gui.menu("View", label)
    assert getattr(gui.session.view, name)
    assert np.abs(picture(gui, tmp_path) - before).mean() > 0.05
    gui.key("ctrl+z")
    assert not getattr(gui.session.view, name)
    assert np.abs(picture(gui, tmp_path) - before).mean() < 0.01
    gui.key(key)
    assert getattr(gui.session.view, name)
    gui.key(key)
    assert not getattr(gui.session.view, name)


def test_surfaces_are_hidden_and_shown_by_menu_and_keys(gui):
    for name in SURFACES:
        gui.menu("View", "Surfaces", name)
        assert gui.window.scene.shown == tuple(other for other in SURFACES if other != name)
        gui.menu("View", "Surfaces", name)
        assert gui.window.scene.shown == SURFACES
    gui.input.move(*middle(gui, "source"))
    gui.key("h")
    assert gui.window.scene.shown == ("advected", "target")
    gui.input.move(*middle(gui, "target"))
    gui.key("h")
    gui.input.move(*middle(gui, "advected"))
    gui.key("h")
    assert gui.window.scene.shown == ("advected",)
    assert "only surface" in gui.session.notices.latest.text
    gui.key("ctrl+z")
    assert gui.window.scene.shown == ("advected", "target")
    gui.menu("View", "Surfaces", "Show all")
    assert gui.window.scene.shown == SURFACES
    gui.input.move(*middle(gui, "source"))
    gui.key("h")
    gui.key("shift+h")
    assert gui.window.scene.shown == SURFACES
    gui.input.move(1, 1)
    gui.key("h")
    assert "point at one" in gui.session.notices.latest.text
    assert gui.window.scene.shown == SURFACES


def test_compared_surfaces_are_hidden_and_shown_as_well(gui):
    others = ("linear blend", "optimal transport", "error")
    for name in others:
        gui.check(name)
    for name in others:
        gui.menu("View", "Surfaces", name)
        assert name not in gui.window.scene.shown
        gui.menu("View", "Surfaces", name)
        assert name in gui.window.scene.shown


def test_a_hidden_surface_comes_back_as_it_was(gui, tmp_path):
    before = picture(gui, tmp_path)
    gui.menu("View", "Surfaces", "advected")
    gui.menu("View", "Surfaces", "advected")
    gui.frames(3)
    assert np.abs(picture(gui, tmp_path) - before).mean() < 0.01


def test_picks_are_right_wherever_surfaces_are_turned_and_zoomed(gui):
    scene, mesh = gui.window.scene, gui.session.surface().mesh
    gui.input.drag(
        middle(gui, "source"), (middle(gui, "source")[0] + 40, middle(gui, "source")[1] + 25)
    )
    for zoom in (0, 8):
        gui.input.move(*middle(gui, "advected"))
        gui.input.wheel(zoom)
        for name in SURFACES:
            x, y = middle(gui, name)
            for place in ((x, y), (x + 20, y - 15), (x - 12, y + 9)):
                hit = scene.pick(place)
                assert hit.surface == name
                point = np.array(hit.point.barycentric) @ mesh.vertices[mesh.faces[hit.point.face]]
                off = np.hypot(*(scene.projected(name, point)[0, :2] - (np.floor(place) + 0.5)))
                assert off < 1.0


def test_a_mesh_is_seen_at_once_and_stays_as_it_appears(gui, monkeypatch, tmp_path):
    """Grey in its slots, while a card says what is computed; then its functions come, and
    nothing turns.
    """
    may_go_on = threading.Event()

    def slowly(mesh):
        with step("thinking"):
            assert may_go_on.wait(60)
            return default_functions(mesh)

    monkeypatch.setattr(evaluation, "default_functions", slowly)
    gui.session.set_mesh(torus(24, 12, r=0.3), "torus")
    gui.frames(1)
    assert gui.window.scene.shown == SURFACES
    rotation, front = gui.window.scene.view.rotation, gui.session.surface().front
    gui.wait(lambda s: gui.window.errors or time.perf_counter() - s.functions.bare_since > 0.5)
    notes = []
    monkeypatch.setattr(Ui, "note", lambda ui, text, *rest: notes.append(text))
    gui.frames(1)
    assert "Choosing functions: thinking" in notes
    assert not gui.session.saves.unsaved
    monkeypatch.undo()
    bare = picture(gui, tmp_path)
    assert gui.window.scene.paints == {}
    for name in SURFACES:
        x, y = map(int, middle(gui, name))
        left, top = map(int, gui.window.parts.scene[:2])
        around = bare[y - top - 40 : y - top + 40, x - left - 40 : x - left + 40].reshape(-1, 3)
        assert len(np.unique(around, axis=0)) > 10  # of the shading
        assert np.ptp(around, axis=1).max() < 20
    may_go_on.set()
    gui.wait(lambda s: not s.obstacle and not gui.window.shown.busy)
    gui.frames(2)
    assert set(gui.window.scene.paints) == set(SURFACES)
    np.testing.assert_array_equal(gui.window.scene.view.rotation, rotation)
    assert gui.session.surface().front == front
    assert gui.session.functions.bare_since is None
    assert not gui.session.saves.unsaved


def test_functions_of_its_own_decide_how_a_mesh_is_seen(gui):
    """Of a project, or a figure of the paper."""
    session, before = gui.session, gui.window.scene.view.rotation[2]
    behind = int(np.argmin(session.surface().mesh.vertices @ before))
    spec = f"gaussian:vertex={behind},width=0.2"
    unseen = replace(session.surface(), front=None)
    session.editor.amend(channels=(Channel(spec, spec),), surfaces=(unseen,))
    gui.wait(lambda s: not s.obstacle and gui.window.scene.names)
    assert gui.window.scene.view.rotation[2] @ before < 0
