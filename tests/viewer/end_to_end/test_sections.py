"""Sections are closed and opened by their titles."""

from __future__ import annotations

from tests.viewer.end_to_end.test_errors import SECTIONS


def test_every_section_is_closed_and_opened(gui):
    for section in (*SECTIONS, "Advanced"):
        before = gui.text_of(section, kind="section")
        gui.click(section)
        assert gui.text_of(section, kind="section") == {"open": "closed", "closed": "open"}[before]
        gui.click(section)
        assert gui.text_of(section, kind="section") == before
