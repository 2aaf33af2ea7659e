"""Slots fill their part of the window, apart and all alike, whatever the layout."""

from __future__ import annotations

from itertools import combinations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from abfm_viewer.scene.slots import fitting, slots

NAMES = tuple("abcdef")


def made(count, rect, shape=(1.0, 1.0), layout="automatic", name_height=20.0):
    return slots(NAMES[:count], rect, shape, layout, name_height)


def whole(slot):
    """A slot with its name."""
    return (slot.name[0], slot.name[1], slot.rect[2], slot.rect[3])


@given(
    count=st.integers(1, 6),
    width=st.floats(60, 3000),
    height=st.floats(60, 3000),
    shape=st.tuples(st.floats(0.1, 10), st.floats(0.1, 10)),
    layout=st.sampled_from(["automatic", "row", "column", "advected only"]),
)
def test_slots_are_inside_and_apart_and_of_one_size(count, width, height, shape, layout):
    rect = (10.0, 30.0, 10 + width, 30 + height)
    found = list(made(count, rect, shape, layout).values())
    for slot in found:
        left, top, right, bottom = whole(slot)
        assert left >= rect[0] - 1e-6
        assert top >= rect[1] - 1e-6
        assert right <= rect[2] + 1e-6
        assert bottom <= rect[3] + 1e-6
        assert slot.half == pytest.approx(found[0].half)
        assert min(slot.half) > 0
    for one, other in combinations(map(whole, found), 2):
        across = min(one[2], other[2]) - max(one[0], other[0])
        down = min(one[3], other[3]) - max(one[1], other[1])
        assert min(across, down) <= 1e-6


def test_in_a_low_slot_the_name_stands_beside_the_surface():
    low, high = (
        made(3, (0, 0, 600, height), layout="column", name_height=40.0) for height in (240, 900)
    )
    for slot in low.values():
        assert slot.rect[1] == slot.name[1]
        assert slot.rect[3] - slot.rect[1] == 80
        assert slot.name[0] == 0 < slot.name[2] == slot.rect[0]
    for slot in high.values():
        assert slot.name[3] == slot.rect[1]


def columns(found):
    return len({slot.rect[0] for slot in found.values()})


def test_six_surfaces_fill_the_window_in_rows_that_its_shape_asks_for():
    assert columns(made(6, (0, 0, 900, 600))) == 3
    assert columns(made(6, (0, 0, 600, 900))) == 2
    assert columns(made(6, (0, 0, 3000, 300))) == 6
    assert columns(made(6, (0, 0, 300, 3000))) == 1
    six = made(6, (0, 0, 900, 600))
    assert (
        sum((slot.rect[2] - slot.rect[0]) * (slot.rect[3] - slot.name[1]) for slot in six.values())
        == 900 * 600
    )


@pytest.mark.parametrize("shape", [(1.0, 1.0), (0.45, 1.0), (3.0, 1.0)])
@pytest.mark.parametrize("count", [2, 3, 4, 5, 6])
@pytest.mark.parametrize("size", [(620, 480), (900, 600), (1780, 1260), (500, 900)])
def test_an_automatic_layout_makes_surfaces_nearly_as_large_as_can_be(shape, count, size):
    def scale(**options):
        return fitting(
            next(iter(made(count, (0, 0, *size), shape, **options).values())).half, shape
        )

    others = max(scale(layout="row"), scale(layout="column"))
    assert scale(layout="automatic") > 0.8 * others


def test_a_last_row_with_fewer_surfaces_stands_in_the_middle():
    found = made(5, (0, 0, 900, 600))
    assert [slot.rect[0] for slot in found.values()] == pytest.approx([0, 300, 600, 150, 450])


def test_a_row_and_a_column_are_what_they_are_called():
    rect = (0, 0, 900, 600)
    assert columns(made(6, rect, layout="row")) == 6
    assert columns(made(6, rect, layout="column")) == 1
