"""Texts as sentences."""

from __future__ import annotations

from abfm_viewer.document.verdict_words import capital, sentence


def test_only_the_first_letter_changes():
    assert capital("opening Bear.OFF") == "Opening Bear.OFF"
    assert sentence("the target is constant, ||g|| = 0") == "The target is constant, ||g|| = 0."
    assert capital("") == ""
