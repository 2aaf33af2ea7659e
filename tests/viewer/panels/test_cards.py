"""Places of cards in the scene, which never cover the names of surfaces."""

import numpy as np
import pytest

from abfm_viewer.panels.cards import area
from abfm_viewer.scene.slots import slots

LAYOUTS = ("automatic", "row", "column")


def covers(one, other):
    across = min(one[2], other[2]) - max(one[0], other[0])
    down = min(one[3], other[3]) - max(one[1], other[1])
    return min(across, down) > 0


@pytest.mark.parametrize("size", [(560, 460), (1020, 700), (1780, 1300)])
@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("count", [1, 2, 3, 6])
def test_cards_cover_no_name(size, layout, count):
    rect = (0.0, 24.0, float(size[0]), 24.0 + size[1])
    found = slots("abcdef"[:count], rect, (0.6, 1.0), layout, 28.0).values()
    names = [slot.name for slot in found]
    left, top, right, bottom = cards = area(rect, names, 1.0)
    assert not any(covers(cards, name) for name in names)
    assert rect[0] <= left < right <= rect[2]
    assert rect[1] <= top < bottom <= rect[3]
    assert right - left >= 300
    assert bottom - top >= 38


def test_cards_are_above_low_names():
    rect, low = (0.0, 0.0, 600.0, 400.0), (0.0, 350.0, 600.0, 380.0)
    assert np.allclose(area(rect, [low], 1.0), (150, 10, 590, 340))
