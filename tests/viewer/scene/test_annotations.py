"""Names and colour bars keep clear of each other and of the edges, however little room there is."""

from __future__ import annotations

from itertools import combinations, pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from abfm_viewer.appearance.abbreviation import cut
from abfm_viewer.appearance.colormaps import ColorRange
from abfm_viewer.appearance.theme import palette
from abfm_viewer.scene import annotations
from abfm_viewer.scene.annotations import (
    Line,
    Pen,
    Strip,
    Text,
    bar_parts,
    bar_room,
    bars_in_a_line,
    laid_out,
    tell_what_is_cut,
    ticks,
)
from abfm_viewer.shown.paint import Paint

NAMES = ("source", "advected", "linear blend", "error", "target")

INKS = palette("light")


def width(text: str) -> float:
    return 8.0 * len(text)


def scene(right, columns=5):
    """Surfaces in slots between 0 and a right end; the error has a range of its own."""
    names = NAMES

    def paint(name):
        low_high = (0.0, 0.0423) if name == "error" else (0.0, 1.0)
        bar = "|target - advected|, at most 0.0423" if name == "error" else "function"
        return Paint(
            "vertex values", np.zeros(1), name, ColorRange("abfm sequential", *low_high), bar
        )

    width = right / columns
    places = [(i % columns * width, 50.0 * (i // columns)) for i in range(len(names))]
    labels = {name: (x, y, x + width, y + 20) for name, (x, y) in zip(names, places, strict=True)}
    return SimpleNamespace(
        shown=names,
        view=SimpleNamespace(is_beside=False, borders=list, label=labels.get),
        paints={name: paint(name) for name in names},
    )


def rect_of(one):
    if isinstance(one, Strip):
        return one.rect
    return (one.left, one.top, one.left + width(one.text), one.top + 16)


def overlap(a, b):
    return min(a[2], b[2]) - max(a[0], b[0]) > 0 and min(a[3], b[3]) - max(a[1], b[1]) > 0


@pytest.mark.parametrize("right", [240, 320, 480, 1000])
@pytest.mark.parametrize("columns", [1, 3, 5])
def test_nothing_lies_over_something_else_or_beyond_the_edge(right, columns):
    pen = Pen(1.0, 16.0, width, INKS)
    found = laid_out(scene(right, columns=columns), (0, 0, right, 600), pen)
    rects = [rect_of(one) for one in found if isinstance(one, Strip) or one.text]
    for first, second in combinations(rects, 2):
        assert not overlap(first, second)
    assert min(r[0] for r in rects) >= 0
    assert max(r[2] for r in rects) <= right


def test_the_mouse_tells_a_name_that_is_cut(monkeypatch):
    told = []
    io = SimpleNamespace(WantCaptureMouse=False)
    monkeypatch.setattr(annotations.imgui, "GetIO", lambda: io)
    monkeypatch.setattr(annotations.imgui, "SetTooltip", told.append)
    # "source", "advected", "linear blend"
    for x, captures in ((25, False), (75, False), (125, True), (125, False)):
        monkeypatch.setattr(annotations.imgui, "GetMousePos", lambda x=x: (x, 10))
        io.WantCaptureMouse = captures
        tell_what_is_cut(scene(300, columns=5), [], Pen(1.0, 16.0, width, INKS))
    assert told == ["advected", "linear blend"]


@pytest.mark.parametrize("right", [240, 480, 1000])
def test_in_a_low_window_bars_are_a_line_and_leave_the_surfaces_most_of_the_height(right):
    pen, height = Pen(2.0, 32.0, width, INKS), 320
    found = laid_out(scene(right, columns=5), (0, 0, right, height), pen, labels=False)
    bars = [one for one in found if isinstance(one, Strip)]
    assert len(bars) == 2
    rects = [
        rect_of(one) if isinstance(one, Strip) else (*rect_of(one)[:3], one.top + pen.line)
        for one in found
    ]
    assert max(rect[3] for rect in rects) <= height
    assert min(rect[1] for rect in rects) >= height - bar_room(pen, height)
    assert bar_room(pen, height) < 0.2 * height < bar_room(pen, 10 * height)
    written = {one.text for one in found if isinstance(one, Text)}
    assert {bar.title for bar in bars if bar.title} == {
        "function",
        "|target - advected|, at most 0.0423",
    } - written
    if right == 1000:
        assert {"function", "0", "1", "0.0423"} <= {
            one.text for one in found if isinstance(one, Text)
        }
        assert all(bar.rect[2] - bar.rect[0] > 60 for bar in bars)


@pytest.mark.parametrize(
    ("right", "expected"),
    [(240, ["", ""]), (400, ["function", ""]), (680, ["function", "|t - a|"])],
)
def test_titles_of_bars_in_a_line_are_whole_or_up_to_a_comma_or_not_there(right, expected):
    low, high = ColorRange("abfm sequential", 0.0, 1.0), ColorRange("abfm sequential", 0.0, 0.0423)
    whole = "|t - a|, at most 0.0423, and whatever else there may be to say of a mere bar"
    found = bars_in_a_line(
        {"function": low, whole: high}, (0, 0, right, 32), Pen(2.0, 32.0, width, INKS)
    )
    assert [one.text for one in found if isinstance(one, Text)][::3] == expected
    assert [one.title for one in found if isinstance(one, Strip)] == [
        "" if title == all_of_it else all_of_it
        for title, all_of_it in zip(expected, ["function", whole], strict=True)
    ]


def test_the_mouse_tells_a_title_that_is_cut(monkeypatch):
    told = []
    monkeypatch.setattr(annotations.imgui, "GetIO", lambda: SimpleNamespace(WantCaptureMouse=False))
    monkeypatch.setattr(annotations.imgui, "SetTooltip", told.append)
    narrow = ColorRange("abfm sequential", 0.0, 1.0)
    for y in (-100, 10):
        monkeypatch.setattr(annotations.imgui, "GetMousePos", lambda y=y: (30, y))
        for title in ("a bar's title", "bar"):
            pen = Pen(1.0, 16.0, width, INKS)
            parts = bar_parts(title, narrow, (0, 0, 60, 20), pen)
            tell_what_is_cut(SimpleNamespace(shown=()), parts, pen)
    assert told == ["a bar's title"]


def test_texts_are_cut_to_their_room():
    assert cut("advected", 64, width) == "advected"
    assert cut("advected", 63, width) == "adve..."
    assert cut("linear blend", 80, width) == "linear..."
    assert cut("advected", 31, width) == ""
    for room in range(0, 80, 7):
        assert width(cut("advected", room, width)) <= room


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (0, 1, [0, 0.2, 0.4, 0.6, 0.8, 1]),
        (-2, 2, [-2, -1, 0, 1, 2]),
        (0.4, 1.3, [0.4, 0.6, 0.8, 1, 1.2]),
    ],
)
def test_ticks_are_round(low, high, expected):
    assert ticks(low, high) == pytest.approx(expected)


@given(low=st.floats(-1e6, 1e6), width=st.floats(1e-3, 1e6))
def test_there_are_three_to_seven_ticks_inside_the_range(low, width):
    values = ticks(low, low + width)
    assert 3 <= len(values) <= 7
    assert values[0] >= low - 1e-6 * width
    assert values[-1] <= low + width + 1e-6 * width


def test_numbers_below_a_colour_bar_stand_apart():
    def numbers(right):
        narrow = ColorRange("abfm sequential", 0.0, 0.00115)
        parts = bar_parts("", narrow, (0, 0, right, 20), Pen(1.0, 16.0, width, INKS, tick=6.0))
        return [part for part in parts if isinstance(part, Text) and part.text]

    few, every = numbers(250), numbers(2000)
    assert [one.text for one in every] == [f"{value:.4g}" for value in ticks(0, 0.00115)]
    assert {one.text for one in few} < {one.text for one in every}
    assert few[0].text == "0"
    for left, right in pairwise(few):
        assert left.left + width(left.text) < right.left


def test_an_upright_bar_has_its_numbers_to_the_right_at_their_ticks():
    pen = Pen(1.0, 16.0, width, INKS, tick=6.0)
    parts = bar_parts("", ColorRange("gray", 0, 1), (5, 10, 25, 410), pen, upright=True)
    texts = [part for part in parts if isinstance(part, Text)]
    assert [one.text for one in texts] == ["0", "0.2", "0.4", "0.6", "0.8", "1"]
    assert [one.top + 8 for one in texts] == pytest.approx([410, 330, 250, 170, 90, 10])
    ends = [part.points for part in parts if isinstance(part, Line) and len(part.points) == 2]
    assert [points[0][1] for points in ends] == pytest.approx([one.top + 8 for one in texts])
    assert all(
        one.left > points[1][0] > points[0][0] == 25
        for one, points in zip(texts, ends, strict=True)
    )
