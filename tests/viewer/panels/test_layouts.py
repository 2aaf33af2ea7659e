"""At every size and scale and in every state, each widget has its place: nothing is cut off,
covered, or jumps.
"""

from __future__ import annotations

import json
import sys
from itertools import combinations
from pathlib import Path

import pytest

from tests.processes import run

ROOT = Path(__file__).parents[3]
_ROUNDING = 1.0  # pixels


@pytest.fixture(scope="module")
def layouts():
    """The window's widgets at every size and scale, in every state and tab."""
    done = run(sys.executable, "-m", "tests.viewer.panels.layouts", cwd=ROOT)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def where(layout):
    width, height = layout["size"]
    return f"{layout['tab']}, {layout['state']}, {width}x{height} at scale {layout['scale']:g}"


def visible(widget):
    """The part of a widget that its panel shows; None if it must be scrolled to."""
    left, top, right, bottom = (
        choose(own, area)
        for choose, own, area in zip(
            (max, max, min, min), widget["rect"], widget["area"], strict=True
        )
    )
    return (left, top, right, bottom) if left < right and top < bottom else None


def test_each_tab_fits_one_screen(layouts):
    shown = [layout for layout in layouts if layout["size"] == [1280, 800] and layout["scale"] == 1]
    for layout in shown:
        (hidden,) = [
            height
            for name, height in layout["hidden"].items()
            if name.endswith(f"/{layout['tab']}")
        ]
        assert hidden == 0, where(layout)
    assert {layout["tab"] for layout in shown} == {"Functions", "Match", "Look", "Export"}


def test_nothing_is_cut_off_at_the_side(layouts):
    for layout in layouts:
        for drawn in (*layout["widgets"], *layout["lines"]):
            what = drawn.get("label") or drawn["text"]
            (left, _, right, _), (start, _, end, _) = drawn["rect"], drawn["area"]
            assert start - _ROUNDING <= left <= right <= end + _ROUNDING, (
                f"{what!r}: {where(layout)}"
            )


def test_what_does_not_scroll_is_in_view(layouts):
    for layout in layouts:
        for widget in layout["widgets"]:
            inside = widget["section"].split("/")[0]
            if inside in ("time bar", "steps") or widget["label"] in ("Match", "Pause", "Cancel"):
                (_, top, _, bottom), (_, first, _, last) = widget["rect"], widget["area"]
                assert first <= top < bottom <= last, f"{widget['label']!r}: {where(layout)}"
    for layout in layouts:
        sliders = [
            w for w in layout["widgets"] if w["kind"] == "slider" and w["section"] == "time bar"
        ]
        (time,) = (w["rect"] for w in sliders if w["label"] == "time")
        assert time[2] - time[0] > 60 * layout["scale"], where(layout)


def test_words_fit_their_widgets_or_are_told_in_full(layouts):
    for layout in layouts:
        for widget in layout["widgets"]:
            if widget["kind"] in ("button", "tab", "checkbox", "choice", "section"):
                width = widget["rect"][2] - widget["rect"][0]
                assert widget["text_width"] <= width + _ROUNDING, (
                    f"{widget['label']!r}: {where(layout)}"
                )
                if widget["shown"] not in ("", widget["label"]):
                    assert widget["shown"].endswith("...") or not widget["shown"]
                    assert widget["tip"].startswith(widget["label"]), where(layout)


def test_at_an_ordinary_scale_no_word_is_cut(layouts):
    for layout in layouts:
        if layout["scale"] == 1:
            assert [
                w["label"] for w in layout["widgets"] if w["shown"] not in ("", w["label"])
            ] == [], where(layout)


def test_no_widget_covers_another(layouts):
    for layout in layouts:
        drawn = [(w, visible(w)) for w in layout["widgets"] if w["kind"] != "menu" and visible(w)]
        for (one, a), (other, b) in combinations(drawn, 2):
            if "A title" in (one["section"], other["section"]):
                continue  # a dialog is in front of everything
            width, height = min(a[2], b[2]) - max(a[0], b[0]), min(a[3], b[3]) - max(a[1], b[1])
            covered = width > _ROUNDING and height > _ROUNDING
            assert not covered, f"{one['label']!r} and {other['label']!r}: {where(layout)}"


def test_no_text_is_written_over_another(layouts):
    for layout in layouts:
        drawn = [
            (note, visible(note)) for note in layout["notes"] if note["text"] and visible(note)
        ]
        for (one, a), (other, b) in combinations(drawn, 2):
            if one["area"] == other["area"]:
                over = min(a[2], b[2]) - max(a[0], b[0]), min(a[3], b[3]) - max(a[1], b[1])
                assert min(over) <= _ROUNDING, (
                    f"{one['text']!r} and {other['text']!r}: {where(layout)}"
                )


def test_remedies_are_in_view(layouts):
    for layout in layouts:
        remedies = [widget for widget in layout["widgets"] if widget["section"] == "verdict"]
        assert bool(remedies) == (layout["state"] in ("matched", "exported", "asked")), where(
            layout
        )
        for widget in remedies:
            assert widget["area"][3] >= widget["rect"][3] - _ROUNDING, (
                f"{widget['label']!r}: {where(layout)}"
            )


def test_advice_that_no_button_carries_out_is_in_view_as_a_whole(layouts):
    """With its cause, at an ordinary scale; else as much as has room."""
    for layout in layouts:
        if layout["state"] == "advised":
            (advice,) = [note for note in layout["notes"] if note["text"].startswith("To try: ")]
            (_, top, _, bottom), (_, first, _, last) = advice["rect"], advice["area"]
            assert first <= top < bottom <= last + _ROUNDING, where(layout)
            if layout["scale"] == 1:
                cut = [
                    n["text"]
                    for n in layout["notes"]
                    if n["area"] == advice["area"] and n["text"].endswith("...")
                ]
                assert cut == [], where(layout)
                assert (
                    advice["text"]
                    == "To try: smooth the function that has more of them, or expect a match in "
                    "part."
                )


def test_nothing_jumps_from_one_state_to_the_next(layouts):
    first: dict[tuple, tuple] = {}
    for layout in layouts:
        for widget in layout["widgets"]:
            if widget["kind"] != "plot" and widget["section"] not in ("A title", "verdict"):
                place, key = (
                    widget["rect"][:2],
                    (widget["section"], widget["label"], widget["kind"]),
                )
                before = first.setdefault(
                    (*layout["size"], layout["scale"], layout["tab"], *key), place
                )
                assert place == pytest.approx(before, abs=_ROUNDING), f"{key}: {where(layout)}"


def test_behind_a_dialog_everything_is_grey(layouts):
    for layout in layouts:
        if layout["state"] == "asked":
            enabled = {
                w["label"] for w in layout["widgets"] if w["enabled"] and w["section"] != "A title"
            }
            assert enabled == set(), where(layout)


def test_surfaces_have_most_of_the_width(layouts):
    for layout in layouts:
        left, _, right, _ = layout["parts"]["scene"]
        assert right - left > layout["size"][0] / 2, where(layout)


def test_what_a_user_changes_something_with_has_a_tooltip(layouts):
    kinds = ("slider", "box", "button", "checkbox", "combo")
    for layout in layouts:
        for widget in layout["widgets"]:
            if widget["section"].split("/")[0] == layout["tab"] and widget["kind"] in kinds:
                assert widget["tip"], f"{widget['label']!r}: {where(layout)}"
