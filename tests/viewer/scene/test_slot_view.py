"""What the mouse does to a view of slots: geometry."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from abfm_viewer.document.document import Front, triple
from abfm_viewer.scene.slots import Fit, slots
from tests.shapes import ellipsoid

POINTS = ellipsoid(3, 1.0, 0.7, 0.4).vertices + np.array([0.3, -0.2, 0.1])
FRONT = Front((0.0, 0.0, 1.0), (0.0, 1.0, 0.0))
NAMES = ("source", "advected", "target")
PLACES = slots(NAMES, (0, 0, 900, 500), (2.0, 1.4), "row", 20.0)
WINDOW = (1280, 800)
in_slot = st.tuples(st.floats(310, 590), st.floats(30, 490))


def front(rotation) -> Front:
    return Front(triple(rotation[2]), triple(rotation[1]))


def view(zoom=1.0, target=None, rotation=None):
    return Fit(POINTS, FRONT).view(
        PLACES, FRONT if rotation is None else front(rotation), zoom, target
    )


def again(seen):
    """The view that the mouse asks for, as it is drawn next."""
    return view(seen.zoom, seen.target, seen.rotation)


def point_at(seen, name, place):
    """The point of a surface that a place shows, as deep as its middle."""
    middle = seen.slots[name].middle
    x, y = (place[0] - middle[0]) / seen.scale, (middle[1] - place[1]) / seen.scale
    return seen.target + np.array([x, y, 0.0]) @ seen.rotation


def test_every_surface_fits_its_slot_from_every_side_and_fills_it_from_the_front():
    for rotation in Rotation.random(100, np.random.default_rng(0)).as_matrix():
        seen = view(rotation=rotation)
        for name, slot in PLACES.items():
            x, y, _ = seen.projected(name, POINTS).T
            left, top, right, bottom = slot.rect
            assert left < x.min()
            assert x.max() < right
            assert top < y.min()
            assert y.max() < bottom
    x, y, _ = view().projected("source", POINTS).T
    half = PLACES["source"].half
    assert max(np.ptp(x) / (2 * half[0]), np.ptp(y) / (2 * half[1])) == pytest.approx(1)


def test_all_surfaces_look_alike():
    seen = view(2.0, np.array([0.5, 0, 0]), Rotation.from_rotvec([0.3, 1, 0.2]).as_matrix())
    places = [seen.projected(name, POINTS) - [*PLACES[name].middle, 0] for name in NAMES]
    np.testing.assert_allclose(places[0], places[1], atol=1e-9)
    np.testing.assert_allclose(places[0], places[2], atol=1e-9)


def test_the_matrix_puts_points_where_they_are_projected():
    seen = view(1.7, np.array([0.5, 0.1, 0]), Rotation.from_rotvec([0.3, 1, 0.2]).as_matrix())
    matrix = seen.matrix("advected", WINDOW)
    there = POINTS @ matrix[:3, :3].T + matrix[:3, 3]
    x, y, depth = seen.projected("advected", POINTS).T
    np.testing.assert_allclose(seen.scale * there[:, 0] + WINDOW[0] / 2, x)
    np.testing.assert_allclose(WINDOW[1] / 2 - seen.scale * there[:, 1], y)
    np.testing.assert_allclose(there[:, 2], -depth)


@given(place=in_slot, factor=st.floats(1.0, 8.0))
def test_what_is_under_the_mouse_stays_there_when_it_comes_nearer(place, factor):
    seen = view(1.3, np.array([0.1, 0, 0.05]))
    point = point_at(seen, "advected", place)
    nearer = again(seen.zoomed("advected", place, factor))
    np.testing.assert_allclose(nearer.projected("advected", point)[0, :2], place)


@given(place=in_slot, factor=st.floats(1.1, 8.0))
def test_going_back_is_the_same_way(place, factor):
    seen = view()
    nearer = again(seen.zoomed("advected", place, factor))
    half_way = again(nearer.zoomed("advected", (0, 0), 0.97))
    point = point_at(nearer, "advected", place)
    np.testing.assert_allclose(half_way.projected("advected", point)[0, :2], place, atol=1e-6)
    back = nearer.zoomed("source", (0, 0), 1 / factor)
    assert back.zoom == pytest.approx(1)
    np.testing.assert_allclose(back.target, seen.home, atol=1e-9)


@given(delta=st.tuples(st.floats(-60, 60), st.floats(-60, 60)))
def test_surfaces_move_with_the_mouse(delta):
    seen = view(2.0)
    after = again(seen.moved(delta))
    moved = after.projected("target", POINTS) - seen.projected("target", POINTS)
    np.testing.assert_allclose(moved, np.broadcast_to([*delta, 0], moved.shape), atol=1e-9)


def test_surfaces_cannot_be_lost():
    seen = view()
    for _ in range(50):
        seen = again(seen.moved((500.0, -300.0)))
    assert np.linalg.norm(seen.target - seen.home) <= seen.radius * (1 + 1e-9)


@given(start=in_slot, end=in_slot)
def test_the_ball_turns_with_the_mouse(start, end):
    seen = view()
    rotation = seen.turned("advected", start, end).rotation
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)
    ball = seen._on_ball("advected", start)
    np.testing.assert_allclose(
        rotation @ seen.rotation.T @ ball, seen._on_ball("advected", end), atol=1e-9
    )


def test_a_mouse_that_stays_turns_nothing():
    seen = view()
    assert seen.turned("source", (100, 100), (100, 100)) is seen


def test_the_surface_under_the_mouse_is_the_nearest_slot():
    seen = view()
    assert seen.slot_at((450, 5)) == "advected"
    assert seen.slot_at((-20, 900)) == "source"
    assert seen.slot_at((890, 250)) == "target"


def test_names_are_close_above_their_surfaces_and_in_their_slots():
    for rotation in Rotation.random(20, np.random.default_rng(1)).as_matrix():
        for zoom in (0.3, 1.0, 5.0):
            seen = view(zoom=zoom, rotation=rotation)
            for name, slot in PLACES.items():
                left, top, right, bottom = seen.label(name)
                highest = float(seen.projected(name, POINTS)[:, 1].min())
                assert (left, right, bottom - top) == (*slot.name[::2], slot.name[3] - slot.name[1])
                assert bottom == pytest.approx(max(highest, slot.rect[1]))


def test_a_name_stays_in_its_slot_when_its_surface_leaves_it():
    seen = view(zoom=0.5)
    for away in ((0.0, -5e3), (0.0, 5e3)):
        gone = view(zoom=0.5, target=seen.target + np.array([0.0, away[1], 0.0]))
        for name, slot in PLACES.items():
            _, top, _, bottom = gone.label(name)
            assert slot.name[1] <= top < bottom <= slot.rect[3]


def test_a_name_beside_its_surface_stays_there_when_that_fills_the_slot():
    low = slots(NAMES, (0, 0, 900, 150), (2.0, 1.4), "column", 20.0)
    seen = Fit(POINTS, FRONT).view(low, FRONT, 9.0, None)
    assert seen.is_beside
    assert all(seen.label(name) == slot.name for name, slot in low.items())


def test_a_name_beside_its_surface_ends_where_that_begins_from_its_widest_side():
    low = slots(NAMES, (0, 0, 2000, 150), (2.0, 1.4), "column", 20.0)
    seen = Fit(POINTS, FRONT)
    for rotation in Rotation.random(20, np.random.default_rng(1)).as_matrix():
        turned = seen.view(low, Front(tuple(rotation[2]), tuple(rotation[1])), 1.0, None)
        for name, slot in low.items():
            begins = slot.middle[0] - turned.scale * turned.radius
            left, top, right, bottom = turned.label(name)
            assert (left, top, bottom) == (slot.name[0], slot.name[1], slot.name[3])
            assert right == pytest.approx(begins)
            assert turned.projected(name, POINTS)[:, 0].min() >= begins - 1e-9


def test_lines_are_between_slots_and_only_where_surfaces_reach_them():
    assert view().borders() == view(zoom=0.5).borders() == []
    assert view(zoom=2.0).borders() == [
        ((300.0, 0.0), (300.0, 500.0)),
        ((600.0, 0.0), (600.0, 500.0)),
    ]
    five = slots("abcde", (0, 0, 900, 600), (1.0, 1.0), "automatic", 20.0)
    lines = Fit(POINTS, FRONT).view(five, FRONT, 2.0, None).borders()
    across = [(start, end) for start, end in lines if start[1] == end[1]]
    assert across == [((0.0, 300.0), (900.0, 300.0))]
    assert sorted(start[0] for start, end in lines if start[0] == end[0]) == [
        150,
        300,
        450,
        600,
        750,
    ]
    assert Fit(POINTS, FRONT).view({"a": five["a"]}, FRONT, 2.0, None).borders() == []


def test_a_fit_is_the_same_whatever_was_looked_at_before():
    rotations = Rotation.random(3, np.random.default_rng(1)).as_matrix()
    fit, sides = Fit(POINTS, FRONT), [front(rotation) for rotation in rotations]
    for side in (sides[0], sides[1], sides[1], FRONT, sides[2], sides[0]):
        seen, alone = (
            fit.view(PLACES, side, 1.0, None),
            Fit(POINTS, FRONT).view(PLACES, side, 1.0, None),
        )
        assert (seen.scale, seen.above) == (alone.scale, alone.above)
        np.testing.assert_array_equal(seen.rotation, side.axes)


@given(
    deltas=st.lists(st.tuples(st.floats(-400, 400), st.floats(-400, 400)), max_size=5),
    zoom=st.floats(0.5, 8.0),
)
def test_a_turntable_stays_upright(deltas, zoom):
    seen = view(zoom)
    for delta in deltas:
        seen = again(seen.orbited(delta))
        across, up, _ = seen.rotation @ seen.upright
        assert abs(across) < 1e-9
        assert up > -1e-9
        np.testing.assert_allclose(seen.rotation @ seen.rotation.T, np.eye(3), atol=1e-12)


def test_what_faces_the_viewer_goes_where_the_turntable_is_dragged():
    seen = view()
    point = seen.target + 0.1 * seen.rotation[2]
    for delta in ((9.0, 0.0), (0.0, 9.0), (-9.0, 0.0), (0.0, -9.0)):
        after = again(seen.orbited(delta))
        moved = (after.projected("source", point) - seen.projected("source", point))[0, :2]
        assert moved @ delta > 0.99 * np.linalg.norm(moved) * 9
