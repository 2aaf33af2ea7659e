"""Names and colour bars keep clear of each other and of the edges, however little room there is."""

from __future__ import annotations

from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest

from abfm_viewer.appearance.abbreviation import cut
from abfm_viewer.appearance.colormaps import ColorRange
from abfm_viewer.appearance.theme import palette
from abfm_viewer.scene.annotations import Pen, Strip, Text, laid_out
from abfm_viewer.shown.paint import Paint

NAMES = ("source", "advected", "linear blend", "error", "target")


def width(text: str) -> float:
    return 8.0 * len(text)


def scene(right, count=5, stacked=False):
    """Surfaces side by side between 0 and a right end; the error has a range of its own."""
    names = NAMES[:count]
    centers = (np.arange(count) + 0.5) * right / count

    def paint(name):
        low_high = (0.0, 0.0423) if name == "error" else (0.0, 1.0)
        bar = "|target - advected|, at most 0.0423" if name == "error" else "function"
        return Paint("vertex values", np.zeros(1), name, ColorRange("abfm sequential", *low_high), bar)

    places = [(right / 2, 60.0 + 50 * i) if stacked else (float(x), 100.0) for i, x in enumerate(centers)]
    return SimpleNamespace(
        names=names,
        paints={name: paint(name) for name in names},
        labels=lambda: dict(zip(names, places, strict=True)),
        stacked=stacked,
    )


def rect_of(one):
    if isinstance(one, Strip):
        return one.rect
    return (one.left, one.top, one.left + width(one.text), one.top + 16)


def overlap(a, b):
    return min(a[2], b[2]) - max(a[0], b[0]) > 0 and min(a[3], b[3]) - max(a[1], b[1]) > 0


@pytest.mark.parametrize("right", [240, 320, 480, 1000])
@pytest.mark.parametrize("stacked", [False, True])
def test_nothing_lies_over_something_else_or_beyond_the_edge(right, stacked):
    pen = Pen(1.0, 16.0, width)
    found = laid_out(scene(right, stacked=stacked), (0, 0, right, 600), palette("light"), pen)
    rects = [rect_of(one) for one in found if isinstance(one, Strip) or one.text]
    for first, second in combinations(rects, 2):
        assert not overlap(first, second)
    if not stacked:
        assert min(r[0] for r in rects) >= 0
        assert max(r[2] for r in rects) <= right


def test_where_there_is_room_everything_is_written_whole():
    texts = [
        one.text
        for one in laid_out(scene(1000), (0, 0, 1000, 600), palette("light"), Pen(1.0, 16.0, width))
        if isinstance(one, Text)
    ]
    assert set(NAMES) < set(texts)
    assert {"function", "0", "0.5", "1", "|target - advected|, at most 0.0423", "0.0211", "0.0423"} < set(texts)


def test_texts_are_cut_to_their_room():
    assert cut("advected", 64, width) == "advected"
    assert cut("advected", 63, width) == "adve..."
    assert cut("linear blend", 80, width) == "linear..."
    assert cut("advected", 31, width) == ""
    for room in range(0, 80, 7):
        assert width(cut("advected", room, width)) <= room
