"""Search of actions: the order of the found entries."""

from dataclasses import replace

from abfm_viewer.dialogs.palette import Entry, matching
from abfm_viewer.widgets.widget_record import Widget
from abfm_viewer.window.search import entries

AREA = (0.0, 0.0, 1.0, 1.0)


def widget(label, section, kind="button", **details):
    return Widget(label, kind, AREA, AREA, section, details.pop("enabled", True), **details)


ALPHA = widget("smoothness α", "Match", "box", name="alpha")
WIDGETS = [
    widget("Pause", "", enabled=False, tip="No match is running.\n\nPause it."),
    widget("alpha of a color", "Look"),
    ALPHA,
    replace(ALPHA, kind="slider"),
    widget("Match", "steps", "tab"),
    widget("?", "Match", name="Explain parameters"),
    widget("Quit", "File", "item", keys="Ctrl+Q"),
]


def test_widgets_become_entries_with_place_keys_and_reason():
    found = [each for each in entries(WIDGETS) if each.widget]
    assert [each.text for each in found] == [
        "Pause",
        "Look > alpha of a color",
        "Match > smoothness α (alpha)",
        "tab > Match",
        "File > Quit",
    ]
    assert [each.reason for each in found] == ["No match is running.", "", "", "", ""]
    assert found[-1].keys == "Ctrl+Q"
    assert Entry("residual", "Explain") in entries(WIDGETS)


def test_all_words_have_to_occur_in_any_order():
    found = entries(WIDGETS)
    assert [each.label for each in matching(found, "ALPHA match")] == ["smoothness α (alpha)"]
    assert matching(found, "no such action") == []
    assert matching(found, " ") == found


def test_labels_that_begin_with_the_query_are_first():
    named = [Entry("remove all", "A"), Entry("Move", "B"), Entry("all moves", "move")]
    order = [each.label for each in matching([*named, Entry("Move", "C", reason="no")], "move")]
    assert order == ["Move", "remove all", "all moves", "Move"]


def test_actions_are_found_before_topics_of_help():
    first, *_, last = matching(entries(WIDGETS), "alpha")
    assert first.widget is not None
    assert last == Entry("alpha", "Explain")
