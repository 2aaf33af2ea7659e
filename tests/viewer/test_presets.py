"""The presets, and the panel that shows all parameters."""

from __future__ import annotations

from dataclasses import fields

import pytest

from abfm import Parameters
from abfm_viewer.panels import parameters as panel
from abfm_viewer.presets import PRESETS, preset_of
from tests.viewer.sessions import opened

TABLE_1 = """
Fig. 1  | 1  | 1    | 0    | 1e-2* | -  | 10
Fig. 3  | 2  | 1e+3 | 1e-5 | 1e-4  | -  | 40
Fig. 7  | 1  | 1e+3 | 0    | 1e-1* | 20 | -
Fig. 8  | 10 | 1e+3 | 0    | 1e-2* | -  | 200
Fig. 9  | 1  | 1    | 1e-4 | 5e-3  | -  | 20
Fig. 10 | 1  | 1e+3 | 0    | 1e-2* | -  | 20
Fig. 11 | 1  | 1    | 0    | 1e-2* | 10 | -
Fig. 12 | 1  | 1    | 0    | 1e-2* | 10 | -
"""


@pytest.mark.parametrize(("preset", "row"), list(zip(PRESETS, TABLE_1.strip().splitlines(), strict=True)))
def test_a_preset_is_its_row_of_table_1(preset, row):
    name, tau, alpha, beta, sigma, N, n = (cell.strip() for cell in row.split("|"))
    parameters = Parameters(**preset.values)
    assert preset.name == name
    assert (parameters.tau, parameters.alpha, parameters.beta) == (float(tau), float(alpha), float(beta))
    assert parameters.stage_sigmas()[0] == pytest.approx(float(sigma.strip("*")))
    assert parameters.cooling_stages == (3 if sigma.endswith("*") else 1)
    if n == "-":
        assert (parameters.method, parameters.segments) == ("linearised", int(N))
    else:
        assert (parameters.method, parameters.segments, parameters.substeps) == ("nonlinear", 1, int(n))


def test_a_preset_is_recognised_until_one_of_its_values_changes():
    session = opened()
    try:
        assert preset_of(session.parameters) is None
        for preset in PRESETS:
            session.set_parameter(**preset.values)
            assert preset_of(session.parameters).values == preset.values
            assert session.parameters.iterations == 20  # stays
        session.set_parameter(alpha=2.0)
        assert preset_of(session.parameters) is None
    finally:
        session.close()


def test_the_panel_has_every_parameter_and_says_what_it_does():
    numbers = [*panel._MODEL, panel._SEGMENTS, *panel._BRACKET, *panel._EFFORT, *panel._ADVANCED]
    names = [number.name for number in numbers] + list(panel._WORDS)
    assert sorted(names) == sorted(entry.name for entry in fields(Parameters))
    for number in numbers:
        tip = panel._tip(number.name, number.place, number.remedy)
        assert all(word in tip for word in ("Default", "paper", "Bad result?"))
        assert number.low <= getattr(Parameters(), number.name) <= number.high
