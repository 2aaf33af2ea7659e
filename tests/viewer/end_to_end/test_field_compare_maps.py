"""The tab Look: what the surfaces show, arrows, streaks, flow lines, followed points,
comparisons.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from abfm.calculus.operators import face_normals, vertex_areas
from abfm_viewer.document.document import FIELD_PARTS
from abfm_viewer.scene import overlays
from abfm_viewer.widgets.toolkit import Ui
from tests.viewer.sessions import ENDLESS

MAPS = ("coordinates", "checker", "area distortion", "conformal distortion", "function")


def calm(gui):
    """Wait until nothing is computed in the background, of which the next frames may yet ask for
    something.
    """
    gui.frames(3)
    gui.wait(lambda _: not gui.window.shown.busy)
    gui.frames(3)


def test_the_advected_surface_shows_the_field(matched):
    for coloring in ("speed", "divergence", "curl", "function"):
        matched.choose("color by", coloring)
        assert matched.session.view.coloring == coloring
        calm(matched)
    for part in (*FIELD_PARTS[1:], FIELD_PARTS[0]):
        matched.choose("part", part)
        assert matched.session.view.part == part
        calm(matched)
    assert not matched.errors


@pytest.mark.usefixtures("coarse_streaks")
def test_arrows_and_streaks(matched):
    matched.check("arrows")
    matched.drag("length", 0.2)
    assert matched.session.view.arrow_length == pytest.approx(0.2, abs=0.01)
    matched.type("length", "0.15", within="Look")
    matched.drag("density", 0.8)
    matched.type("density", "0.5", within="Look")
    assert matched.session.view.arrow_density == 0.5
    matched.check("streaks")
    calm(matched)
    matched.check("fade with speed")
    assert matched.session.view.fade
    calm(matched)
    matched.check("animate")
    streaks = matched.window.shown.quantities._streaks
    matched.wait(lambda _: streaks.value is not None and len(streaks.value.images) > 1)
    phase = matched.session.player.phase
    matched.frames(5)
    assert matched.session.player.phase != phase
    calm(matched)
    matched.check("animate", False)
    matched.check("fade with speed", False)
    matched.check("arrows", False)
    matched.check("streaks", False)
    calm(matched)
    assert not matched.errors


def test_clicks_start_flow_lines_and_follow_points(matched):
    for tool, name, clear in (
        ("flow line", "lines", "Clear lines"),
        ("follow a point", "points", "Clear points"),
    ):
        matched.click(tool, within="Look")
        matched.pick(vertex=12, surface="advected", modifiers=())
        matched.pick(vertex=40, surface="source", modifiers=())
        assert len(getattr(matched.session.document, name)) == 2
        calm(matched)
        matched.drag("time", 0.3)
        matched.click(clear)
        assert getattr(matched.session.document, name) == ()
    matched.click("nothing", within="Look")
    matched.pick(vertex=12, modifiers=())
    assert matched.session.document.points == ()


def test_maps_color_the_advected_surface(matched):
    for coloring in MAPS:
        matched.choose("color by", coloring)
        assert matched.session.view.coloring == coloring
        calm(matched)
        matched.drag("time", 0.5)
        calm(matched)


@pytest.fixture
def notes(monkeypatch):
    """What the panels write."""
    found, note = [], Ui.note
    monkeypatch.setattr(
        Ui, "note", lambda ui, text, *kind: found.append(text) or note(ui, text, *kind)
    )
    return found


def test_a_map_that_is_none_is_warned_of_where_it_is_shown(matched, notes):
    def warned():
        return [text for text in notes if text.startswith("Warning: this map is not to be trusted")]

    session = matched.session
    good = session.result
    slow = replace(good, velocity=1e-3 * good.velocity)
    wild = (
        np.random.default_rng(0).normal(size=good.velocity.shape)
        * session.surface().mesh.length_scale
    )
    normals = face_normals(session.surface().mesh)
    wild -= (wild * normals).sum(axis=-1, keepdims=True) * normals
    matched.drag("time", 1.0)
    for result, expected in ((slow, 0), (replace(good, velocity=wild), 1)):
        session.editor.amend(result=result)
        for coloring in MAPS:
            matched.choose("color by", coloring)
            calm(matched)
            notes.clear()
            wanted = expected if coloring != "function" else 0
            matched.wait(lambda _, wanted=wanted: len(warned()) >= wanted)
            notes.clear()
            matched.frames(1)
            assert len(warned()) == wanted


def test_numbers_of_the_last_run_are_gone_during_a_new_one(matched, notes):
    def told():
        notes.clear()
        matched.frames(1)
        return any(text.startswith("Mismatch at τ") for text in notes)

    matched.click("Look")
    assert told()
    matched.session.editor.amend(parameters=ENDLESS)
    matched.click("Match")
    matched.wait(lambda s: s.solver.snapshot is not None)
    assert not told()
    matched.session.solver.cancel()
    matched.wait(lambda s: s.solver.finished)
    assert told()


def test_the_comparison_has_surfaces_of_its_own(matched):
    scene = matched.window.scene
    matched.check("linear blend")
    calm(matched)
    assert len(scene.names) == 4
    matched.check("error")
    calm(matched)
    assert len(scene.names) == 5
    matched.type("time", "0.5")
    calm(matched)
    source, target = (matched.session.values(side) for side in ("source", "target"))
    blend = next(name for name in scene.names if "blend" in name)
    np.testing.assert_allclose(scene.paints[blend].values, 0.5 * (source + target), atol=1e-6)
    matched.check("linear blend", False)
    matched.check("optimal transport")
    matched.wait(lambda _: not matched.window.shown.mass_transport.busy)
    assert scene.names == ("source", "advected", "optimal transport", "error", "target")
    found = scene.paints["optimal transport"].values
    weights = vertex_areas(matched.session.surface().mesh)
    assert weights @ found == pytest.approx(0.5 * (weights @ source + weights @ target))
    assert abs(found - 0.5 * (source + target)).max() > 0.2
    matched.check("optimal transport", False)
    matched.check("error", False)
    matched.frames(2)
    assert scene.names == ("source", "advected", "target")


def test_arrows_follow_a_run_no_more_often_than_the_surface_and_the_user_at_once(gui, monkeypatch):
    gui.session.editor.amend(parameters=ENDLESS)
    gui.check("arrows")
    gui.click("Match")
    gui.wait(
        lambda _: any(name == "arrows" for _, name, *_ in gui.window.scene.overlays.structures())
    )
    drawn = []
    draw = overlays.draw_arrows
    monkeypatch.setattr(overlays, "draw_arrows", lambda *given: (drawn.append(given), draw(*given)))
    monkeypatch.setattr(gui.window.scene.pacing, "waits", lambda name, is_first: True)
    before = gui.session.solver.snapshot.shown
    gui.wait(lambda s: s.solver.snapshot.shown.iteration > before.iteration + 5)
    assert drawn == []
    gui.type("length", "0.2")
    gui.frames(2)
    assert drawn
    gui.click("Cancel")
    gui.wait(lambda s: s.solver.finished)
