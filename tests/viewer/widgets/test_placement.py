"""Places of tooltips: next to panels and above wide bars, never over the explained widget."""

import pytest

from abfm_viewer.widgets.placement import beside

WINDOW = (0.0, 0.0, 1000.0, 700.0)
PANEL = (620.0, 20.0, 1000.0, 670.0)
MENU = (0.0, 20.0, 200.0, 500.0)
TIME_BAR = (0.0, 600.0, 620.0, 670.0)
MENU_BAR = (0.0, 0.0, 1000.0, 20.0)


def rect_of(item, area, size=(300.0, 100.0)):
    x, y = beside(item, area, WINDOW, size, 8.0)
    return x, y, x + size[0], y + size[1]


def overlap(a, b):
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


@pytest.mark.parametrize("area", [PANEL, MENU, TIME_BAR])
def test_tooltips_cover_no_part_of_their_area(area):
    for y in range(int(area[1]), int(area[3]) - 20, 20):
        place = rect_of((area[0] + 5, y, area[0] + 105, y + 20), area)
        assert not overlap(place, area)
        assert place[0] >= 0
        assert place[1] >= 0
        assert place[2] <= 1000
        assert place[3] <= 700


def test_tooltip_begins_at_the_height_of_its_item():
    assert rect_of((630, 200, 900, 220), PANEL)[:2] == (620 - 8 - 300, 200)


@pytest.mark.parametrize("area", [MENU_BAR, (100.0, 10.0, 900.0, 690.0)])
def test_tooltip_of_a_wide_area_leaves_the_item_visible(area):
    for y in (area[1] + 2, area[3] - 20):
        item = (850, y, 890, y + 16)
        assert not overlap(rect_of(item, area), item)
