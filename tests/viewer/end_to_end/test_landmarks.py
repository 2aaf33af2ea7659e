from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from abfm.functions import vertex_normals
from abfm_viewer.automation import Driver
from abfm_viewer.document.kinds import PairDocument
from abfm_viewer.document.surface_points import surface_points
from tests.mesh_writers import off_file
from tests.messages import check_message
from tests.shapes import ellipsoid, icosphere
from tests.viewer.sessions import QUICK, SIZE, match

EGG, BALL = ellipsoid(3, 1.0, 0.7, 0.55), icosphere(3, 10.0)


@contextmanager
def opened(files):
    """Open the app on one or two surfaces, seen without motion."""
    with Driver(files, size=(SIZE[0], 560)) as gui:
        gui.session.editor.amend(view=replace(gui.session.view, flow_after_match=False))
        gui.wait(lambda s: not s.obstacle)
        yield gui
        assert not gui.errors


@pytest.fixture
def gui(tmp_path):
    files = [off_file(tmp_path / f"{n}.off", mesh) for n, mesh in (("egg", EGG), ("ball", BALL))]
    with opened(tuple(files)) as gui:
        gui.window.dialogs.start_in(tmp_path)
        yield gui


def place(gui, count=4):
    """Place landmarks on visible vertices, and return these, (L,) of each surface."""
    chosen = []
    for side in ("source", "target"):
        mesh, towards = gui.session.surface(side).mesh, gui.window.scene.view_of(side).rotation[2]
        seen = np.flatnonzero(vertex_normals(mesh) @ towards > 0.6)
        chosen.append(seen[np.linspace(0, len(seen) - 1, count).astype(int)])
    gui.click("Place landmarks")
    for on_a, on_b in zip(*chosen, strict=True):
        gui.pick(int(on_a), "source", modifiers=())
        gui.pick(int(on_b), "target", modifiers=())
    gui.click("Stop placing")
    return chosen


def positions(gui, side):
    points = [one.point(side) for one in gui.session.document.landmarks]
    return surface_points(gui.session.surface(side).mesh, points).positions


def distances(gui, side, vertices):
    """Return the distances of landmarks from vertices, in edges."""
    mesh = gui.session.surface(side).mesh
    edge = np.linalg.norm(np.diff(mesh.vertices[mesh.edges], axis=1), axis=2).mean()
    return np.linalg.norm(positions(gui, side) - mesh.vertices[list(vertices)], axis=1) / edge


def test_tour_of_landmarks_on_two_surfaces(gui, walk):
    """Landmarks are placed, moved, paired, matched, saved and removed on two surfaces."""
    walk(gui, place_drag_and_remove, complete_half_a_pair, remove_during_a_drag)
    walk(gui, zoom_over_a_landmark, close_the_second_surface, save_and_open_files)
    walk(gui, match_landmarks_alone)


def test_tour_of_landmarks_on_one_surface(tmp_path):
    """Landmarks are matched with functions on one surface, and alone until there is a channel."""
    with opened(off_file(tmp_path / "ball.off", BALL)) as gui:
        session = gui.session
        gui.click("Place landmarks")
        gui.pick(12, "source", modifiers=())
        gui.pick(30, "target", modifiers=())
        gui.wait(lambda s: not s.obstacle)
        session.editor.amend(parameters=QUICK)
        match(gui)
        assert session.result.landmark_errors.shape == (1,)
        assert not session.result.problem.is_of_landmarks
        assert not session.outdated
        gui.key("delete")
        gui.frames(2)
        assert session.outdated
        gui.key("ctrl+z")
        gui.frames(2)
        assert not session.outdated
        gui.check("landmarks alone")
        gui.wait(lambda s: s.outdated and not s.obstacle)
        match(gui)
        assert not session.outdated
        gui.click("Add channel")
        gui.wait(lambda s: s.outdated)


def place_drag_and_remove(gui):
    session = gui.session
    assert not gui.window.scene.landmarks()
    sources, targets = place(gui)
    assert distances(gui, "source", sources).max() < 0.3
    assert distances(gui, "target", targets).max() < 0.3
    assert [gui.text_of(f"{n + 1}: placed") for n in range(4)] == [*3 * [""], "chosen"]
    gui.frames(2)
    # discs on both surfaces and at the moved points, rings at the goals
    landmarks = gui.window.scene.landmarks()
    assert {(each.surface, each.side, each.is_goal) for each in landmarks} == {
        ("source", "source", False),
        ("target", "target", False),
        ("advected", "target", True),
        ("advected", None, False),
    }
    before = session.document.landmarks
    around = np.argsort(np.linalg.norm(EGG.vertices - EGG.vertices[sources[1]], axis=1))
    gui.drag_on_surface(around[[0, 2, 9]].tolist(), "source", modifiers=())
    sources[1] = around[9]
    moved = session.document.landmarks
    assert moved[1].source != before[1].source
    assert [one for n, one in enumerate(moved) if n != 1] == [
        one for n, one in enumerate(before) if n != 1
    ]
    assert distances(gui, "source", sources).max() < 0.5
    assert session.document.landmark == 1
    gui.key("ctrl+z")
    assert session.document.landmarks == before
    gui.key("ctrl+y")
    gui.click("2: placed")
    gui.key("delete")
    assert session.document.landmarks == (moved[0], *moved[2:])
    gui.click("Clear landmarks")
    assert session.document.landmarks == ()
    for _ in range(2):
        gui.key("ctrl+z")
    assert session.document.landmarks == moved


def complete_half_a_pair(gui, notes):
    """Check that an incomplete landmark has a note and is not matched."""
    session = gui.session
    gui.menu("Edit", "Place landmarks")
    assert session.view.tool == "landmark"
    gui.click("nothing", within="Look")
    gui.click("landmark", within="Look")
    gui.window.ui.open_tab = "Functions"
    gui.frames(2)
    assert ("Click on A, then on B.", "muted") in notes()
    gui.pick(30, "source", modifiers=())
    gui.pick(60, "source", modifiers=())
    assert gui.text_of("1: not yet placed on B, so not used") == ""
    assert session.work.problem.landmarks == ()
    gui.pick(31, "advected", modifiers=())  # B is also shown
    assert len(session.work.problem.landmarks) == 1
    assert gui.text_of("2: not yet placed on B, so not used") == ""
    gui.input.move(3, 60)
    gui.input.click()
    gui.frames(1)
    check_message(session.notices.latest.text)
    assert len(session.document.landmarks) == 2
    gui.key("m")
    assert session.view.tool == "nothing"


def match_landmarks_alone(gui, tmp_path):
    """Match landmarks without functions, and save and open them again."""
    session = gui.session
    sources, targets = place(gui)
    gui.check("landmarks alone")
    gui.wait(lambda s: not s.obstacle)
    match(gui)
    result = session.result
    assert result.problem.is_of_landmarks
    assert result.verdict.kind == "matched"
    assert result.landmark_errors.max() < 0.005
    rows = [label for label in gui.labels() if label.endswith("away")]
    assert len(rows) == 4
    # the functions are also advected
    gui.drag("time", session.parameters.tau)
    assert_allclose(gui.window.shown.flow.advected(), result.advected[:, 0])
    assert np.ptp(result.advected) > 0.5

    def farthest():
        offsets = gui.window.shown.landmarks.moved().places - positions(gui, "target")
        return np.linalg.norm(offsets, axis=1).max() / BALL.length_scale

    gui.wait(lambda _: farthest() < 0.006)
    gui.drag("time", 0)
    gui.wait(lambda _: farthest() > 0.05)
    assert not session.outdated
    known, document = session.document.complete_result, session.document
    gui.menu("File", "Save project as...")
    gui.type("file name", "pair")
    gui.wait(lambda s: not s.saves.unsaved)
    known.save(tmp_path / "pair.npz")
    for name in ("pair.abfm", "pair.npz"):
        before = session.document.identity
        gui.window.files.open(tmp_path / name)
        gui.wait(lambda s, before=before: s.document.identity is not before and not s.obstacle)
        opened = session.document
        assert opened.landmarks_alone
        assert not session.outdated
        assert_allclose(session.result.landmark_errors, result.landmark_errors, atol=1e-9)
        if name == "pair.abfm":
            assert opened.landmarks == document.landmarks
        assert distances(gui, "source", sources).max() < 0.5
        assert distances(gui, "target", targets).max() < 0.5


def save_and_open_files(gui, tmp_path):
    session = gui.session
    place(gui, 2)
    before = session.document.landmarks
    gui.click("Save landmarks...")
    gui.type("file name", "marks")
    gui.click("Clear landmarks")
    gui.menu("File", "Open landmarks...")
    gui.double_click("marks.csv")
    again = session.document.landmarks
    assert len(again) == 2
    for side in ("source", "target"):
        mesh = session.surface(side).mesh
        pairs = [[one.point(side) for one in some] for some in (before, again)]
        assert_allclose(*(surface_points(mesh, points).positions for points in pairs), atol=1e-9)
    (tmp_path / "wrong.csv").write_text("1,2\n3,x\n")
    gui.click("Open landmarks...", within="Functions")
    gui.double_click("wrong.csv")
    assert session.document.landmarks == again
    check_message(session.notices.log[-1].text, 2)


def close_the_second_surface(gui):
    """Close B: landmarks are unsaved work, and A keeps its points."""
    session = gui.session
    assert not session.saves.unsaved
    place(gui, 2)
    assert session.saves.unsaved
    sources = [one.source for one in session.document.landmarks]
    gui.menu("File", "Close second surface")
    gui.wait(lambda s: not isinstance(s.document, PairDocument))
    assert [(one.source, one.target) for one in session.document.landmarks] == [
        (source, None) for source in sources
    ]


def remove_during_a_drag(gui):
    session = gui.session
    place(gui, 2)
    _, second = session.document.landmarks
    landmark = next(one for one in gui.window.scene.landmarks() if one.number == 0 and one.side)
    gui.input.move(*landmark.place)
    gui.input.press()
    gui.frames(1)
    session.editor.remove_landmark()
    gui.input.move(landmark.place[0] + 20, landmark.place[1] + 10)
    gui.input.release()
    gui.frames(2)
    assert session.document.landmarks == (second,)


def zoom_over_a_landmark(gui):
    place(gui, 2)
    gui.frames(2)
    landmark = next(one for one in gui.window.scene.landmarks() if one.side)
    gui.input.move(*landmark.place)
    gui.input.wheel(2)
    gui.frames(2)
    assert gui.session.view.viewpoint.zoom > 1
