"""Slots, which fill their part of the window in any layout, and their views."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from abfm import load_mesh
from abfm.assets import asset_path
from abfm.pages.front import Front, triple
from abfm_viewer.document.document import LAYOUTS, Viewpoint
from abfm_viewer.scene import opengl
from abfm_viewer.scene.opengl import ps
from abfm_viewer.scene.scene import Scene
from abfm_viewer.scene.slots import Fit, fitting, slots
from abfm_viewer.session.session import Session
from abfm_viewer.shown.shown import Shown
from abfm_viewer.window.window import areas
from tests.shapes import ellipsoid

POINTS = ellipsoid(3, 1.0, 0.7, 0.4).vertices + np.array([0.3, -0.2, 0.1])
POINTS = POINTS[POINTS[:, 0] + POINTS[:, 1] < 0.6]  # without a symmetry
FRONT = Front((0.0, 0.0, 1.0), (0.0, 1.0, 0.0))
NAMES = ("source", "advected", "target")
PLACES = slots(NAMES, (0, 0, 900, 500), (2.0, 1.4), "row", 20.0)
WINDOW = (1280, 800)
in_slot = st.tuples(st.floats(310, 590), st.floats(30, 490))


def slots_of(count, rect, shape=(1.0, 1.0), layout="automatic", name_height=20.0):
    return slots("abcdef"[:count], rect, shape, layout, name_height)


@given(
    count=st.integers(1, 6),
    width=st.floats(60, 3000),
    height=st.floats(60, 3000),
    shape=st.tuples(st.floats(0.1, 10), st.floats(0.1, 10)),
    layout=st.sampled_from(["automatic", "row", "column", "advected only"]),
)
def test_slots_have_one_size_and_do_not_overlap(count, width, height, shape, layout):
    rect = (10.0, 30.0, 10 + width, 30 + height)
    found = list(slots_of(count, rect, shape, layout).values())
    whole = np.array([(*slot.name[:2], *slot.rect[2:]) for slot in found])  # including their names
    assert (whole[:, :2] >= np.array(rect[:2]) - 1e-6).all()
    assert (whole[:, 2:] <= np.array(rect[2:]) + 1e-6).all()
    for slot in found:
        assert slot.half == pytest.approx(found[0].half)
        assert min(slot.half) > 0
    for one, other in combinations(whole, 2):
        across = min(one[2], other[2]) - max(one[0], other[0])
        down = min(one[3], other[3]) - max(one[1], other[1])
        assert min(across, down) <= 1e-6


def test_low_slot_has_its_name_at_the_left():
    given = {"layout": "column", "name_height": 40.0}
    low, high = (slots_of(3, (0, 0, 600, height), **given) for height in (240, 900))
    for slot in low.values():
        assert slot.rect[1] == slot.name[1]
        assert slot.rect[3] - slot.rect[1] == 80
        assert slot.name[0] == 0 < slot.name[2] == slot.rect[0]
    for slot in high.values():
        assert slot.name[3] == slot.rect[1]


@pytest.mark.parametrize(
    ("size", "layout", "columns"),
    [
        ((900, 600), "automatic", 3),
        ((600, 900), "automatic", 2),
        ((3000, 300), "automatic", 6),
        ((300, 3000), "automatic", 1),
        ((900, 600), "row", 6),
        ((900, 600), "column", 1),
    ],
)
def test_six_surfaces_are_in_rows_by_shape_or_layout(size, layout, columns):
    found = slots_of(6, (0, 0, *size), layout=layout).values()
    assert len({slot.rect[0] for slot in found}) == columns
    filled = [(slot.rect[2] - slot.name[0]) * (slot.rect[3] - slot.name[1]) for slot in found]
    assert sum(filled) == pytest.approx(size[0] * size[1])
    five = slots_of(5, (0, 0, 900, 600)).values()  # a shorter last row is centred
    assert [slot.rect[0] for slot in five] == pytest.approx([0, 300, 600, 150, 450])


@pytest.mark.parametrize("shape", [(1.0, 1.0), (0.45, 1.0), (3.0, 1.0)])
@pytest.mark.parametrize("count", [2, 3, 4, 5, 6])
@pytest.mark.parametrize("size", [(620, 480), (900, 600), (1780, 1260), (500, 900)])
def test_automatic_layout_makes_surfaces_large(shape, count, size):
    automatic, row, column = (
        fitting(slots_of(count, (0, 0, *size), shape, layout)["a"].half, shape)
        for layout in ("automatic", "row", "column")
    )
    assert automatic > 0.8 * max(row, column)


def front(rotation):
    return Front(triple(rotation[2]), triple(rotation[1]))


def view(zoom=1.0, target=None, rotation=None, places=PLACES):
    seen_from = FRONT if rotation is None else front(rotation)
    return Fit(POINTS, FRONT).view(places, seen_from, zoom, target)


def rotations(count):
    return Rotation.random(count, np.random.default_rng(count)).as_matrix()


def next_view(seen):
    """Return the view that the mouse has requested, in the next frame."""
    return view(seen.zoom, seen.target, seen.rotation)


def point_at(seen, name, place):
    """Return the point of a surface at a place, at the depth of the surface's middle."""
    middle = seen.slots[name].middle
    x, y = (place[0] - middle[0]) / seen.scale, (middle[1] - place[1]) / seen.scale
    return seen.target + np.array([x, y, 0.0]) @ seen.rotation


def test_surface_fits_the_middle_of_its_slot_from_every_side():
    for rotation in rotations(100):
        seen = view(rotation=rotation)
        for name, slot in PLACES.items():
            x, y, _ = seen.projected(name, POINTS).T
            left, top, right, bottom = slot.rect
            assert left < x.min() <= x.max() < right
            assert top < y.min() <= y.max() < bottom
            middle = (x.min() + x.max()) / 2, (y.min() + y.max()) / 2
            assert middle == pytest.approx(slot.middle)
    x, y, _ = view().projected("source", POINTS).T
    half = PLACES["source"].half
    assert max(np.ptp(x) / (2 * half[0]), np.ptp(y) / (2 * half[1])) == pytest.approx(1)


def test_matrix_agrees_with_projection():
    seen = view(1.7, np.array([0.5, 0.1, 0]), Rotation.from_rotvec([0.3, 1, 0.2]).as_matrix())
    places = [seen.projected(name, POINTS) - [*PLACES[name].middle, 0] for name in NAMES]
    np.testing.assert_allclose(places[1:], [places[0]] * 2, atol=1e-9)
    matrix = seen.matrix("advected", WINDOW, seen.scale)
    there = POINTS @ matrix[:3, :3].T + matrix[:3, 3]
    x, y, depth = seen.projected("advected", POINTS).T
    np.testing.assert_allclose(seen.scale * there[:, 0] + WINDOW[0] / 2, x)
    np.testing.assert_allclose(WINDOW[1] / 2 - seen.scale * there[:, 1], y)
    np.testing.assert_allclose(there[:, 2], -depth)


@pytest.mark.parametrize("zoom", [1.0, 2.5])
def test_transferred_view_is_relative_to_the_front(zoom):
    axes = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix()
    others = 30 * POINTS @ axes.T + np.array([5.0, 1.0, -2.0])
    front = Front(triple(axes[:, 2]), triple(axes[:, 1]))
    seen = view(zoom, np.array([0.5, 0.1, 0]), Rotation.from_rotvec([0.3, 1, 0.2]).as_matrix())
    other = seen.transferred(FRONT, Fit(others, front), front)
    places = seen.projected("source", POINTS), other.projected("source", others)
    np.testing.assert_allclose(places[1][:, :2], places[0][:, :2], atol=1e-6)
    matrix = other.matrix("source", WINDOW, seen.scale)  # as seen by the other camera
    there = others @ matrix[:3, :3].T + matrix[:3, 3]
    np.testing.assert_allclose(seen.scale * there[:, 0] + WINDOW[0] / 2, places[0][:, 0])


@given(place=in_slot, factor=st.floats(1.0, 8.0))
def test_zoom_in_keeps_the_point_under_the_mouse(place, factor):
    seen = view(1.3, np.array([0.1, 0, 0.05]))
    nearer = next_view(seen.zoomed("advected", place, factor))
    point = point_at(seen, "advected", place)
    np.testing.assert_allclose(nearer.projected("advected", point)[0, :2], place)


@given(place=in_slot, factor=st.floats(1.1, 8.0))
def test_zoom_out_reverses_zoom_in(place, factor):
    seen = view()
    nearer = next_view(seen.zoomed("advected", place, factor))
    half_way = next_view(nearer.zoomed("advected", (0, 0), 0.97))
    point = point_at(nearer, "advected", place)
    np.testing.assert_allclose(half_way.projected("advected", point)[0, :2], place, atol=1e-6)
    back = nearer.zoomed("source", (0, 0), 1 / factor)
    assert back.zoom == pytest.approx(1)
    np.testing.assert_allclose(back.target, seen.centre, atol=1e-9)


@given(delta=st.tuples(st.floats(-60, 60), st.floats(-60, 60)))
def test_surfaces_move_with_the_mouse(delta):
    seen = view(2.0)
    after = next_view(seen.moved(delta))
    moved = after.projected("target", POINTS) - seen.projected("target", POINTS)
    np.testing.assert_allclose(moved, np.broadcast_to([*delta, 0], moved.shape), atol=1e-9)


def test_nearest_slot_is_under_the_mouse():
    seen = view()
    assert seen.slot_at((450, 5)) == "advected"
    assert seen.slot_at((-20, 900)) == "source"
    assert seen.slot_at((890, 250)) == "target"
    for _ in range(50):
        seen = next_view(seen.moved((500.0, -300.0)))
    assert np.linalg.norm(seen.target - seen.centre) <= seen.radius * (1 + 1e-9)


@given(start=in_slot, end=in_slot)
def test_ball_turns_with_the_mouse(start, end):
    seen = view()
    rotation = seen.turned("advected", start, end).rotation
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)
    first, last = (seen._on_ball("advected", place) for place in (start, end))
    np.testing.assert_allclose(rotation @ seen.rotation.T @ first, last, atol=1e-9)
    assert seen.turned("source", start, start) is seen


@given(
    deltas=st.lists(st.tuples(st.floats(-400, 400), st.floats(-400, 400)), max_size=5),
    zoom=st.floats(0.5, 8.0),
)
def test_turntable_stays_upright(deltas, zoom):
    seen = view(zoom)
    for delta in deltas:
        seen = next_view(seen.orbited(delta))
        across, up, _ = seen.rotation @ seen.upright
        assert abs(across) < 1e-9
        assert up > -1e-9
        np.testing.assert_allclose(seen.rotation @ seen.rotation.T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize("delta", [(9.0, 0.0), (0.0, 9.0), (-9.0, 0.0), (0.0, -9.0)])
def test_front_of_turntable_follows_the_drag(delta):
    seen = view()
    point = seen.target + 0.1 * seen.rotation[2]
    after = next_view(seen.orbited(delta)).projected("source", point)
    moved = (after - seen.projected("source", point))[0, :2]
    assert moved @ delta > 0.99 * np.linalg.norm(moved) * 9


@pytest.mark.parametrize("zoom", [0.3, 1.0, 5.0])
def test_names_are_close_above_their_surfaces(zoom):
    for rotation in rotations(20):
        seen = view(zoom=zoom, rotation=rotation)
        for name, slot in PLACES.items():
            left, top, right, bottom = seen.label(name)
            highest = float(seen.projected(name, POINTS)[:, 1].min())
            assert (left, right, bottom - top) == (*slot.name[::2], slot.name[3] - slot.name[1])
            assert bottom == pytest.approx(max(highest, slot.rect[1]))


@pytest.mark.parametrize("away", [-5e3, 5e3])
def test_name_stays_in_its_slot(away):
    gone = view(zoom=0.5, target=view(zoom=0.5).target + np.array([0.0, away, 0.0]))
    for name, slot in PLACES.items():
        _, top, _, bottom = gone.label(name)
        assert slot.name[1] <= top < bottom <= slot.rect[3]


def test_name_at_the_left_ends_at_its_surface():
    """A name at the left ends where the widest view of its surface begins, in its slot."""
    low = slots(NAMES, (0, 0, 900, 150), (2.0, 1.4), "column", 20.0)
    seen = view(9.0, places=low)
    assert seen.has_names_at_left
    assert all(seen.label(name) == slot.name for name, slot in low.items())
    low = slots(NAMES, (0, 0, 2000, 150), (2.0, 1.4), "column", 20.0)
    for rotation in rotations(20):
        turned = view(rotation=rotation, places=low)
        for name, slot in low.items():
            begins = slot.middle[0] - turned.scale * turned.radius
            left, top, right, bottom = turned.label(name)
            assert (left, top, bottom) == (slot.name[0], slot.name[1], slot.name[3])
            assert right == pytest.approx(begins)
            assert turned.projected(name, POINTS)[:, 0].min() >= begins - 1e-9


def test_borders_are_only_between_clipped_surfaces():
    assert view().borders() == view(zoom=0.5).borders() == []
    upright = [((x, 0.0), (x, 500.0)) for x in (300.0, 600.0)]
    assert view(zoom=2.0).borders() == upright
    five = slots("abcde", (0, 0, 900, 600), (1.0, 1.0), "automatic", 20.0)
    lines = view(2.0, places=five).borders()
    across = [(start, end) for start, end in lines if start[1] == end[1]]
    assert across == [((0.0, 300.0), (900.0, 300.0))]
    down = sorted(start[0] for start, end in lines if start[0] == end[0])
    assert down == [150, 300, 450, 600, 750]
    assert view(2.0, places={"a": five["a"]}).borders() == []


def test_fit_does_not_depend_on_earlier_views():
    fit, sides = Fit(POINTS, FRONT), [front(rotation) for rotation in rotations(3)]
    for side in (sides[0], sides[1], sides[1], FRONT, sides[2], sides[0]):
        fits = fit, Fit(POINTS, FRONT)
        seen, alone = (one.view(PLACES, side, 1.0, None) for one in fits)
        assert (seen.scale, seen.above) == (alone.scale, alone.above)
        np.testing.assert_array_equal(seen.rotation, side.axes)


MENU, NAME, BARS = 20.0, 24.0, 56.0  # heights at a scale of 1, close to those of the window
SMALLER = 8  # smaller pictures, because the time of drawing depends on the pixels


@pytest.fixture
def scene():
    opengl.start(opengl.OFFSCREEN_BACKEND, 64, 64)
    session = Session(load_mesh(asset_path("human_A.off")), "body", at_once=True)
    session.editor.amend(surfaces=(replace(session.surface(), front=FRONT),))
    shown = Shown(session)
    yield Scene(shown)
    opengl.clear()
    shown.close()
    session.close()


@pytest.mark.parametrize("scale", [1.0, 2.0])
@pytest.mark.parametrize("size", [(1000, 700), (1280, 800), (2560, 1440)])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_surfaces_are_drawn_inside_their_slots(scene, layout, size, scale):
    session, six = scene._session, layout == "automatic"
    view = replace(session.view, layout=layout, blend=six, transport=six, error=six, viewpoint=None)
    session.editor.amend(view=view)
    rect = tuple(end / SMALLER for end in areas(size, MENU * scale, scale).scene)
    scene.name_height, scene.bars_height = NAME * scale / SMALLER, BARS * scale / SMALLER
    ps.set_window_size(*(length // SMALLER for length in size))
    for rotation in rotations(12):
        session.editor.amend(view=replace(view, viewpoint=Viewpoint(front(rotation))))
        scene.update(rect)
        pixels = ps.screenshot_to_buffer(transparent_bg=False)[..., :3].astype(int)
        drawn = np.abs(pixels - pixels[0, 0]).max(axis=-1) > 3
        for slot in scene.view.slots.values():
            left, top, right, bottom = np.round(slot.rect).astype(int)
            inside = drawn[top:bottom, left:right]
            assert inside.any()
            inside[:] = False
        assert not drawn.any()
    end = rect[3] - scene.bars_height + 1e-6
    for slot in scene.view.slots.values():
        assert rect[0] <= slot.rect[0] < slot.rect[2] <= rect[2] + 1e-6
        assert rect[1] <= slot.name[1] <= slot.rect[1] < slot.rect[3] <= end
