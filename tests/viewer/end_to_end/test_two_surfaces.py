"""Surface A is registered to surface B in the window."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import abfm
from abfm_viewer.computing.background import same
from abfm.mesh.shapes import even_sphere
from abfm_viewer.automation import Driver
from abfm_viewer.document.document import Channel
from tests.mesh_writers import off_file
from tests.shapes import ellipsoid, icosphere, torus
from tests.viewer.sessions import SIZE, match

NEAR, FAR = "gaussian:x=1,y=0,z=0,width=0.2", "gaussian:x=0.8,y=0.4,z=0,width=0.2"


@pytest.fixture
def files(tmp_path):
    """Two bodies with the same connectivity, one without it, and spheres."""
    meshes = {
        "egg": ellipsoid(3, 1.0, 0.7, 0.55),
        "ball": icosphere(3, 10.0),
        "ring": torus(12, 8),
        "even": even_sphere(300),
    }
    return {name: off_file(tmp_path / f"{name}.off", mesh) for name, mesh in meshes.items()}


@pytest.fixture
def pair(files):
    """The app with an egg that is registered to a ball, seen standing still."""
    with Driver((files["egg"], files["ball"]), size=SIZE) as gui:
        gui.window.dialogs.folder = files["egg"].parent
        view = replace(gui.session.view, flow_after_match=False)
        short = replace(gui.session.parameters, iterations=20, cooling_stages=1)
        gui.session.editor.amend(view=view, parameters=short)
        gui.wait(lambda s: not s.obstacle)
        yield gui
        assert not gui.errors


def open_second(gui, path):
    gui.menu("File", "Open second surface...")
    gui.double_click(path.name)
    gui.wait(lambda s: s.document.name.endswith(f"to {path.name}") and s.values("target") is not None)


def test_a_second_surface_is_opened_and_closed_and_undo_goes_back(gui, files, notes):
    egg, source = gui.session.surface().mesh, gui.session.active.source
    open_second(gui, files["ball"])
    session = gui.session
    gui.wait(lambda s: not s.obstacle)
    ball = session.surface("target").mesh
    assert session.surface("source").mesh is egg
    assert [session.surface(slot).mesh for slot in ("advected", "error")] == [ball, ball]
    assert session.active.source == source  # what the user may have set stays
    assert len(session.values("target")) == len(ball.vertices)
    titles = {name: paint.title for name, paint in gui.window.scene.paints.items()}
    assert titles["source"] == "source on A"
    assert titles["advected"] == "advected on B"
    gui.menu("File", "Close second surface")
    gui.wait(lambda s: len(s.document.surfaces) == 1 and not s.obstacle)
    assert session.surface().mesh is egg
    assert session.active.source == source
    gui.key("ctrl+z")
    assert session.surface().mesh is ball
    gui.key("ctrl+z")
    assert session.document.surfaces[-1].mesh is egg
    open_second(gui, files["ring"])
    gui.wait(lambda s: s.obstacle.startswith("no initial map") or print("XX", s.obstacle, s.initial_maps._prepared.value, repr(s.initial_maps._prepared.error), s.initial_maps._prepared._running, s.initial_maps._prepared._job, s.initial_maps._prepared._has_thread, same(s.initial_maps._prepared.key, s.initial_maps._prepared._wanted), s.document.channels), 2)
    assert any("No initial map" in text for text, kind in notes() if kind == "failure")
    assert gui.window.scene.paints["advected"].title == "advected: no values"


def test_a_is_matched_to_b_and_its_function_goes_there(pair):
    gui, session = pair, pair.session
    session.editor.change("functions", channels=(Channel(NEAR, FAR),))
    gui.wait(lambda s: not s.obstacle)
    gui.drag("time", 0)
    gui.frames(3)
    # the initial map is seen before anything is matched
    assert_allclose(gui.window.scene.paints["advected"].values, session.values("source"))
    match(gui)
    result, initial = session.result, session.document.initial_map.correspondence
    assert result.mesh is session.surface("target").mesh
    assert initial.a is session.surface("source").mesh
    expected = abfm.register(
        initial.a,
        initial.b,
        session.values("source"),
        session.values("target"),
        initial="connectivity",
        parameters=session.parameters,
    )
    assert_array_equal(result.fine_velocity, expected.match.fine_velocity)
    assert not session.outdated
    gui.drag("time", session.parameters.tau)
    assert_array_equal(gui.window.shown.flow.advected(), result.advected[:, 0])
    session.editor.set_spec("target", NEAR)
    gui.wait(lambda s: s.outdated)
    gui.key("ctrl+z")
    gui.wait(lambda s: not s.outdated)
