import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from abfm.flow.continuous_flow import field_on_children
from abfm.pages.front import front_of
from abfm.workers.progress import step
from abfm_viewer.automation import DriverError
from abfm_viewer.computing import evaluation
from abfm_viewer.computing.defaults import default_functions
from abfm_viewer.computing.run import RunState
from abfm_viewer.document.document import Channel
from abfm_viewer.document.keyboard import AXES
from abfm_viewer.panels import cards
from abfm_viewer.panels.right_panel import STEPS
from abfm_viewer.widgets.containers import is_popup_open
from abfm_viewer.window.actions import views_by_axis
from tests.messages import check_message, raises
from tests.shapes import torus
from tests.viewer.sessions import begin, match

SURFACES = ("source", "advected", "target")


def middle(gui, name):
    return gui.window.scene.view.slots[name].middle


def point_at(gui, name):
    gui.input.move(*middle(gui, name))


def picture(gui, folder):
    gui.screenshot(folder / "a.png")
    left, top, right, bottom = map(int, gui.window.parts.scene)
    return np.asarray(Image.open(folder / "a.png").convert("RGB"), int)[top:bottom, left:right]


def test_tour_of_views(gui, walk):
    walk(gui, front_shows_the_functions, turn_and_pick, reset_and_look_from_axes, show_a_finer_mesh)
    walk(gui, switch_wireframe_and_flat_shading, hide_and_show_surfaces, show_a_mesh_at_once)


def test_tour_of_escape(running):
    """Escape ends the foremost thing first, and the run last."""
    enlarge_one_surface(running)
    begin(running)
    escape_a_menu_before_the_run(running)


def enlarge_one_surface(running):
    """Enlarge a surface by a double click; another one or Escape shows all again."""
    gui, scene, moves = running, running.window.scene, running.session.editor.action_count
    point_at(gui, "target")
    gui.input.click(2)
    assert scene.shown == ("target",)
    left, _, right, _ = gui.window.parts.scene
    slot = scene.view.slots["target"]
    assert (slot.rect[0], slot.rect[2]) == (left, right)
    assert scene.pick(middle(gui, "target")).surface == "target"
    point_at(gui, "target")
    gui.input.click(2)
    assert scene.shown == SURFACES
    point_at(gui, "source")
    gui.input.click(2)
    assert scene.shown == ("source",)
    gui.key("escape")
    assert scene.shown == SURFACES
    assert gui.session.editor.action_count == moves
    assert gui.session.notices.cards == ()  # an error in the frame of the click would be recorded
    assert gui.session.solver.running
    gui.key("escape")
    gui.wait(lambda s: s.solver.finished)


def escape_a_menu_before_the_run(running):
    for label, kind in (("View", "menu"), ("Samples", "menu"), ("colour by", "combo")):
        running.click("Look", within=STEPS)
        running.click(label)
        running.key("escape")
        assert running.text_of(label, kind=kind) != "open"
        assert not is_popup_open()
        running.frames(3)
        assert running.session.solver.state is RunState.RUNNING
    running.key("escape")
    running.wait(lambda s: s.solver.finished)


def turn_and_pick(gui):
    """Check that a drag next to a surface keeps it upright, and that picks are right."""

    def upright():
        view = gui.window.scene.view
        return view.rotation @ view.upright

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
    gui.key("r")
    scene, mesh, (x, y) = gui.window.scene, gui.session.surface().mesh, middle(gui, "source")
    gui.input.drag((x, y), (x + 40, y + 25))
    for zoom in (0, 8):
        point_at(gui, "advected")
        gui.input.wheel(zoom)
        for name in SURFACES:
            x, y = middle(gui, name)
            for place in ((x, y), (x + 20, y - 15), (x - 12, y + 9)):
                hit = scene.pick(place)
                assert hit.surface == name
                point = np.array(hit.point.barycentric) @ mesh.vertices[mesh.faces[hit.point.face]]
                off = np.hypot(*(scene.projected(name, point)[0, :2] - (np.floor(place) + 0.5)))
                assert off < 1.0


def reset_and_look_from_axes(gui):
    """Reset the view and look along axes, each a step of undo, whereas drags are none."""
    steps, scene, (x, y) = gui.session.editor.action_count, gui.window.scene, middle(gui, "source")
    before = scene.viewpoint
    gui.input.drag((x, y), (x + 60, y + 30))
    assert not np.allclose(scene.viewpoint.front.direction, before.front.direction, atol=0.1)
    assert gui.session.editor.action_count == steps
    turned = gui.session.view.viewpoint
    gui.menu("View", "Reset camera")
    assert gui.session.view.viewpoint is None
    assert scene.viewpoint == before
    gui.key("ctrl+z")
    assert gui.session.view.viewpoint == turned
    gui.session.editor.set_parameter(alpha=2.0)
    gui.input.drag((100, 200), (100, 220))
    again = gui.session.view.viewpoint
    gui.key("ctrl+z")
    assert gui.session.view.viewpoint == again != turned  # undo keeps changes by the mouse
    gui.key("r")
    assert gui.session.view.viewpoint is None
    for act, words in ((gui.menu, ("View", "Look from", "Best view")), (gui.key, ("b",))):
        act(*words)
        functions = [gui.session.values(side) for side in ("source", "target")]
        best = front_of(gui.session.surface().mesh, *functions)
        assert gui.session.view.viewpoint.front == best
        gui.key("ctrl+z")
    gui.input.drag((100, 200), (130, 210))
    turned = gui.session.view.viewpoint
    for axis in AXES:
        sign, name = (-1 if axis.startswith("-") else 1), axis[-1]
        keys = name if sign > 0 else f"shift+{name}"
        side, expected = views_by_axis(gui.session.surface().mesh)[axis]
        for act, words in ((gui.menu, ("View", "Look from", side)), (gui.key, (keys,))):
            act(*words)
            front = gui.session.view.viewpoint.front
            assert front == expected
            np.testing.assert_allclose(np.linalg.det(front.axes), 1)
            assert sign * front.direction["xyz".index(name)] == 1
            gui.key("ctrl+z")
            assert gui.session.view.viewpoint == turned


def switch_wireframe_and_flat_shading(gui, tmp_path):
    for label, name, key in (("Wireframe", "wireframe", "w"), ("Flat shading", "flat", "f")):
        before = picture(gui, tmp_path)
        gui.menu("View", label)
        assert getattr(gui.session.view, name)
        assert np.abs(picture(gui, tmp_path) - before).mean() > 0.05
        gui.key("ctrl+z")
        assert not getattr(gui.session.view, name)
        assert np.abs(picture(gui, tmp_path) - before).mean() < 0.01
        for expected in (True, False):
            gui.key(key)
            assert getattr(gui.session.view, name) is expected


def show_a_finer_mesh(gui):
    """Show a match on a finer mesh, on which clicks refer to vertices of the mesh itself."""
    session, own = gui.session, gui.session.surface().mesh
    session.editor.set_parameter(refine=0)
    match(gui)
    with raises(DriverError, "Finer mesh"):  # the match was found on the mesh itself
        gui.menu("View", "Finer mesh")
    gui.key("escape")
    fields = np.stack([field_on_children(own, field) for field in session.result.velocity])
    session.editor.amend(result=replace(session.result, fine_velocity=fields))
    gui.menu("View", "Finer mesh")
    assert session.view.finer

    def sizes():
        return {len(gui.window.scene._meshes[name].faces) for name in SURFACES}

    gui.wait(lambda s: sizes() == {4 * len(own.faces)})
    gui.pick(12)
    assert session.channels[0].source.startswith("gaussian:vertex=12,")
    gui.wait(lambda s: sizes() == {len(own.faces)})  # the match is that of other functions


def hide_and_show_surfaces(gui, tmp_path):
    scene, notices, before = gui.window.scene, gui.session.notices, picture(gui, tmp_path)
    for name in SURFACES:
        gui.menu("View", "Surfaces", name)
        assert scene.shown == tuple(other for other in SURFACES if other != name)
        gui.menu("View", "Surfaces", name)
        assert scene.shown == SURFACES
    gui.frames(3)
    gui.input.move(1, 1)
    assert np.abs(picture(gui, tmp_path) - before).mean() < 0.01
    for name in ("source", "target", "advected"):
        point_at(gui, name)
        gui.key("h")
    assert scene.shown == ("advected",)
    check_message(notices.latest.text)
    gui.key("ctrl+z")
    assert scene.shown == ("advected", "target")
    gui.menu("View", "Surfaces", "Show all")
    assert scene.shown == SURFACES
    point_at(gui, "source")
    gui.key("h")
    assert scene.shown == ("advected", "target")
    gui.key("shift+h")
    assert scene.shown == SURFACES
    gui.input.move(1, 1)
    gui.key("h")
    check_message(notices.latest.text)
    assert scene.shown == SURFACES
    others = ("linear blend", "optimal transport", "error")
    for name in others:
        gui.check(name)
    for name in others:
        gui.menu("View", "Surfaces", name)
        assert name not in scene.shown
        gui.menu("View", "Surfaces", name)
        assert name in scene.shown


def show_a_mesh_at_once(gui, monkeypatch, notes, tmp_path):
    """Show a mesh in grey, with a card, until its functions are computed; the view never turns."""
    may_go_on, session, scene = threading.Event(), gui.session, gui.window.scene

    def slowly(mesh):
        with step("thinking"):
            assert may_go_on.wait(60)
            return default_functions(mesh)

    monkeypatch.setattr(evaluation, "default_functions", slowly)
    session.set_mesh(torus(24, 12, r=0.3), "torus")
    gui.frames(1)
    assert scene.shown == SURFACES
    rotation, front = scene.view.rotation, session.surface().front
    gui.wait(lambda s: gui.window.errors or time.perf_counter() - s.functions.waiting_since > 0.5)
    check_message(next(text for text, _ in notes() if "thinking" in text))
    assert not session.saves.unsaved
    monkeypatch.setattr(cards, "_CARD_DELAY_SECONDS", 1e9)  # the card covers a surface
    bare = picture(gui, tmp_path)
    assert scene.paints == {}
    for name in SURFACES:
        x, y = map(int, middle(gui, name))
        left, top = map(int, gui.window.parts.scene[:2])
        around = bare[y - top - 40 : y - top + 40, x - left - 40 : x - left + 40].reshape(-1, 3)
        assert len(np.unique(around, axis=0)) > 10  # from the shading
        assert np.ptp(around, axis=1).max() < 20
    may_go_on.set()
    gui.wait(lambda s: not s.obstacle and not gui.window.shown.busy)
    gui.frames(2)
    assert set(scene.paints) == set(SURFACES)
    np.testing.assert_array_equal(scene.view.rotation, rotation)
    assert session.surface().front == front
    assert session.functions.waiting_since is None
    assert not session.saves.unsaved


def front_shows_the_functions(gui):
    """Check that the front shows the functions of a project, or of a figure of the paper."""
    session, before = gui.session, gui.window.scene.view.rotation[2]
    behind = int(np.argmin(session.surface().mesh.vertices @ before))
    spec = f"gaussian:vertex={behind},width=0.2"
    unseen = replace(session.surface(), front=None)
    session.editor.amend(channels=(Channel(spec, spec),), surfaces=(unseen,))
    gui.wait(lambda s: not s.obstacle and gui.window.scene.names)
    assert gui.window.scene.view.rotation[2] @ before < 0
