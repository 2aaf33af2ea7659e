"""The benchmark on small meshes and little time: its report is whole, and what does not depend
on time is right.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from abfm.calculus.operators import l2_norm
from abfm.matching.objective.matching_energy import MatchingEnergy
from laboratory import Settings, cosine_table, cosines, format_report, markdown_table, run
from laboratory.problem import COOLED, sphere_problem
from laboratory.race import SOLVER, time_below
from laboratory.watched import LEVEL, watched_match


def numbers(entry: Any) -> Iterator[float]:
    if isinstance(entry, dict):
        entry = list(entry.values())
    if isinstance(entry, list):
        for part in entry:
            yield from numbers(part)
    elif not isinstance(entry, str):
        yield entry


@pytest.fixture(scope="module")
def report() -> dict[str, Any]:
    told: list[str] = []
    sizes = {"subdivision": 2, "subdivisions": (1, 2), "iterations": 40, "cosine_iterations": 20}
    found = run(told.append, Settings(seconds=1, repeats=2, timings=2, **sizes))
    assert len(told) == 7
    assert all(line and "\n" not in line for line in told)
    return found


def test_report_is_whole_and_survives_json(report: dict[str, Any]) -> None:
    assert " ".join(report) == (
        "ratios lowest_energy paper_run seconds iterations_to_mismatch energy_after_iterations "
        "bracket_gradient settings machine"
    )
    assert json.loads(json.dumps(report, allow_nan=False)) == report


def test_report_has_only_finite_numbers_not_below_zero(report: dict[str, Any]) -> None:
    values = [
        value
        for key, part in report.items()
        if key != "bracket_gradient"
        for value in numbers(part)
    ]
    assert len(values) > 30
    assert all(value is None or (np.isfinite(value) and value >= 0) for value in values)
    assert all(np.isfinite(value) for value in numbers(report["bracket_gradient"]))


def test_report_covers_every_mesh_and_number_of_substeps(report: dict[str, Any]) -> None:
    sizes = ["42", "162"]
    assert list(report["ratios"]["gradient_to_advection"]) == sizes
    assert list(report["iterations_to_mismatch"]["default_cooling"]) == sizes
    assert list(report["energy_after_iterations"]) == sizes
    assert [row["substeps"] for row in report["bracket_gradient"]] == [1, 10, 40]


def test_both_baselines_go_down(report: dict[str, Any]) -> None:
    problem = sphere_problem(2)
    start, _ = MatchingEnergy(problem)(np.zeros((len(problem.mesh.faces), 3)))
    assert report["lowest_energy"]["paper"] < start
    assert report["lowest_energy"]["plain"] < start


def test_readers_get_the_same_rows_as_text_and_as_markdown(report: dict[str, Any]) -> None:
    text, table = format_report(report).splitlines(), markdown_table(report).splitlines()
    assert len(table) == len(text) + 2
    assert all(line.count("|") == 3 for line in table[:-2])
    assert text[-1] == table[-1]
    assert report["machine"]["numpy"] in text[-1]


def test_a_level_that_is_not_reached_is_said(report: dict[str, Any]) -> None:
    ratios = report["ratios"] | {"paper_seconds_to_solver_seconds": None}
    assert "not reached" in format_report(report | {"ratios": ratios})


def test_the_problem_has_the_stated_bumps() -> None:
    problem = sphere_problem(4)
    scale, source, target = problem.mesh.length_scale, problem.source[:, 0], problem.target[:, 0]
    for function, count, width in ((source, 1, 0.12), (target, 2, 0.06)):
        squared = l2_norm(problem.mesh, function) ** 2 / scale**2
        # curvature 4 pi at unit area
        on_sphere = count * np.pi * width**2 * (1 - 4 * np.pi * width**2 / 6)
        assert squared == pytest.approx(on_sphere, rel=0.01)
    angles = np.arctan2(problem.mesh.vertices[:, 1], problem.mesh.vertices[:, 0])
    assert abs(abs(angles[target.argmax()]) - 1.0) < 0.1
    assert abs(angles[source.argmax()]) < 0.1


def test_time_below_is_the_first_time() -> None:
    history = np.array([[0.1, 5.0], [0.2, 3.0], [0.4, 3.0], [0.9, 1.0]])
    assert time_below(history, 4.0) == 0.2
    assert time_below(history, 3.0) == 0.9
    assert time_below(history, 1.0) is None


def test_a_watched_match_stops_below_the_level() -> None:
    history = watched_match(sphere_problem(2, SOLVER), 60.0, energy=1e5).history
    assert history[-1, 1] < 1e5 <= history[-2, 1]


def test_iterations_hardly_depend_on_the_mesh() -> None:
    coarse, fine = (
        watched_match(sphere_problem(s, COOLED), mismatch=LEVEL).iterations_to_level for s in (3, 4)
    )
    assert coarse is not None
    assert fine is not None
    assert max(coarse, fine) <= 1.25 * min(coarse, fine)


def test_more_substeps_and_the_dropped_factor_bring_the_bracket_gradient_closer() -> None:
    problem = sphere_problem(3, COOLED)
    one, ten, forty = cosines(problem, watched_match(problem, mismatch=LEVEL).found.velocity[0])
    assert one["cosine"] < 0.5
    assert one["cosine"] == pytest.approx(one["completed_cosine"])
    assert ten["cosine"] < ten["completed_cosine"] < forty["completed_cosine"]
    assert forty["cosine"] > 0.95


def test_cosine_table_has_a_row_for_each_number_of_substeps() -> None:
    lines = cosine_table(subdivision=1, iterations=2, substeps=(2, 3)).splitlines()
    assert [line.split()[1] for line in lines[2:]] == ["2", "3"]
    assert len({line.count("|") for line in lines}) == 1
