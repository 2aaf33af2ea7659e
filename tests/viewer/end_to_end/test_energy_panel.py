"""The plot of the energy, earlier runs, and the table."""

from __future__ import annotations

import csv


def test_it_grows_during_a_run_and_keeps_earlier_ones(matched):
    first = matched.session.document.runs
    assert len(first) == 1
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


def test_hovering_shows_values(matched):
    matched.hover("energy plot")


def test_the_table_has_a_row_for_each_iteration(matched, tmp_path):
    matched.click("Export CSV...")
    matched.type("file name", "energies")
    path = tmp_path / "energies.csv"
    matched.wait(lambda _: path.exists(), 5)
    rows = list(csv.reader(path.open()))
    assert len(rows) == 1 + len(matched.session.result.energy_history)
