"""Layouts of the window at every size and scale and in every state.

As a program, this file prints the widgets of all layouts. It draws nothing (`openGL_mock`), which
needs a separate process.
"""

import json
import sys
from dataclasses import asdict, replace
from itertools import combinations
from pathlib import Path

import numpy as np
import polyscope.imgui as imgui
import pytest

from abfm.matching import Remedy
from abfm.matching.judging.cause import ADVICE, SENTENCES
from abfm.matching.judging.verdict import Evidence, judge
from abfm.matching.solving.record import StopReason
from abfm.matching.terms.functions import FunctionTerm
from abfm.outcome import Facts, Outcome
from abfm.parameters import Parameters
from abfm_viewer.automation import Driver
from abfm_viewer.panels.right_panel import TABS
from abfm_viewer.shown import quantities
from abfm_viewer.widgets.toolkit import Ui
from abfm_viewer.window.menus import UI_SCALES
from tests.processes import run
from tests.viewer.sessions import EGG, ENDLESS, QUICK, match, stepped

SCALES = {(1000, 700): (1.0, 2.0), (1280, 800): (1.0, 2.0), (2560, 1440): (2.0,)}
"""Of the window, by its size; a large one has room at a scale of 1."""
_WRITTEN = "saved /a/folder/with/a/name/that/is/long/enough/to/need/more/than/one/line/picture.png"
_ROUNDING = 1.0  # pixels
LONGEST = "longest"
LONG = LONGEST, "advised"


# The program


def two_channels_with_other_peaks():
    """Return a document whose advice has no button: flow lines refute that one peak became two."""
    heights = EGG.vertices[:, 0] / np.ptp(EGG.vertices[:, 0])
    near, far = (np.exp(-20 * (heights - place) ** 2) for place in (heights.max(), heights.min()))
    problem = FunctionTerm(EGG, np.stack([near, heights], 1), np.stack([near + far, heights], 1))
    evidence = Evidence(problem.target, 0.01, StopReason.CONVERGED, verified=0.5)
    return judge(problem, evidence, Parameters())


def longest():
    """Return a document with the longest possible sentences, though not of one match."""
    return Facts(
        Outcome.REGISTERED,
        "registered (residual less than 0.01%), areas change by a factor of 1200",
        max(SENTENCES.values(), key=len),
        max(ADVICE.values(), key=len),
        warnings=("5% of the area changes by a factor of 120 or more",),
        short_headline="registered (residual <0.01%), areas ×1200",
    )


def _states(gui):
    session, player = gui.session, gui.session.player
    yield "start"
    session.editor.amend(parameters=ENDLESS)
    session.match()
    gui.wait(lambda s: s.matching.snapshot is not None)
    player.playing = False
    yield "running"
    session.solver.cancel()
    gui.wait(lambda s: s.solver.finished and s.result is not None)
    player.playing = False
    verdict, offered = session.result.verdict, Remedy("More time", "so", {"iterations": 100})
    verdict = replace(verdict, remedies=(offered, *verdict.remedies))
    session.editor.amend(result=replace(session.result, verdict=verdict))
    yield "matched"
    found, verdict = session.result, two_channels_with_other_peaks()
    session.editor.amend(result=replace(found, stop_reason=StopReason.NO_PROGRESS, verdict=verdict))
    yield "advised"
    session.editor.amend(result=stepped(found))
    yield "with a path"
    verdict = replace(found.verdict, remedies=())
    stuck = replace(found, stop_reason=StopReason.NO_PROGRESS, verdict=verdict)
    vars(stuck)["facts"] = longest()
    session.editor.amend(result=stuck)
    yield LONGEST
    session.editor.amend(result=found)
    gui.window.exporter.message = _WRITTEN
    yield "exported"
    gui.window.dialogs.show("A title", ["A line."])
    yield "question"


def _recorded(method):
    """Return the texts that a method of `Ui` writes from now on, with their places."""
    found, write = [], getattr(Ui, method)

    def recorded(ui, text, *options, **more):
        write(ui, text, *options, **more)
        rect = (*imgui.GetItemRectMin(), *imgui.GetItemRectMax())
        width = imgui.CalcTextSize(text)[0]
        area = ui.record.areas[-1]
        found.append({"text": text, "rect": rect, "area": area, "text_width": width})

    setattr(Ui, method, recorded)
    return found


def _finish_drawing(gui):
    """Wait for the field and then for its streaks, which a later frame requests."""
    is_idle = False
    while not is_idle:
        gui.wait(lambda _: not gui.window.shown.busy)  # draws two more frames
        is_idle = not gui.window.shown.busy


def _layouts(gui, size, texts):
    for state in _states(gui):
        for scale in UI_SCALES if state == LONGEST else SCALES[size]:
            gui.session.editor.amend(view=replace(gui.session.view, ui_scale=scale))
            gui.frames(3)
            for tab in TABS:
                gui.window.ui.open_tab = tab
                gui.frames(2)
                if state == LONGEST:
                    _finish_drawing(gui)
                for written in texts.values():
                    written.clear()
                gui.frames(1)
                assert not gui.errors
                layout = {"state": state, "scale": scale, "tab": tab, "size": size}
                widgets = [
                    vars(w) | {"text_width": imgui.CalcTextSize(w.shown or w.label)[0]}
                    for w in gui.window.ui.widgets
                ]
                hidden, parts = dict(gui.window.ui.hidden_heights), asdict(gui.window.parts)
                recorded = {name: list(written) for name, written in texts.items()}
                yield layout | recorded | {"widgets": widgets, "hidden": hidden, "parts": parts}


def _use(gui):
    """Match, type, drag and pick; return values that show the effects, and errors."""
    session = gui.session
    session.editor.amend(parameters=QUICK)
    match(gui)
    gui.type("alpha", "10")
    gui.drag("time", 0.5)
    before = session.channels
    gui.pick(vertex=12, surface="target")
    return session.parameters.alpha, round(session.time, 1), session.channels != before, gui.errors


def main():
    quantities.TEXELS = 128  # nothing is drawn
    texts = {"lines": _recorded("line"), "notes": _recorded("note")}
    found = []
    for size in SCALES:
        with Driver(EGG, backend="openGL_mock", size=size) as gui:
            found += _layouts(gui, size, texts)
    with Driver(EGG, backend="openGL_mock", size=(1280, 800)) as gui:
        json.dump({"layouts": found, "used": _use(gui)}, sys.stdout, default=vars)


# Requirements of layouts


@pytest.fixture(scope="module")
def printed():
    root = Path(__file__).parents[3]
    done = run(sys.executable, "-m", "tests.viewer.panels.test_layouts", cwd=root)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def layouts(printed):
    """Return the window's widgets at every size and scale, in every state and tab."""
    return printed["layouts"]


@pytest.fixture
def drawn(layouts):
    return [(widget, layout, where(layout)) for layout in layouts for widget in layout["widgets"]]


def where(layout):
    width, height = layout["size"]
    return f"{layout['tab']}, {layout['state']}, {width}x{height} at scale {layout['scale']:g}"


def overlaps(parts):
    """Yield pairs of items whose visible parts overlap, and by how much."""
    seen = []
    for part in parts:
        (left, top, right, bottom), area = part["rect"], part["area"]
        left, top = max(left, area[0]), max(top, area[1])
        right, bottom = min(right, area[2]), min(bottom, area[3])
        if left < right and top < bottom:  # other widgets are visible after scrolling
            seen.append((part, (left, top, right, bottom)))
    for (one, a), (other, b) in combinations(seen, 2):
        yield one, other, min(min(a[2], b[2]) - max(a[0], b[0]), min(a[3], b[3]) - max(a[1], b[1]))


def test_mock_backend_only_lacks_pictures(printed):
    """In a separate process, the Driver works with the mock backend, except for pictures."""
    assert printed["used"] == [10.0, 0.5, True, {}]


def test_each_tab_fits_one_screen(layouts):
    shown = [layout for layout in layouts if layout["size"] == [1280, 800] and layout["scale"] == 1]
    for layout in (layout for layout in shown if layout["state"] != LONGEST):
        ends = f"/{layout['tab']}"
        hidden = [height for name, height in layout["hidden"].items() if name.endswith(ends)]
        assert hidden == [0], where(layout)
    assert {layout["tab"] for layout in shown} == {"Functions", "Match", "Look", "Export"}


def test_no_widget_is_cut_off_at_the_side(layouts):
    for layout in layouts:
        left, _, right, _ = layout["parts"]["scene"]
        assert right - left > layout["size"][0] / 2, where(layout)
        for part in (*layout["widgets"], *layout["lines"]):
            (left, _, right, _), (start, _, end, _) = part["rect"], part["area"]
            what = f"{part.get('label') or part['text']!r}: {where(layout)}"
            assert start - _ROUNDING <= left <= right <= end + _ROUNDING, what


def test_widgets_outside_of_scrolling_parts_are_visible(drawn):
    sliders = 0
    for widget, layout, place in drawn:
        inside = widget["section"].split("/")[0]
        if inside == "steps" and layout["hidden"]["panel"] and layout["scale"] > 1:
            continue
        (left, top, right, bottom), (_, first, _, last) = widget["rect"], widget["area"]
        if inside in ("time bar", "steps") or widget["label"] in ("Match", "Pause", "Cancel"):
            assert first <= top < bottom <= last, f"{widget['label']!r}: {place}"
        if (widget["kind"], widget["section"], widget["label"]) == ("slider", "time bar", "time"):
            assert right - left > 60 * layout["scale"], place
            sliders += 1
    assert sliders == len({place for *_, place in drawn})


def test_abbreviated_texts_have_a_tooltip(drawn):
    for widget, layout, place in drawn:
        is_cut = widget["shown"] not in ("", widget["label"])
        is_narrow = layout["size"][0] < 1000 * layout["scale"]
        assert not is_cut or is_narrow, f"{widget['label']!r}: {place}"
        if (widget["kind"], widget["label"]) == ("button", "Match"):
            assert widget["shown"].startswith(("Match", "Continue")), place
        assert not is_cut or widget["label"] != "Place landmarks", place
        if widget["kind"] in ("button", "tab", "checkbox", "choice", "section"):
            width = widget["rect"][2] - widget["rect"][0]
            assert widget["text_width"] <= width + _ROUNDING, f"{widget['label']!r}: {place}"
            if is_cut:
                assert widget["shown"].endswith("...")
                assert widget["tip"].startswith(widget["label"]), place


def test_lines_are_complete_in_wide_windows(layouts):
    for layout in (each for each in layouts if each["size"][0] >= 1000 * each["scale"]):
        for line in layout["lines"]:
            width = line["rect"][2] - line["rect"][0]
            assert width >= line["text_width"] - _ROUNDING, f"{line['text']!r}: {where(layout)}"


def test_no_widget_or_text_covers_another(layouts):
    for layout in layouts:
        for one, other, over in overlaps(w for w in layout["widgets"] if w["kind"] != "menu"):
            # a dialog is in front of everything
            in_front = "A title" in (one["section"], other["section"])
            what = f"{one['label']!r} and {other['label']!r}: {where(layout)}"
            assert in_front or over <= _ROUNDING, what
        for one, other, over in overlaps(
            part for part in (*layout["notes"], *layout["lines"]) if part["text"]
        ):
            what = f"{one['text']!r} and {other['text']!r}: {where(layout)}"
            assert one["area"] != other["area"] or over <= _ROUNDING, what


def test_verdicts_are_never_clipped(layouts):
    facts = longest()
    expected = {facts.short_headline, facts.reason, *facts.warnings, f"advice: {facts.advice}"}
    for layout in (layout for layout in layouts if layout["state"] == LONGEST):
        notes = {note["text"].lower().removesuffix("."): note for note in layout["notes"]}
        assert expected <= notes.keys(), where(layout)
        for text in expected:
            (left, top, right, bottom), area = notes[text]["rect"], notes[text]["area"]
            assert area[0] <= left <= right <= area[2] + _ROUNDING, f"{text}: {where(layout)}"
            is_in_view = area[1] <= top < bottom <= area[3] + _ROUNDING
            scrolls = layout["hidden"]["panel"] > 0 and layout["scale"] > 1.5
            assert is_in_view or scrolls, f"{text}: {where(layout)}"


def test_headline_and_area_warning_have_one_line_each(layouts):
    facts = longest()
    for layout in (it for it in layouts if it["state"] == LONGEST and it["scale"] == 1):
        notes = {note["text"].lower().removesuffix("."): note for note in layout["notes"]}
        for note in (notes[facts.short_headline], notes[facts.warnings[0]]):
            left, _, right, _ = note["rect"]
            assert right - left >= note["text_width"] - _ROUNDING, where(layout)


def test_status_line_has_the_headline_or_the_verdict(layouts):
    facts = longest()
    for layout in (layout for layout in layouts if layout["state"] == LONGEST):
        lines = [line for line in layout["lines"] if line["area"] == layout["parts"]["status"]]
        allowed = facts.headline, facts.short_headline, str(facts.outcome)
        assert lines[0]["text"] in allowed, where(layout)
        for line in lines:
            (left, _, right, _) = line["rect"]
            assert right - left >= line["text_width"] - _ROUNDING, f"{line['text']}: {layout}"
        assert lines[0]["text"] == facts.headline or layout["scale"] > 1


def test_remedies_and_advice_are_visible(layouts):
    for layout in layouts:
        remedies = [widget for widget in layout["widgets"] if widget["section"] == "verdict"]
        are_there = layout["state"] in ("matched", "with a path", "exported", "question")
        assert bool(remedies) == are_there, where(layout)
        for widget in remedies:
            below = widget["rect"][3] - widget["area"][3]
            scrolls = layout["hidden"]["panel"] > 0 and layout["scale"] > 1.5
            assert below <= _ROUNDING or scrolls, f"{widget['label']!r}: {where(layout)}"
    advised = "Advice: smooth the functions, refine the mesh, or expect a partial match."
    for layout in (layout for layout in layouts if layout["state"] == "advised"):
        (advice,) = [note for note in layout["notes"] if note["text"].startswith("Advice: ")]
        (_, top, _, bottom), (_, first, _, last) = advice["rect"], advice["area"]
        scrolls = layout["hidden"]["panel"] > 0 and layout["scale"] > 1.5
        assert first <= top < bottom <= last + _ROUNDING or scrolls, where(layout)
        assert advice["text"] == advised


def test_widgets_do_not_move_between_states(drawn):
    first = {}
    for widget, layout, place in drawn:
        is_long = layout["state"] in LONG or layout["scale"] > 1
        if is_long and widget["rect"][0] >= layout["parts"]["panel"][0]:
            continue
        if widget["kind"] != "plot" and widget["section"] not in ("A title", "verdict"):
            left_top = widget["rect"][:2]
            key = tuple(widget[name] for name in ("section", "label", "name", "kind"))
            which = (*layout["size"], layout["scale"], layout["tab"], *key)
            before = first.setdefault(which, left_top)
            assert left_top == pytest.approx(before, abs=_ROUNDING), f"{key}: {place}"


def test_widgets_behind_a_dialog_are_disabled(drawn):
    kinds = ("slider", "box", "button", "checkbox", "combo")
    for widget, layout, place in drawn:
        if layout["state"] == "question" and widget["section"] != "A title":
            assert not widget["enabled"], f"{widget['label']!r}: {place}"
        if widget["section"].split("/")[0] == layout["tab"] and widget["kind"] in kinds:
            assert widget["tip"], f"{widget['label']!r}: {place}"


if __name__ == "__main__":
    main()
