import json
import statistics
from math import isfinite

import numpy as np
import pytest

from abfm import Parameters
from abfm.calculus.operators import l2_norm
from abfm.matching.objective.matching_energy import MatchingEnergy
from benchmarks import arrival, gradients, solver, window
from benchmarks.gradients import sphere_problem
from benchmarks.solver import COOLING, MULTIGRID, time_below
from benchmarks.watched import MISMATCH, watched_match
from tests.shapes import icosphere


def survives_json(report):
    return json.loads(json.dumps(report, allow_nan=False)) == report


def numbers(entry):
    if isinstance(entry, dict | list):
        parts = entry.values() if isinstance(entry, dict) else entry
        return [number for part in parts for number in numbers(part)]
    return [] if isinstance(entry, str) else [entry]


@pytest.fixture(scope="module")
def report():
    lines = []
    sizes = {"subdivision": 2, "subdivisions": (1, 2), "iterations": 40, "cosine_iterations": 20}
    found = solver.run(lines.append, solver.Settings(seconds=0.3, repeats=2, timings=2, **sizes))
    assert len(lines) == 7
    assert all(line and "\n" not in line for line in lines)
    return found


def test_report_is_complete(report):
    assert " ".join(report) == (
        "ratios lowest_energy paper_run seconds iterations_to_mismatch energy_after_iterations "
        "bracket_gradient settings machine"
    )
    assert survives_json(report)
    values = numbers({key: part for key, part in report.items() if key != "bracket_gradient"})
    assert len(values) > 30
    assert all(value is None or (np.isfinite(value) and value >= 0) for value in values)
    assert np.isfinite(numbers(report["bracket_gradient"])).all()
    for name in ("iterations_to_mismatch", "energy_after_iterations"):
        assert len(report[name]) == 2
    assert list(report["ratios"]["gradient_to_advection"]) == ["42", "162"]
    assert [row["substeps"] for row in report["bracket_gradient"]] == [1, 10, 40]


def test_baselines_lower_the_energy(report):
    problem = sphere_problem(2)
    start, _ = MatchingEnergy(problem)(np.zeros((len(problem.mesh.faces), 3)))
    assert max(report["lowest_energy"].values()) < start


def test_report_text_has_the_table_and_the_machine(report):
    lines = solver.report_text(report).splitlines()
    assert all(line.count("|") == 3 for line in lines[:-2])
    assert report["machine"]["numpy"] in lines[-1]
    ratios = report["ratios"] | {"paper_seconds_to_solver_seconds": None}
    assert "not reached" in solver.report_text(report | {"ratios": ratios})


def test_problem_has_the_stated_gaussians():
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


def test_watched_match_stops_below_an_energy():
    history = np.array([[0.1, 5.0], [0.2, 3.0], [0.4, 3.0], [0.9, 1.0]])
    assert [time_below(history, level) for level in (4.0, 3.0, 1.0)] == [0.2, 0.9, None]
    history = watched_match(sphere_problem(2, MULTIGRID), 60.0, energy=1e5).history
    assert history[-1, 1] < 1e5 <= history[-2, 1]


def test_iterations_are_similar_on_a_finer_mesh():
    """Iterations hardly depend on the mesh; more substeps improve the bracket gradient."""
    problems = [sphere_problem(size, COOLING) for size in (3, 4)]
    found = [watched_match(problem, mismatch=MISMATCH) for problem in problems]
    counts = [watched.iterations_to_mismatch for watched in found]
    assert max(counts) <= 1.25 * min(counts)
    one, ten, forty = gradients.cosines(problems[0], found[0].match.velocity[0])
    assert one["cosine"] < 0.5
    assert one["cosine"] == pytest.approx(one["completed_cosine"])
    assert ten["cosine"] < ten["completed_cosine"] < forty["completed_cosine"]
    assert forty["cosine"] > 0.95


def test_arrival_reports_each_mesh():
    lines = []
    report = arrival.run(lines.append, (3, 4))
    assert survives_json(report)
    assert [row["vertices"] for row in report["arrival"]] == [642, 2562]
    assert len(lines) == 2
    assert isfinite(report["growth"])
    table = arrival.report_text(report).splitlines()
    assert table[2].startswith("| 642 ")
    assert all(line.count("|") == table[0].count("|") for line in table[:4])


def test_cancelled_match_does_not_reach_the_mismatch():
    found = watched_match(arrival.gaussians(4))
    assert found.seconds_to_mismatch <= found.seconds
    assert found.match.mismatch <= MISMATCH
    found = watched_match(arrival.gaussians(3), 0.0)
    assert found.seconds_to_mismatch is None
    assert found.match.mismatch > 0.5


def test_window_reports_launch_throughput_and_frames(monkeypatch):
    monkeypatch.setattr(window, "_SIZE", (320, 240))
    quick = Parameters.of(iterations=10, refine=0)
    report = window.run(lambda line: None, (3,), parameters=quick, long=20, repeats=1)
    assert list(report) == ["launch", "throughput", "frames", "settings"]
    assert survives_json(report)
    launch, [through] = report["launch"], report["throughput"]
    assert through["vertices"] == len(icosphere(3).vertices)
    seconds, rates = launch["seconds"], through["iterations_per_second"]
    for ratio, times, first, second in (
        (launch["ratio"], seconds, "app", "polyscope"),
        (through["ratio"], rates, "with window", "abfm.match"),
    ):
        assert ratio == statistics.median(times[first]) / statistics.median(times[second]) > 0
    for frames in (report["frames"], through["frames"]):
        assert frames["count"] > 0
        assert 0 < frames["median"] <= frames["p95"]
    rows = window.report_text(report).splitlines()[:-2]
    assert len(rows) == 2 + 3
    assert all(row.count("|") == 4 for row in rows)
