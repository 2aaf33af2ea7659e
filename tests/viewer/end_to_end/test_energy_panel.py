"""The plot of the energy, earlier runs, and the table."""

from __future__ import annotations

import csv
import re

from abfm_viewer.panels.right_panel import STEPS


def test_it_grows_during_a_run_and_keeps_earlier_ones(matched):
    first = matched.session.document.runs
    assert len(first) == 1
    matched.click("Match", within=STEPS)
    assert "energy plot" in matched.labels()
    matched.click("Match")
    matched.wait(lambda s: s.solver.finished)
    assert len(matched.session.document.runs) == 2
    matched.check("previous runs", False)
    assert not matched.session.view.previous_runs
    matched.check("previous runs", True)
    matched.click("Clear previous")
    assert matched.session.document.runs == matched.session.document.runs[-1:]
    assert not matched.is_enabled("Clear previous")
    matched.key("ctrl+z")
    assert len(matched.session.document.runs) == 2


def test_hovering_shows_values(matched, monkeypatch):
    shown = []
    monkeypatch.setattr("polyscope.imgui.SetTooltip", shown.append)
    matched.frames(5)
    assert not shown
    matched.hover("energy plot")
    known = len(matched.session.result.energy_history)
    at = int(re.match(r"iteration (\d+)", shown[-1])[1])
    assert 0 < at < known - 1
    total, _, mismatch = matched.session.result.energy_history[at]
    assert f"{total:.4g}" in shown[-1]
    assert f"{mismatch:.4g}" in shown[-1]


def test_the_table_has_a_row_for_each_iteration(matched, tmp_path):
    matched.click("Export CSV...")
    matched.type("file name", "energies")
    path = tmp_path / "energies.csv"
    matched.wait(lambda _: path.exists(), 5)
    rows = list(csv.reader(path.read_text().splitlines()))
    assert len(rows) == 1 + len(matched.session.result.energy_history)
