from dataclasses import replace

import numpy as np
import pytest

from abfm.calculus.operators import face_normals, vertex_areas
from abfm_viewer.document.document import FIELD_PARTS
from abfm_viewer.scene import overlays
from abfm_viewer.scene.scene import FAINT_TEXT
from tests.viewer.sessions import ENDLESS, begin, cancel

MAPS = ("coordinates", "checker", "area distortion", "conformal distortion", "function")

WINDOW = (640, 720)  # high enough for a tab below a verdict with a warning


def calm(gui):
    """Wait until no background job runs, also after the next frames."""
    gui.frames(3)
    gui.wait(lambda _: not gui.window.shown.busy)
    gui.frames(3)


@pytest.mark.usefixtures("coarse_streaks")
def test_tour_of_look(matched, walk):
    """Every choice of the tab Look is used, after a match and during a run."""
    walk(matched, show_fields_maps_and_comparisons, switch_arrows_streaks_lines_and_points)
    walk(matched, warn_of_a_torn_map, follow_a_run_with_arrows)


def show_fields_maps_and_comparisons(matched):
    for coloring in ("speed", "divergence", "curl", *MAPS):
        matched.choose("colour by", coloring)
        assert matched.session.view.coloring == coloring
        calm(matched)
        if coloring in MAPS:
            matched.drag("time", 0.5)
            calm(matched)
    for chosen in ("full", "robust"):
        matched.choose("range", chosen)
        assert matched.session.view.full_range == (chosen == "full")
    for part in (*FIELD_PARTS[1:], FIELD_PARTS[0]):
        matched.choose("part", part)
        assert matched.session.view.part == part
        calm(matched)
    scene, session = matched.window.scene, matched.session
    for label, count in (("linear blend", 4), ("error", 5)):
        matched.check(label)
        calm(matched)
        assert len(scene.names) == count
    matched.type("time", "0.5")
    calm(matched)
    source, target = (session.values(side) for side in ("source", "target"))
    blend = scene.paints["linear blend"].values
    np.testing.assert_allclose(blend, 0.5 * (source + target), atol=1e-6)
    matched.check("linear blend", False)
    matched.check("optimal transport")
    matched.wait(lambda _: not matched.window.shown.mass_transport.busy)
    assert scene.names == ("source", "advected", "optimal transport", "error", "target")
    found, weights = scene.paints["optimal transport"].values, vertex_areas(session.surface().mesh)
    assert weights @ found == pytest.approx(0.5 * (weights @ source + weights @ target))
    assert abs(found - 0.5 * (source + target)).max() > 0.05
    matched.check("optimal transport", False)
    matched.check("error", False)
    matched.frames(2)
    assert scene.names == ("source", "advected", "target")


def switch_arrows_streaks_lines_and_points(matched):
    session = matched.session
    matched.check("arrows")
    matched.drag("length", 0.2)
    assert session.view.arrow_length == pytest.approx(0.2, abs=0.01)
    matched.type("length", "0.15", within="Look")
    matched.drag("density", 0.8)
    matched.type("density", "0.5", within="Look")
    assert session.view.arrow_density == 0.5
    arrows = matched.window.shown.quantities._arrows
    matched.wait(lambda _: arrows.value is not None and arrows.value.opacities.min() < 0.9)
    assert FAINT_TEXT in matched.window.scene.legend()
    matched.check("fade uncertain motion", False)
    matched.wait(lambda _: arrows.value.opacities.min() == 1)
    assert FAINT_TEXT not in matched.window.scene.legend()
    matched.check("fade uncertain motion")
    matched.check("streaks")
    calm(matched)
    paints = matched.window.scene.paints
    for coloring, bar in (("speed", "speed, in"), ("curl", "curl"), ("function", "function")):
        matched.choose("colour by", coloring)
        matched.wait(lambda _, bar=bar: paints["advected"].bar.startswith(bar))
        matched.wait(lambda _: paints["advected"].kind == "texture")
    matched.choose("colour by", "checker")
    assert not matched.is_enabled("streaks")
    matched.choose("colour by", "function")
    matched.check("fade with speed")
    assert session.view.fade
    calm(matched)
    matched.check("animate")
    streaks = matched.window.shown.quantities._streaks
    matched.wait(lambda _: streaks.value is not None and len(streaks.value.images) > 1)
    phase = session.player.phase
    matched.frames(5)
    assert session.player.phase != phase
    calm(matched)
    for label in ("animate", "fade with speed", "arrows", "streaks"):
        matched.check(label, False)
    calm(matched)
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


def warn_of_a_torn_map(matched, notes):
    """Check that there is a warning where the torn map is shown, and nowhere else."""

    def warned():
        return [text for text, _ in notes() if "this map is not reliable" in text]

    session, rng = matched.session, np.random.default_rng(0)
    good, mesh = session.result, session.surface().mesh
    slow = replace(good, fine_velocity=1e-3 * good.velocity)
    wild, normals = rng.normal(size=good.velocity.shape) * mesh.length_scale, face_normals(mesh)
    wild -= (wild * normals).sum(axis=-1, keepdims=True) * normals
    matched.click("Look")
    matched.drag("time", 1.0)
    for result, expected in ((slow, 0), (replace(good, fine_velocity=wild), 1)):
        session.editor.amend(result=result)
        for coloring in MAPS:
            matched.choose("colour by", coloring)
            calm(matched)
            count = expected if coloring != "function" else 0
            matched.wait(lambda _, count=count: len(warned()) >= count)
            assert len(warned()) == count


def follow_a_run_with_arrows(gui, monkeypatch):
    """Check that arrows follow a run as often as the surface, and the user's changes at once."""
    gui.session.editor.amend(parameters=ENDLESS)
    gui.check("arrows")
    begin(gui)
    structures = gui.window.scene.overlays.structures
    gui.wait(lambda _: any(name == "arrows" for _, name, *_ in structures()))
    drawn, draw = [], overlays.draw_arrows
    monkeypatch.setattr(overlays, "draw_arrows", lambda *given: (drawn.append(given), draw(*given)))
    monkeypatch.setattr(gui.window.scene.pacing, "waits", lambda name, is_first: True)
    for _ in range(5):  # arrows that the user requests are drawn at once
        drawn.clear()
        before = gui.session.matching.snapshot.shown.iteration
        gui.wait(lambda s, before=before: s.matching.snapshot.shown.iteration > before + 5)
        if not drawn:
            break
    assert drawn == []
    gui.type("length", "0.01")
    gui.wait(lambda _: drawn)
    cancel(gui)
