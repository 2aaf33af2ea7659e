"""How soon matches arrive: the report is whole, and counts only what happens on the mesh itself."""

from __future__ import annotations

import json
from math import inf, isfinite

from abfm.parameters import Parameters
from laboratory.arrival import format_arrival, gaussians, run_arrival
from laboratory.success import BEFORE
from laboratory.watched import watched_match


def test_report_is_whole_and_survives_json() -> None:
    told: list[str] = []
    report = run_arrival(told.append, (2, 3))
    assert json.loads(json.dumps(report, allow_nan=False)) == report
    assert [row["vertices"] for row in report["arrival"]] == [162, 642]
    assert len(told) == 4
    assert isfinite(report["growth"])
    table = format_arrival(report).splitlines()
    assert table[2].startswith("| 162 |")
    assert all(line.count("|") == table[0].count("|") for line in table[:4])


def test_a_solver_that_is_cancelled_did_not_arrive() -> None:
    found = watched_match(gaussians(3, BEFORE), 0.0)
    assert found.to_level == inf
    assert found.found.mismatch > 0.5


def test_the_level_is_met_before_the_end() -> None:
    found = watched_match(gaussians(4, Parameters()))
    assert found.to_level <= found.to_end
    assert found.found.mismatch <= 0.05
