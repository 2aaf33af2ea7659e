"""The benchmark of successes on a small sphere: problems are fixed, the report is whole, the
table is right.
"""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from abfm import ParameterError, Parameters, TriangleMesh
from abfm.calculus.geodesics import geodesic_distance
from laboratory.success import (
    BEFORE,
    VERSIONS,
    Selection,
    Trial,
    format_success,
    merged,
    run_success,
    run_trial,
    success_problems,
    success_table,
)
from laboratory.success.problems import DISTANCES, FAMILIES, WIDTHS
from laboratory.watched import LEVEL
from tests.shapes import icosphere, square

SHORT = {name: replace(parameters, iterations=15) for name, parameters in VERSIONS.items()}


@pytest.fixture(scope="module")
def ball() -> TriangleMesh:
    return icosphere(2)


@pytest.fixture(scope="module")
def told() -> list[str]:
    return []


@pytest.fixture(scope="module")
def report(ball: TriangleMesh, told: list[str]) -> dict[str, Any]:
    return run_success({"ball": ball}, told.append, Selection(count=2), SHORT)


def described(problems: Any) -> list[dict[str, Any]]:
    return [problem.to_dict() for problem in problems]


def test_problems_are_the_same_whatever_else_is_drawn(ball: TriangleMesh) -> None:
    alone = described(success_problems({"ball": ball}, count=6))
    beside = described(success_problems({"square": square(6), "ball": ball}, count=8))
    assert alone == [
        problem for problem in beside if problem["mesh"] == "ball" and problem["index"] < 6
    ]
    assert alone != described(success_problems({"ball": ball}, seed=1, count=6))
    assert alone != described(success_problems({"other": ball}, count=6))


def test_ninety_problems_are_of_every_kind(ball: TriangleMesh) -> None:
    problems = list(success_problems({"ball": ball}, count=90))
    assert {problem.family for problem in problems} == set(FAMILIES)
    placed = [
        problem for problem in problems if problem.family in ("gaussian", "one to two", "disc")
    ]
    assert {(p.family, p.distance, p.width) for p in placed} == {
        (family, distance, width)
        for family in ("gaussian", "one to two", "disc")
        for distance in DISTANCES
        for width in WIDTHS
    }
    assert all(p.distance is None and p.width is None for p in problems if p not in placed)


def test_targets_are_as_far_as_they_say() -> None:
    mesh = icosphere(3)  # fine enough for a vertex in every range
    gaussians = [p for p in success_problems({"ball": mesh}, count=20) if p.family == "gaussian"]
    assert len(gaussians) == 8
    for problem in gaussians:
        here, there = (int(np.argmax(values)) for values in problem.functions())
        distances = geodesic_distance(mesh, [here])
        low, high = DISTANCES[problem.distance]
        assert low <= distances[there] / distances.max() <= high


def test_surfaces_without_a_mirror_have_no_descriptors(ball: TriangleMesh) -> None:
    x, y, z = ball.vertices.T
    uneven = TriangleMesh(
        ball.vertices * (1 + 0.3 * np.sin(x + 2 * y + 0.5 * z))[:, None] * [1, 0.8, 0.6], ball.faces
    )
    families = [problem.family for problem in success_problems({"uneven": uneven}, count=10)]
    assert "descriptor" not in families
    assert len(families) == 9


def test_before_is_the_solver_without_what_came_later() -> None:
    paper = {"reach": 0.0, "order": 1, "levels": 1, "balance": 0.0, "sigma_unit": "absolute"}
    assert paper.items() <= BEFORE.to_dict().items()
    assert list(VERSIONS) == ["before", "now"]
    assert VERSIONS["now"] == Parameters()


def test_record_says_what_came_out_and_what_it_cost(ball: TriangleMesh) -> None:
    problem = Trial(
        "ball", 0, ball, "gaussian", "gaussian:vertex=0,width=0.2", "gaussian:vertex=12,width=0.2"
    )
    record = run_trial(problem, BEFORE)
    assert record.mismatch <= LEVEL
    assert 0 < record.seconds_to_level <= record.seconds
    assert record.evaluations >= record.iterations > 0
    assert record.row_products % len(ball.vertices) == 0
    assert record.row_products > record.evaluations * len(ball.vertices)
    again = run_trial(problem, BEFORE)
    assert replace(again, seconds=0, seconds_to_level=0) == replace(
        record, seconds=0, seconds_to_level=0
    )
    hasty = run_trial(problem, BEFORE, limit=1e-9)
    assert hasty.stop_reason == "time limit"
    assert hasty.iterations == 0


@pytest.mark.filterwarnings("ignore:overflow")
def test_what_no_solver_takes_is_recorded_as_such(ball: TriangleMesh) -> None:
    problem = Trial("ball", 0, ball, "gaussian", "expression:1e200*x", "expression:1e200*y")
    record = run_trial(problem, BEFORE).to_dict()
    assert "whose squares over- or underflow" in record["stop_reason"]
    assert record["mismatch"] is None
    assert not record["success"]
    assert not record["confirmed"]


def test_report_is_whole_and_survives_json(report: dict[str, Any]) -> None:
    assert json.loads(json.dumps(report, allow_nan=False)) == report
    assert list(report) == ["rows", "interrupted", "settings", "machine"]
    assert not report["interrupted"]
    assert len(report["rows"]) == 2
    for row in report["rows"]:
        assert list(row) == ["problem", "before", "now"]
        problem = "mesh index family width distance source target resolved solvable"
        assert set(problem.split()) <= row["problem"].keys()
        found = "mismatch verified folded row_products seconds stop_reason verdict"
        assert set(found.split()) <= row["now"].keys()
    assert report["settings"]["meshes"] == {"ball": 162}


def test_progress_is_told_for_every_problem(report: dict[str, Any], told: list[str]) -> None:
    assert [line.split()[0] for line in told] == ["compiling", "1/2", "2/2"]
    assert all("before" in line and "now" in line for line in told[1:])


def test_parts_and_their_reports_put_together_are_the_whole(
    ball: TriangleMesh, report: dict[str, Any]
) -> None:
    parts = [
        run_success({"ball": ball}, selection=Selection(count=2, part=(k, 2)), versions=SHORT)
        for k in (1, 2)
    ]
    whole = merged(parts)
    assert [row["problem"] for row in whole["rows"]] == [row["problem"] for row in report["rows"]]
    assert [row["now"]["mismatch"] for row in whole["rows"]] == [
        row["now"]["mismatch"] for row in report["rows"]
    ]
    other = run_success({"ball": ball}, selection=Selection(count=1, seed=1), versions=SHORT)
    with pytest.raises(ParameterError, match="different seed"):
        merged([report, other])
    with pytest.raises(ParameterError, match="at least one"):
        merged([])


def test_table_has_a_row_for_every_group() -> None:
    outcome = ("success", "confirmed", "mismatch", "verified", "folded", "seconds", "row_products")
    slow, now, bad = (
        dict(zip(outcome, values, strict=True))
        for values in (
            (True, True, 0.01, 0.02, 0.0, 4.0, 60),
            (True, True, 0.01, 0.02, 0.0, 1.0, 20),
            (False, False, None, None, None, 3.0, 10),
        )
    )
    kind = ("resolved", "solvable", "distance", "width", "family")
    far, other = (
        dict(zip(kind, values, strict=True))
        for values in (
            (True, True, "far", 0.1, "gaussian"),
            (False, False, None, None, "eigenfunction"),
        )
    )
    made = {
        "rows": [
            {"problem": far, "before": slow, "now": now},
            {"problem": other, "before": bad, "now": now},
        ],
        "settings": {"versions": {"before": {}, "now": {}}, "meshes": {"ball": 162}, "seed": 0},
        "machine": dict.fromkeys(
            ("processor", "cores", "system", "python", "numpy", "scipy", "numba"), "x"
        ),
    }
    lines = [
        [cell.strip() for cell in line.strip("| ").split("|")]
        for line in success_table(made).splitlines()
    ]
    rows = {line[0]: line[1:] for line in lines if len(line) > 2}
    assert " | ".join(rows) == (
        "problems | --- | all | resolved | distance far | width 0.1 | gaussian | eigenfunction | "
        "solvable | solvable, resolved | solvable, far"
    )
    assert " | ".join(rows["all"]) == (
        "1 → 2 of 2 | 1 → 1 of 1 | none → 0.01 | none → 0.02 | 50% → 100% | 3 | 4"
    )
    assert " | ".join(rows["eigenfunction"]) == (
        "0 → 1 of 1 | 0 → 0 of 0 | none → 0.01 | none → 0.02 | 0% → 100% | none | none"
    )
    text = format_success(made)
    assert all(name in text for name in ("distance far", "7 s → 2 s in all"))


def test_what_was_finished_is_kept_when_it_is_stopped(ball: TriangleMesh) -> None:
    told: list[str] = []
    report = run_success(
        {"ball": ball}, told.append, Selection(count=2), SHORT, stopped=lambda: len(told) == 2
    )
    assert report["interrupted"]
    assert len(report["rows"]) == 1
    assert told[1].startswith("1/2 ")
    assert "1 problems" in format_success(report)


def test_a_match_that_is_stopped_ends_at_once(ball: TriangleMesh) -> None:
    told: list[str] = []
    report = run_success(
        {"ball": ball}, told.append, Selection(count=1), SHORT, stopped=lambda: True
    )
    assert (report["interrupted"], report["rows"], told) == (True, [], ["compiling"])
    assert "0 of 0" in format_success(report)
