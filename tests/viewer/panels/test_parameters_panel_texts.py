"""The panel that shows all parameters."""

from __future__ import annotations

from dataclasses import fields

from abfm import Parameters
from abfm_viewer.panels import parameters as panel


def test_the_panel_has_every_parameter_and_says_what_it_does():
    numbers = [*panel._MODEL, *panel._WAY, panel._SEGMENTS, *panel._BRACKET, *panel._EFFORT, *panel._ADVANCED]
    names = [number.name for number in numbers] + list(panel._WORDS)
    assert sorted(names) == sorted(entry.name for entry in fields(Parameters))
    for number in numbers:
        tip = panel._tip(number.name, number.place, number.remedy)
        assert all(word in tip for word in ("Default", "paper", "Bad result?"))
        assert number.low <= getattr(Parameters(), number.name) <= number.high
