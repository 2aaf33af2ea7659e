"""Tabs and sections are opened and closed by their titles."""

from __future__ import annotations

from abfm_viewer.panels.right_panel import STEPS, TABS


def test_every_tab_is_opened(gui):
    for label in (*TABS, next(iter(TABS))):
        gui.click(label, within=STEPS)
        open_tabs = [w.label for w in gui.window.ui.widgets if w.kind == "tab" and w.text == "open"]
        assert open_tabs == [label]


def test_a_section_is_opened_and_closed(gui):
    for expected in ("open", "closed"):
        gui.click("Advanced")
        assert gui.text_of("Advanced", kind="section") == expected
