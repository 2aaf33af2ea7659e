from dataclasses import replace
from itertools import combinations, pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from abfm.pages.color_ranges import ticks
from abfm.pages.colormaps import ColorRange
from abfm_viewer.appearance.abbreviation import abbreviated
from abfm_viewer.appearance.theme import palette
from abfm_viewer.scene import annotations
from abfm_viewer.scene.annotations import (
    Disc,
    Line,
    Pen,
    Strip,
    Text,
    Triangle,
    Veil,
    bar_parts,
    bars_height,
)
from abfm_viewer.scene.scene import FAINT_TEXT
from abfm_viewer.shown.paint import Paint
from tests.viewer.contrast import contrast

NAMES = ("source", "advected", "linear blend", "error", "target")
RANGE = ColorRange("abfm sequential", 0.0, 1.0)
ERROR = "|target - advected|, at most 0.0423", ColorRange("abfm sequential", 0.0, 0.0423)


def width(text):
    return 8.0 * len(text)


PEN, LARGE = (Pen(scale, 16 * scale, width, palette("light"), 6 * scale) for scale in (1.0, 2.0))


def scene(right, columns=5):
    """Return surfaces in slots between 0 and a right end; the error has its own range."""
    room = right / columns
    bars = dict.fromkeys(NAMES, ("function", RANGE)) | {"error": ERROR}
    places = {name: (i % columns * room, 50.0 * (i // columns)) for i, name in enumerate(NAMES)}
    labels = {name: (x, y, x + room, y + 20) for name, (x, y) in places.items()}
    view = SimpleNamespace(has_names_at_left=False, borders=list, label=labels.get)
    return SimpleNamespace(
        shown=NAMES,
        outdated=(),
        view=view,
        view_of=lambda _: view,
        links=list,
        landmarks=list,
        legend=lambda: ("spiral", "saddle"),
        paints={
            name: Paint("vertex values", np.zeros(1), name, colors, bar)
            for name, (bar, colors) in bars.items()
        },
    )


def rect_of(one, line=16):
    if isinstance(one, Strip):
        return one.rect
    if isinstance(one, Disc):
        (x, y), radius = one.centre, one.radius
        return x - radius, y - radius, x + radius, y + radius
    return (one.left, one.top, one.left + width(one.text), one.top + line)


def texts(parts):
    return [one for one in parts if isinstance(one, Text)]


def strips(parts):
    return [one for one in parts if isinstance(one, Strip)]


@pytest.mark.parametrize("right", [240, 320, 480, 1000])
@pytest.mark.parametrize("columns", [1, 3, 5])
def test_annotations_do_not_overlap(right, columns):
    found = annotations.annotation_parts(scene(right, columns=columns), (0, 0, right, 600), PEN)
    discs = [one for one in found if isinstance(one, Disc)]
    assert len(discs) == (2 if right >= 480 else 0)
    shown = [one for one in found if isinstance(one, Strip | Disc) or getattr(one, "text", "")]
    rects = [rect_of(one) for one in shown]
    for a, b in combinations(rects, 2):
        across, down = min(a[2], b[2]) - max(a[0], b[0]), min(a[3], b[3]) - max(a[1], b[1])
        assert min(across, down) <= 0
    assert min(r[0] for r in rects) >= 0
    assert max(r[2] for r in rects) <= right


@pytest.mark.parametrize(("theme", "color"), [("light", (1, 1, 0.9)), ("dark", (0, 0, 0.2))])
def test_links_are_visible_and_below_names(theme, color):
    pen = replace(PEN, inks=palette(theme))
    linked, link = scene(1000), ((100.0, 0.0), (300.0, 40.0), np.array(color, float))
    linked.links = lambda: [link]
    found = annotations.annotation_parts(linked, (0, 0, 1000, 600), pen)
    line = next(one for one in found if isinstance(one, Line) and one.points == link[:2])
    assert contrast(line.color, pen.inks.ground) > 1.8
    veils = [number for number, one in enumerate(found) if isinstance(one, Veil)]
    names = [number for number, one in enumerate(found) if getattr(one, "text", "") in NAMES]
    assert [number + 1 for number in veils] == names[: len(veils)]
    assert found.index(line) < veils[0]
    assert found[veils[0]].rect[:2] < rect_of(found[names[0]])[2:]


@pytest.fixture
def tooltips(monkeypatch):
    """Return a function that returns the tooltips of a scene, or of parts, at a place."""
    found, io = [], SimpleNamespace(WantCaptureMouse=False)
    monkeypatch.setattr(annotations.imgui, "GetIO", lambda: io)
    monkeypatch.setattr(annotations.imgui, "SetTooltip", found.append)

    def at(place, what, parts=(), captures=False):
        io.WantCaptureMouse = captures
        monkeypatch.setattr(annotations.imgui, "GetMousePos", lambda: place)
        found.clear()
        annotations.show_full_title(what, parts, PEN)
        return list(found)

    return at


def test_abbreviated_titles_have_tooltips(tooltips):
    # "source", "advected", "linear blend"
    names = scene(300, columns=5)
    assert [tooltips((x, 10), names) for x in (25, 75, 125)] == [[], ["advected"], ["linear blend"]]
    assert tooltips((125, 10), names, captures=True) == []
    nothing = SimpleNamespace(shown=(), outdated=())
    long, short = (bar_parts(title, RANGE, (0, 0, 60, 20), PEN) for title in ("a long one", "bar"))
    assert tooltips((30, 10), nothing, long) == ["a long one"]
    assert tooltips((30, -100), nothing, long) == tooltips((30, 10), nothing, short) == []


@pytest.mark.parametrize("right", [240, 480, 1000])
def test_bars_are_one_line_in_a_low_window(right):
    height = 320
    rect = 0, 0, right, height
    found = annotations.annotation_parts(scene(right, columns=5), rect, LARGE, labels=False)
    bars, written = strips(found), {one.text for one in texts(found)}
    assert len(bars) == 2
    rects = [rect_of(one, LARGE.line) for one in found]
    assert max(rect[3] for rect in rects) <= height
    assert min(rect[1] for rect in rects) >= height - bars_height(LARGE, height)
    assert bars_height(LARGE, height) < 0.2 * height < bars_height(LARGE, 10 * height)
    assert {bar.title for bar in bars if bar.title} == {"function", ERROR[0]} - written
    if right == 1000:
        assert {"function", "0", "1", "0.0423"} <= written
        assert all(bar.rect[2] - bar.rect[0] > 60 for bar in bars)


@pytest.mark.parametrize(
    ("right", "expected"),
    [(240, ["", ""]), (400, ["function", ""]), (680, ["function", "|t - a|"])],
)
def test_titles_in_one_line_are_shortened(right, expected):
    whole = "|t - a|, at most 0.0423, and whatever else there may be to say of a mere bar"
    ranges = {"function": RANGE, whole: ERROR[1]}
    found = annotations.bars_in_one_line(ranges, (0, 0, right, 32), LARGE)
    assert [one.text for one in texts(found)][::3] == expected
    assert [one.title for one in strips(found)] == [
        "" if title == all_of_it else all_of_it
        for title, all_of_it in zip(expected, ["function", whole], strict=True)
    ]


def test_texts_are_abbreviated():
    assert abbreviated("advected", 64, width) == "advected"
    assert abbreviated("advected", 63, width) == "adve..."
    assert abbreviated("linear blend", 80, width) == "linear..."
    assert abbreviated("advected", 31, width) == ""
    assert all(width(abbreviated("advected", room, width)) <= room for room in range(0, 80, 7))


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


def test_numbers_below_a_bar_do_not_overlap():
    narrow = ColorRange("abfm sequential", 0.0, 0.00115)
    few, every = (
        [one for one in texts(bar_parts("", narrow, (0, 0, right, 20), PEN)) if one.text]
        for right in (250, 2000)
    )
    assert [one.text for one in every] == [f"{value:.4g}" for value in ticks(0, 0.00115)]
    assert {one.text for one in few} < {one.text for one in every}
    assert few[0].text == "0"
    for left, right in pairwise(few):
        assert left.left + width(left.text) < right.left


def test_upright_bar_has_numbers_at_its_ticks():
    parts = bar_parts("", ColorRange("gray", 0, 1), (5, 10, 25, 410), PEN, upright=True)
    written = texts(parts)
    assert [one.text for one in written] == ["0", "0.2", "0.4", "0.6", "0.8", "1"]
    assert [one.top + 8 for one in written] == pytest.approx([410, 330, 250, 170, 90, 10])
    ends = [part.points for part in parts if isinstance(part, Line) and len(part.points) == 2]
    assert [points[0][1] for points in ends] == pytest.approx([one.top + 8 for one in written])
    for one, (start, end) in zip(written, ends, strict=True):
        assert one.left > end[0] > start[0] == 25


@pytest.mark.parametrize(("clipped", "upright"), [("low", False), ("high", False), ("high", True)])
def test_arrow_points_beyond_a_clipped_end(clipped, upright):
    ends = {"low": (-9.0, 1.0), "high": (0.0, 9.0)}[clipped]
    rect = (5, 10, 25, 410) if upright else (10, 5, 410, 25)
    whole = bar_parts("f", ColorRange("abfm sequential", 0, 1, 0, 1), rect, PEN, upright)
    assert not [part for part in whole if isinstance(part, Triangle)]
    parts = bar_parts("f", ColorRange("abfm sequential", 0, 1, *ends), rect, PEN, upright)
    (arrow,) = [part for part in parts if isinstance(part, Triangle)]
    tip = arrow.points[1]
    assert tip == {False: ({"low": -6, "high": 426}[clipped], 15), True: (15, -6)}[upright]
    (strip,) = strips(parts)
    assert strip.title == f"f: values from {ends[0]:g} to {ends[1]:g}"
    assert strip.rect == rect


def test_legend_is_shortened_before_it_is_omitted():
    found = scene(1000, columns=1)
    found.legend = lambda: (FAINT_TEXT,)
    found.paints = dict.fromkeys(NAMES, found.paints["source"])
    written = [
        {
            part.text
            for part in annotations.annotation_parts(found, (0, 0, right, 600), PEN)
            if isinstance(part, Text)
        }
        & {FAINT_TEXT, "undetermined"}
        for right in (1000, 420, 200)
    ]
    assert written == [{FAINT_TEXT}, {"undetermined"}, set()]
