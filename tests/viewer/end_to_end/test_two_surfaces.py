"""Tours of two surfaces: opening, the initial map, the match, labels and files."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from abfm.functions import read_labels
from abfm.io import write_labels
from abfm.reading.labels import Labels
from abfm.registration.correspondence import Candidate
from abfm_viewer.automation import Driver
from abfm_viewer.document.document import Channel
from abfm_viewer.document.kinds import PairDocument
from abfm_viewer.files.project import load_project, save_project
from abfm_viewer.panels.right_panel import TABS
from tests.mesh_writers import off_file
from tests.messages import check_message
from tests.shapes import ellipsoid, icosphere
from tests.viewer.end_to_end.test_export import exported
from tests.viewer.sessions import SHORT, SIZE, match

NEAR, FAR = "gaussian:x=1,y=0,z=0,width=0.3", "gaussian:x=0.8,y=0.4,z=0,width=0.3"


@pytest.fixture
def files(tmp_path):
    """Return the files of two bodies with the same connectivity."""
    meshes = {"egg": ellipsoid(2, 1.0, 0.7, 0.55), "ball": icosphere(2, 10.0)}
    return {name: off_file(tmp_path / f"{name}.off", mesh) for name, mesh in meshes.items()}


@pytest.fixture
def gui(files):
    """Open the app with an egg that is registered to a ball, seen without motion."""
    with Driver((files["egg"], files["ball"]), size=(SIZE[0], 600)) as gui:
        gui.window.dialogs.start_in(files["egg"].parent)
        view = replace(gui.session.view, flow_after_match=False)
        gui.session.editor.amend(view=view, parameters=SHORT)
        gui.wait(lambda s: not s.obstacle)
        yield gui
        assert not gui.errors


def test_tour_of_two_surfaces(gui, walk):
    """Two surfaces are opened, mapped and matched, labels of A are transferred, all is saved."""
    walk(gui, close_and_open_b, choose_the_initial_map, match_a_to_b)
    walk(gui, save_and_open, show_and_transfer_labels, drop_both)


def close_and_open_b(gui, files):
    session = gui.session
    egg, source = session.surface("source").mesh, session.active.source
    ball = session.surface().mesh
    assert ball is session.surface("error").mesh is not egg
    assert len(session.values("target")) == len(ball.vertices)
    gui.frames(2)
    titles = {name: paint.title for name, paint in gui.window.scene.paints.items()}
    assert titles == {"source": "source on A", "advected": "advected on B", "target": "target on B"}
    gui.menu("File", "Close second surface")
    gui.wait(lambda s: not isinstance(s.document, PairDocument) and not s.obstacle)
    assert session.surface().mesh is egg
    assert session.active.source == source
    gui.key("ctrl+z")
    assert session.surface().mesh is ball
    gui.key("ctrl+y")
    gui.menu("File", "Open second surface...")
    gui.double_click(files["ball"].name)
    gui.wait(lambda s: isinstance(s.document, PairDocument) and not s.obstacle)
    assert session.surface("source").mesh is egg
    assert session.document.name == "egg.off to ball.off"
    assert session.active.source == source  # the user's settings stay
    assert not session.saves.unsaved


def drop_both(gui, files):
    session, before = gui.session, gui.session.document.identity
    gui.window._dropped([str(files["ball"]), str(files["egg"])])
    gui.wait(lambda s: s.document.identity is not before and isinstance(s.document, PairDocument))
    gui.wait(lambda s: s.document.name == "ball.off to egg.off" and not s.obstacle)
    notes = [entry.text for entry in session.notices.log]
    check_message(next(text for text in notes if "is B" in text), "egg.off", "ball.off")
    gui.window._dropped([str(files["ball"]), str(files["egg"].with_name("none.off"))])
    gui.wait(lambda s: s.notices.latest.is_error)
    assert "none.off" in session.notices.latest.text
    gui.click("Open another second surface...")
    gui.double_click(files["egg"].name, "Open a second surface")
    gui.wait(lambda s: s.document.name == "ball.off to egg.off" and not s.obstacle)


def places_on(gui, surface):
    """Return the places in the window of the vertices of a surface, (V, 2)."""
    return gui.window.scene.projected(surface, gui.session.surface(surface).mesh.vertices)[:, :2]


def choose_the_initial_map(gui, files, notes):
    session, ball = gui.session, files["ball"]
    assert gui.text_of("initial map") == "automatic"
    gui.choose("initial map", "spheres")
    gui.wait(lambda s: "not a sphere" in s.obstacle)
    assert any("No initial map" in text for text, kind in notes() if kind == "failure")
    assert not gui.is_enabled("Match")
    gui.wait(lambda _: gui.window.scene.paints["advected"].title == "advected: no values")
    gui.choose("initial map", "same connectivity")
    gui.wait(lambda s: not s.obstacle)
    gui.choose("colour by", "checker")
    on_b = gui.window.shown.flow.coordinates()
    assert_array_equal(on_b, session.work.prepared.initial.correspondence.points.positions)
    gui.frames(2)
    assert gui.window.scene.paints["advected"].title == "checker of A, on B"
    gui.check("lines from A to B")
    links = gui.window.scene.links()
    assert 3 < len(links) < len(on_b)
    for start, end, _ in links:
        vertex = np.argmin(np.linalg.norm(places_on(gui, "advected") - end, axis=1))
        there = gui.window.scene.projected("source", on_b[vertex])[0, :2]
        assert_allclose(start, there, atol=1.0)
    gui.check("lines from A to B", False)
    for _ in range(4):
        gui.key("ctrl+z")
    assert session.document.initial == "sphere"
    places = gui.session.surface("source").mesh.vertices
    opposite = np.argmax(-places @ places.T, axis=1)  # a map to the mirror image, without tears
    np.savetxt(ball.with_name("map.txt"), opposite, "%d")
    gui.choose("initial map", "map from a file...")
    gui.double_click("map.txt")
    gui.wait(lambda s: not s.obstacle)
    assert_array_equal(session.work.prepared.initial.correspondence.to_vertices(), opposite)
    gui.choose("initial map", "ends of limbs")
    gui.wait(lambda s: "ends of limbs" in s.obstacle)
    gui.choose("initial map", "automatic")
    gui.wait(lambda s: not s.obstacle)
    initial = session.work.prepared.initial.correspondence
    assert initial.to_vertices()[1] == 1
    tips = [w.tip for w in gui.window.ui.widgets if w.label == "initial map"]
    assert "Chosen: connectivity" in tips[0]
    initial.candidates = (Candidate("connectivity", 2.0), Candidate("sphere:mirror", 2.5))
    gui.frames(2)
    gui.click("sphere:mirror, cost 2.50")
    assert session.document.initial == "sphere:mirror"
    gui.frames(2)
    gui.click("connectivity, cost 2.00")
    assert session.document.initial == ""
    gui.wait(lambda s: not s.obstacle)
    assert session.work.prepared.initial.correspondence.to_vertices()[1] == 1
    gui.choose("initial map", "spheres from files...")  # and methods that take some time
    for title in ("Open the sphere of A", "Open the sphere of B"):
        gui.double_click(ball.name, title)
    assert session.document.initial == f"sphere:{ball},{ball}"
    for label, word in (("computed spheres", "embedding"), ("eigenfunctions", "spectral")):
        gui.choose("initial map", label)
        assert session.document.initial == word
    gui.choose("initial map", "landmarks")
    assert session.document.initial == "landmarks"
    gui.choose("initial map", "closest points")
    gui.check("mirrored")
    assert session.document.initial == "closest:mirror"


def match_a_to_b(gui, notes):
    session = gui.session
    session.editor.change("functions", channels=(Channel(NEAR, FAR),))
    gui.wait(lambda s: not s.obstacle)
    gui.drag("time", 0)
    gui.frames(3)
    # the initial map is shown before a match
    assert_allclose(gui.window.scene.paints["advected"].values, session.values("source"))
    match(gui)
    result, initial = session.result, session.document.initial_map.correspondence
    assert result.mesh is session.surface("target").mesh
    assert initial.a is session.surface("source").mesh
    assert result.residual < 0.5 * result.initial_residual
    assert_allclose(result.source[:, 0], session.values("source"))
    assert not session.outdated
    gui.drag("time", session.parameters.tau)
    assert_array_equal(gui.window.shown.flow.advected(), result.advected[:, 0])
    told = replace(session.document.initial_map, notes=("what is worth knowing",))
    session.editor.amend(initial_map=told)
    assert ("What is worth knowing.", "muted") in notes()
    # a point clicked on A is followed on B, from its image by the initial map
    session.editor.set_view("a tool", tool="follow a point")
    gui.pick(3, "source", modifiers=())
    [point] = session.document.points
    mesh = session.surface().mesh
    corner = mesh.faces[point.face][np.argmax(point.barycentric)]
    assert corner == 3
    gui.wait(lambda _: gui.window.shown.quantities.paths())
    [start] = gui.window.shown.quantities.starts(gui.window.shown.quantities.paths())
    on_a = session.surface("source").mesh
    assert_allclose(start, on_a.vertices[on_a.faces[point.face]].T @ point.barycentric, atol=1e-9)
    session.editor.set_spec("target", NEAR)
    gui.wait(lambda s: s.outdated)
    gui.key("ctrl+z")
    gui.wait(lambda s: not s.outdated)


def save_and_open(gui, tmp_path):
    """Save and open a project and a registration."""
    session = gui.session
    session.editor.change("functions", channels=(Channel(NEAR, FAR),), initial="connectivity")
    gui.wait(lambda s: not s.obstacle)
    match(gui)
    saved, known = session.document, session.document.complete_result
    gui.menu("File", "Save project as...")
    gui.type("file name", "pair")
    gui.wait(lambda s: not s.saves.unsaved)
    gui.click("Export")
    exported(gui, "Registration data", tmp_path / "pair.npz")
    gui.click("Match")  # the project does not have this match
    gui.wait(lambda s: s.solver.finished and s.result is not saved.result)
    assert session.saves.has_new_result(session.document)
    exported(gui, "Registration data", tmp_path / "again.npz")
    assert not session.saves.has_new_result(session.document)
    gui.key("ctrl+z")
    for name in ("pair.abfm", "pair.npz"):
        before = session.document.identity
        gui.window.files.open(tmp_path / name)
        gui.wait(lambda s, before=before: s.document.identity is not before and not s.obstacle)
        gui.wait(lambda _: "advected" in gui.window.scene.paints)
        opened = session.document
        assert not session.outdated
        for slot in ("source", "target"):
            meshes = opened.surface(slot).mesh, saved.surface(slot).mesh
            assert_array_equal(*(mesh.vertices for mesh in meshes))
        places = (one.points.positions for one in (session.document.complete_result, known))
        assert_allclose(*places, atol=1e-9)
        again = session.work.prepared.initial.correspondence
        assert_array_equal(again.to_vertices(), known.initial.to_vertices())
        if name == "pair.abfm":
            assert (opened.channels, opened.initial) == (saved.channels, "connectivity")
    assert gui.text_of("initial map", "Functions") == "as opened"


def test_tabs_of_two_surfaces_fit_one_screen(files):
    with Driver((files["egg"], files["ball"]), size=(1280, 800)) as gui:
        gui.session.editor.change(
            "functions", channels=(Channel(*2 * ("gaussian:vertex=5,width=0.3",)),)
        )
        gui.wait(lambda s: not s.obstacle)
        for tab in TABS:
            gui.window.ui.open_tab = tab
            gui.frames(3)
            assert gui.window.ui.hidden_heights[f"/{tab}"] == 0


def show_and_transfer_labels(gui, tmp_path):
    session = gui.session
    on_a = session.surface("source").mesh
    keys = np.where(on_a.vertices[:, 0] > 0, 3, 8)
    write_labels(tmp_path / "halves.label.gii", Labels(keys, {3: "front", 8: "back"}))
    gui.choose("colour by", "labels")
    gui.double_click("halves.label.gii")
    gui.wait(lambda _: gui.window.scene.paints["source"].kind == "colors")
    paints = gui.window.scene.paints
    table = session.document.labels
    assert_array_equal(paints["source"].values, table.linear_colors(keys))
    gui.wait(lambda _: gui.window.scene.paints["advected"].title == "labels of A, on B")
    session.editor.change("functions", channels=(Channel(NEAR, FAR),), initial="connectivity")
    gui.wait(lambda s: not s.obstacle)
    gui.drag("time", 0)
    gui.frames(3)
    gui.wait(lambda _: (paints["advected"].values == table.linear_colors(keys)).all())
    match(gui)
    gui.drag("time", session.parameters.tau)
    expected = session.document.complete_result.transfer_labels(keys)
    shown = table.linear_colors(expected)

    def are_shown():
        paint = gui.window.scene.paints["advected"]
        return paint.kind == "colors" and (paint.values == shown).all(axis=1).mean() > 0.95

    # by the nearest vertex, not by the vertex with the largest weight; they may differ near borders
    gui.wait(lambda _: are_shown())
    gui.click("Export")
    exported(gui, "Transferred labels", tmp_path / "carried.label.gii")
    found = read_labels(tmp_path / "carried.label.gii")
    assert_array_equal(found.values, session.document.complete_result.transfer_labels(keys, "area"))
    assert found.names == {3: "front", 8: "back"}
    save_project(tmp_path / "p.abfm", session.document, {})
    again = load_project(tmp_path / "p.abfm")[0]
    assert again.labels.names == table.names
    assert_array_equal(again.labels.values, table.values)
    (tmp_path / "few.label.gii").write_bytes(b"none")
    gui.click("Look")
    gui.click("Open labels...")
    gui.double_click("few.label.gii")
    assert session.document.labels is table
    assert "few.label.gii" in session.notices.log[-1].text
