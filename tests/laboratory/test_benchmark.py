"""The benchmarks on small meshes and little time: their reports are whole, and what does not depend
on time is right.
"""

import json
import statistics
from math import inf, isfinite

import numpy as np
import pytest

import laboratory
from abfm.calculus.operators import l2_norm
from abfm.matching.objective.matching_energy import MatchingEnergy
from abfm.parameters import Parameters
from laboratory.arrival import gaussians
from laboratory.benchmark import SOLVER, time_below
from laboratory.common import COOLED, LEVEL, sphere_problem, watched_match
from laboratory.success import BEFORE


def survives_json(report):
    return json.loads(json.dumps(report, allow_nan=False)) == report


def numbers(entry):
    if isinstance(entry, dict | list):
        parts = entry.values() if isinstance(entry, dict) else entry
        return [number for part in parts for number in numbers(part)]
    return [] if isinstance(entry, str) else [entry]


@pytest.fixture(scope="module")
def report():
    told = []
    sizes = {"subdivision": 2, "subdivisions": (1, 2), "iterations": 40, "cosine_iterations": 20}
    settings = laboratory.Settings(seconds=1, repeats=2, timings=2, **sizes)
    found = laboratory.run(told.append, settings)
    assert len(told) == 7
    assert all(line and "\n" not in line for line in told)
    return found


def test_report_is_whole_and_has_only_finite_numbers_not_below_zero(report):
    assert " ".join(report) == (
        "ratios lowest_energy paper_run seconds iterations_to_mismatch energy_after_iterations "
        "bracket_gradient settings machine"
    )
    assert survives_json(report)
    parts = {key: part for key, part in report.items() if key != "bracket_gradient"}
    values = numbers(parts)
    assert len(values) > 30
    assert all(value is None or (np.isfinite(value) and value >= 0) for value in values)
    assert np.isfinite(numbers(report["bracket_gradient"])).all()


def test_report_covers_every_mesh_and_number_of_substeps_and_baselines_go_down(report):
    sizes = ["42", "162"]
    assert list(report["ratios"]["gradient_to_advection"]) == sizes
    assert list(report["iterations_to_mismatch"]["default_cooling"]) == sizes
    assert list(report["energy_after_iterations"]) == sizes
    assert [row["substeps"] for row in report["bracket_gradient"]] == [1, 10, 40]
    problem = sphere_problem(2)
    start, _ = MatchingEnergy(problem)(np.zeros((len(problem.mesh.faces), 3)))
    assert max(report["lowest_energy"][name] for name in ("paper", "plain")) < start


def test_readers_get_the_same_rows_as_text_and_as_markdown(report):
    text = laboratory.format_report(report).splitlines()
    table = laboratory.markdown_table(report).splitlines()
    assert len(table) == len(text) + 2
    assert all(line.count("|") == 3 for line in table[:-2])
    assert text[-1] == table[-1]
    assert report["machine"]["numpy"] in text[-1]
    ratios = report["ratios"] | {"paper_seconds_to_solver_seconds": None}
    assert "not reached" in laboratory.format_report(report | {"ratios": ratios})


def test_the_problem_has_the_stated_bumps():
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


def test_time_below_is_the_first_time_and_a_watched_match_stops_there():
    history = np.array([[0.1, 5.0], [0.2, 3.0], [0.4, 3.0], [0.9, 1.0]])
    assert [time_below(history, level) for level in (4.0, 3.0, 1.0)] == [0.2, 0.9, None]
    history = watched_match(sphere_problem(2, SOLVER), 60.0, energy=1e5).history
    assert history[-1, 1] < 1e5 <= history[-2, 1]


def test_iterations_hardly_depend_on_the_mesh_and_more_substeps_bring_the_bracket_closer():
    problems = [sphere_problem(size, COOLED) for size in (3, 4)]
    found = [watched_match(problem, mismatch=LEVEL) for problem in problems]
    counts = [watched.iterations_to_level for watched in found]
    assert max(counts) <= 1.25 * min(counts)
    one, ten, forty = laboratory.cosines(problems[0], found[0].found.velocity[0])
    assert one["cosine"] < 0.5
    assert one["cosine"] == pytest.approx(one["completed_cosine"])
    assert ten["cosine"] < ten["completed_cosine"] < forty["completed_cosine"]
    assert forty["cosine"] > 0.95


def test_cosine_table_has_a_row_for_each_number_of_substeps():
    lines = laboratory.cosine_table(subdivision=1, iterations=2, substeps=(2, 3)).splitlines()
    assert [line.split()[1] for line in lines[2:]] == ["2", "3"]
    assert len({line.count("|") for line in lines}) == 1


def test_the_report_of_arrivals_is_whole_and_survives_json():
    told = []
    report = laboratory.run_arrival(told.append, (2, 3))
    assert survives_json(report)
    assert [row["vertices"] for row in report["arrival"]] == [162, 642]
    assert len(told) == 4
    assert isfinite(report["growth"])
    table = laboratory.format_arrival(report).splitlines()
    assert table[2].startswith("| 162 |")
    assert all(line.count("|") == table[0].count("|") for line in table[:4])


def test_the_level_is_met_before_the_end_and_a_solver_that_is_cancelled_did_not_arrive():
    found = watched_match(gaussians(4, Parameters()))
    assert found.to_level <= found.to_end
    assert found.found.mismatch <= 0.05
    found = watched_match(gaussians(3, BEFORE), 0.0)
    assert found.to_level == inf
    assert found.found.mismatch > 0.5


def test_the_windows_benchmark(monkeypatch):
    monkeypatch.setattr(laboratory.window, "_SIZE", (320, 240))
    quick = Parameters.of(iterations=10, refine=0)
    report = laboratory.window.run(lambda line: None, (3,), parameters=quick, long=20, repeats=1)
    assert list(report) == ["launch", "throughput", "frames", "settings"]
    assert survives_json(report)
    launch, [through] = report["launch"], report["throughput"]
    assert through["vertices"] == 642
    seconds, rates = launch["seconds"], through["iterations_per_second"]
    for ratio, times, first, second in (
        (launch["ratio"], seconds, "app", "bare polyscope"),
        (through["ratio"], rates, "with window", "abfm.match"),
    ):
        assert ratio == statistics.median(times[first]) / statistics.median(times[second]) > 0
    for frames in (report["frames"], through["frames"]):
        assert frames["count"] > 0
        assert 0 < frames["median"] <= frames["p95"]
    lines = laboratory.window.format_report(report).splitlines()
    assert [line.split()[0] for line in lines] == ["launch", "solver", "frames", "measured"]
    assert "642 vertices" in lines[1]
    rows = laboratory.window.window_table(report).splitlines()
    assert len(rows) == 2 + 3
    assert all(row.count("|") == 4 for row in rows)
