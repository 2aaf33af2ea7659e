"""The panel that shows all parameters."""

from __future__ import annotations

from dataclasses import fields

from abfm import Parameters
from abfm.parameters import CHOICES
from abfm_viewer.panels import parameters as panel


def test_the_panel_has_every_parameter_and_says_what_it_does():
    assert sorted(panel._ABOUT) == sorted(entry.name for entry in fields(Parameters))
    for name, about in panel._ABOUT.items():
        assert all(word in panel._tip(name) for word in ("Default", "paper", "Bad result?"))
        assert name in CHOICES or 0 <= about.slider.share_of(getattr(Parameters(), name)) <= 1
