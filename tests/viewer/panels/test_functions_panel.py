import numpy as np
import pytest

from abfm_viewer.document.document import Channel
from abfm_viewer.document.gaussians import gaussians
from abfm_viewer.session import active_gaussian
from tests.messages import check_message
from tests.viewer.sessions import EGG, opened

THREE_GAUSSIANS = "gaussian:vertex=1 + gaussian:vertex=2 + gaussian:vertex=3"


# In the session


@pytest.fixture
def session():
    session = opened(
        channel=Channel(THREE_GAUSSIANS, "gaussian:vertex=4 + coordinate:x + gaussian:vertex=5")
    )
    yield session
    session.close()


def vertices(session, side):
    return [gaussian.vertex[0] for gaussian in gaussians(session.active.spec(side))]


def active(session):
    return session.document.side, session.document.bump


def test_active_gaussian_moves_and_stays_active(session):
    session.editor.select(side="source", bump=2)
    active_gaussian.move(session, "source", 9, "drag")
    assert vertices(session, "source") == [1, 2, 9]
    assert active(session) == ("source", 2)
    for vertex in (7, 8, 9):  # the other side's active Gaussian is always its first one
        active_gaussian.move(session, "target", vertex, "drag")
    assert vertices(session, "target") == [9, 5]
    assert active(session) == ("target", 0)
    session.undo()
    assert vertices(session, "target") == [4, 5]
    assert active(session) == ("source", 2)
    active_gaussian.move(session, "target", 4, "drag")  # to its present place
    assert session.document.side == "target"
    session.editor.select(side="source", bump=2)
    session.editor.set_spec("target", THREE_GAUSSIANS)
    assert session.document.bump == 0
    session.editor.set_spec("target", "gaussian:vertex=1 + gaussian:vertex=2", bump=1)
    assert session.document.bump == 1


def test_wheel_changes_the_width_within_limits(session):
    session.editor.select(side="source", bump=1)
    for turns, width in (
        (1, pytest.approx(0.112, abs=5e-4)),
        (1000, active_gaussian.WIDTH_MAX),
        (-1000, active_gaussian.WIDTH_MIN),
    ):
        active_gaussian.widen(session, "source", turns, "wheel")
        widths = [gaussian.width for gaussian in gaussians(session.active.source)]
        assert widths == [0.1, width, 0.1]
    session.undo()
    assert session.active.source == THREE_GAUSSIANS
    assert active_gaussian.obstacle_to_move(session, "source") == ""
    session.editor.set_spec("source", "coordinate:x")
    check_message(active_gaussian.obstacle_to_move(session, "source"))
    active_gaussian.widen(session, "source", 1, "wheel")
    check_message(session.notices.latest.text)
    session.editor.set_spec("source", "permuted:map.txt(gaussian:vertex=1)")
    check_message(active_gaussian.obstacle_to_move(session, "source"))
    active_gaussian.widen(session, "source", 1, "wheel")
    assert session.active.source == "permuted:map.txt(gaussian:vertex=1,width=0.112)"


# In the panel


def refusals(gui):
    return list(gui.window.ui.refusals.reasons.values())


def spec(gui, side="source"):
    return gui.session.active.spec(side)


def test_tour_of_function_texts(gui, walk):
    """Families are chosen as text and by widgets, which change the spec."""
    walk(gui, reach_families_from_a_gaussian, change_texts_by_widgets)


def test_tour_of_the_mouse_on_surfaces(gui, walk):
    walk(gui, drag_a_gaussian, turn_the_wheel_twice, place_points)


def reach_families_from_a_gaussian(gui):
    gui.click("Add Gaussian", within="target")
    assert active(gui.session) == ("target", 1)
    gui.click("Remove Gaussian", within="target")
    assert gui.session.document.bump == 0
    gui.type("spec", "gaussian:vertex=4242", within="target")
    gui.wait(lambda s: s.work.error("target"))
    gui.click("Add Gaussian", within="target")
    check_message(next(reason for reason in refusals(gui) if "4242" in reason))
    gui.choose("family", "geodesic", within="target")
    assert spec(gui, "target").startswith("geodesic:vertex=")
    gui.wait(lambda s: not s.obstacle)
    gui.type("spec", "gaussian:vertex=12", within="target")
    gui.choose("family", "indicator", within="target")
    assert spec(gui, "target") == "indicator:vertex=12,radius=0.2"
    gui.choose("family", "coordinate", within="target")
    gui.wait(lambda s: not s.obstacle)
    gui.choose("family", "gaussian", within="target")
    highest = int(np.argmax(EGG.vertices[:, 1]))
    assert gaussians(spec(gui, "target"))[0].vertex == (highest,)


def change_texts_by_widgets(gui, tmp_path):
    """Change functions by widgets, whose labels differ for channels of the same kind."""
    gui.type("spec", "gaussian:vertex=3 + coordinate:x + gaussian:vertex=5", within="source")
    assert gui.text_of("family", within="source") == "several terms"
    gui.click("bump 2", within="source")
    gui.type("width", "0.3", within="source")
    assert spec(gui) == "gaussian:vertex=3 + coordinate:x + gaussian:vertex=5,width=0.3"
    gui.click("bump 1", within="source")
    gui.click("Remove Gaussian", within="source")
    assert spec(gui) == "coordinate:x + gaussian:vertex=5,width=0.3"
    gui.type("spec", "gaussian:x=1,y=0,z=0", within="source")  # the error stays until this text
    gui.drag("height", -1, within="source")
    gui.type("y", "0.25", within="source")
    gaussian = gaussians(spec(gui))[0]
    assert (gaussian.x, gaussian.y, gaussian.z, gaussian.vertex) == (1, 0.25, 0, None)
    gui.type("vertex", "3,4", within="source")
    assert gaussians(spec(gui))[0].vertex == (3, 4)
    assert "y" not in gui.labels()
    gui.choose("family", "wks", within="source")
    gui.type("width", "0.5", within="source")
    assert spec(gui) == "wks:width=0.5"
    gui.drag("width", 0.8, within="source")
    gui.type("spec", "wks", within="source")  # without an error again
    gui.type("width", "nothing", within="source")
    assert spec(gui) == "wks"
    check_message(next(reason for reason in refusals(gui) if "width" in reason), "nothing")
    gui.type("spec", "permuted:mirror(permuted:mirror(coordinate:x))", within="source")
    assert gui.text_of("family", within="source") == "coordinate"
    gui.choose("axis", "y", within="source")
    assert spec(gui) == "permuted:mirror(permuted:mirror(coordinate:y))"
    assert "Browse..." not in gui.labels()
    gui.choose("family", "geodesic", within="source")
    assert spec(gui).startswith("permuted:mirror(geodesic:vertex=")
    np.save(tmp_path / "values.npy", EGG.vertices[:, 0])
    gui.choose("family", "file", within="source")
    gui.double_click("values.npy")
    assert spec(gui).startswith("permuted:mirror(file:")
    channels = (
        Channel("coordinate:x", "permuted:mirror(coordinate:x)"),
        Channel("expression:x*x+y*y+z*z+x*y*z*x", "gaussian:vertex=1 + gaussian:vertex=2"),
        Channel("eigenfunction:7", "geodesic:vertex=3", 2),
    )
    gui.session.editor.change("three channels", channels=channels)
    assert [label for label in gui.labels() if label[1:3] == ": "] == [
        "1: coordinate x to coordinate x, mirror",
        "2: x*x+y*y+z*z+x... to 2 gaussians",
        "3: eigenfunction 7 to geodesic, weight 2",
    ]


# Under the mouse


def neighbours(vertex):
    return [int(v) for v in np.unique(EGG.faces[(EGG.faces == vertex).any(axis=1)]) if v != vertex]


def front(gui):
    """Return a vertex in the middle of the view."""
    return int(np.argmax(EGG.vertices @ np.array(gui.session.surface().front.direction)))


def drag_a_gaussian(gui):
    session, scene, vertex = gui.session, gui.window.scene, front(gui)
    before, viewpoint, moved = session.channels, scene.viewpoint, session.editor.action_count
    path = [vertex, *neighbours(vertex)[:2]]
    gui.drag_on_surface(path, surface="target")
    assert gaussians(spec(gui, "target"))[0].vertex == (path[-1],)
    assert session.document.side == "target"
    assert session.editor.action_count - moved >= 3
    assert scene.viewpoint == viewpoint
    gui.key("ctrl+z")
    assert session.channels == before
    assert not session.editor.undo_label
    gui.drag_on_surface(path, surface="target", modifiers=())
    assert session.channels == before
    assert (
        np.linalg.norm(np.subtract(scene.viewpoint.front.direction, viewpoint.front.direction))
        > 1e-3
    )
    gui.click("Open mesh...", within="Functions")
    gui.pick(vertex, surface="target")  # a dialog in front of the surface takes the clicks
    assert session.channels == before
    gui.key("escape")
    gui.choose("family", "coordinate", within="target")
    before = session.channels
    for surface, expected in (
        ("target", "choose the family gaussian"),
        ("advected", "Shift-click on the source or"),
    ):
        gui.pick(vertex, surface=surface)
        assert expected in session.notices.latest.text
    assert session.channels == before


def turn_the_wheel_twice(gui, monkeypatch):
    def width():
        return gaussians(spec(gui, "target"))[0].width

    now, vertex = [100.0], front(gui)
    monkeypatch.setattr("abfm_viewer.window.mouse.time.perf_counter", lambda: now[0])
    viewpoint, before = gui.window.scene.viewpoint, width()
    gui.wheel(1, vertex, surface="target")
    gui.wheel(1, vertex, surface="target")
    now[0] += 10
    gui.frames(2)
    gui.wheel(-1, vertex, surface="target")
    assert width() == pytest.approx(1.12 * before, rel=0.01)
    assert gui.window.scene.viewpoint == viewpoint
    gui.session.undo()
    assert width() == pytest.approx(1.25 * before, rel=0.01)
    gui.session.undo()
    assert width() == before


def place_points(gui):
    session, vertex = gui.session, front(gui)

    def placed():
        return len(session.document.lines), len(session.document.points)

    gui.pick(vertex, surface="target", modifiers=())
    assert placed() == (0, 0)
    session.editor.set_view("tool", tool="flow line")
    gui.pick(vertex, surface="advected", modifiers=())
    session.editor.set_view("tool", tool="follow a point")
    gui.pick(vertex, surface="source", modifiers=())
    assert placed() == (1, 1)
    (point,) = session.document.points
    position = np.array(point.barycentric) @ EGG.vertices[EGG.faces[point.face]]
    np.testing.assert_allclose(position, EGG.vertices[vertex], atol=0.02)
    gui.drag_on_surface([vertex, *neighbours(vertex)[:3:2]], surface="advected", modifiers=())
    gui.pick(vertex, surface="source")
    assert placed() == (1, 1)
    gui.key("r")
    gui.input.move(*gui.place(vertex, "advected"))
    gui.input.click(2)  # a double click enlarges the surface
    assert placed() == (1, 2)
    assert gui.window.scene.shown == ("advected",)
