import json
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from abfm import Parameters, Problem, TriangleMesh
from abfm.batch import Ledger, problem_row
from abfm.batch import ledger as ledgers
from abfm.batch.attempt import WorkItem, attempt
from abfm.calculus.geodesics import geodesic_distance
from abfm.workers import Control
from benchmarks import success
from benchmarks.success import GOAL, record_of
from benchmarks.trials import Trials
from tests.shapes import icosphere, square

SHORT_RUN = {"iterations": 15, "refine": 0}
BALL = icosphere(2)
TRIALS = Trials({"ball": BALL}, count=2)


def run(*given, **changes):
    return success.run(replace(TRIALS, **changes), *given, **SHORT_RUN)


@pytest.fixture(scope="module")
def lines():
    return []


@pytest.fixture(scope="module")
def report(lines, tmp_path_factory):
    return run(log=lines.append, folder=tmp_path_factory.mktemp("report"))


def problems(count, seed=0, **meshes):
    return list(success.success_problems(meshes, seed, count))


def described(problems):
    return [problem.to_dict() for problem in problems]


def test_problems_do_not_depend_on_other_meshes():
    alone = described(problems(6, ball=BALL))
    together = described(problems(8, square=square(6), ball=BALL))
    assert alone == [each for each in together if each["mesh"] == "ball" and each["index"] < 6]
    assert alone != described(problems(6, seed=1, ball=BALL))
    assert alone != described(problems(6, other=BALL))


def test_problems_are_of_all_kinds():
    drawn = problems(90, ball=BALL)
    assert {problem.family for problem in drawn} == set(success.FAMILIES)
    families = ("gaussian", "one to two", "disc")
    placed = {(p.family, p.distance, p.width) for p in drawn if p.family in families}
    assert placed == set(product(families, success.DISTANCES, success.WIDTHS))
    others = [problem for problem in drawn if problem.family not in families]
    assert all(p.distance is None and p.width is None for p in others)


def test_targets_have_their_distances():
    mesh = icosphere(3)  # fine enough for a vertex in every range
    gaussians = [p for p in problems(20, ball=mesh) if p.family == "gaussian"]
    assert len(gaussians) == 8
    for problem in gaussians:
        here, there = (int(np.argmax(values)) for values in problem.functions())
        distances = geodesic_distance(mesh, [here])
        low, high = success.DISTANCES[problem.distance]
        assert low <= distances[there] / distances.max() <= high


def test_problems_by_descriptors_need_mirror_symmetry():
    x, y, z = BALL.vertices.T
    factors = (1 + 0.3 * np.sin(x + 2 * y + 0.5 * z))[:, None] * [1, 0.8, 0.6]
    uneven = TriangleMesh(BALL.vertices * factors, BALL.faces)
    families = [problem.family for problem in problems(10, uneven=uneven)]
    assert "descriptor" not in families
    assert len(families) == 9


def tried(folder, parameters, source, target, mesh=BALL):
    """Solve a problem in this process, and return its record."""
    ledger = Ledger(folder)
    row = problem_row(Problem(mesh, source, target, parameters), folder)
    attempt(WorkItem(row, folder, ledger.make()))
    return record_of(ledger.entry(row))


def test_record_is_the_same_in_every_run_except_seconds(tmp_path):
    places = ("gaussian:vertex=0,width=0.2", "gaussian:vertex=12,width=0.2")
    record, again = (tried(tmp_path / name, Parameters.of(refine=0), *places) for name in "ab")
    assert record["residual"] <= GOAL
    assert record["evaluations"] >= record["iterations"] > 0
    assert record["row_products"] > record["evaluations"] > 0
    assert record["seconds"] > 0
    assert again | {"seconds": record["seconds"]} == record


def test_jumps_are_not_confirmed_on_finer_meshes(tmp_path):
    places = "indicator:vertex=1,radius=0.4", "indicator:vertex=31,radius=0.4"
    loose = TriangleMesh([*BALL.vertices[:1] + 9, *BALL.vertices], BALL.faces + 1)
    records = [tried(tmp_path, Parameters(), *places, mesh) for mesh in (loose, BALL)]
    for record in records:
        assert record["verified"] > GOAL
        assert not record["success"]
        assert record["refined"] == 0


def test_failures_are_recorded(tmp_path):
    ledger = Ledger(tmp_path)
    ledger.make()
    row = problem_row(Problem(BALL, "coordinate:x", "coordinate:y"), tmp_path)
    record = record_of(ledger.record(row, ledgers.Record(reason="out of memory")))
    assert record["stop_reason"] == "out of memory"
    assert record["residual"] is record["seconds"] is None
    assert not record["success"]
    assert not record["confirmed"]


def test_only_solvable_problems_are_solved(tmp_path):
    changes = {"count": 9, "folder": tmp_path}
    every, some = ([row["problem"] for row in run(only, **changes)["rows"]] for only in (0, 1))
    assert some == [problem for problem in every if problem["solvable"]]
    assert 0 < len(some) < len(every)


def test_report_is_complete_and_each_problem_is_printed(report, lines):
    assert json.loads(json.dumps(report, allow_nan=False)) == report
    assert list(report) == ["rows", "interrupted", "settings", "machine"]
    assert not report["interrupted"]
    assert len(report["rows"]) == 2
    for row in report["rows"]:
        assert list(row) == ["problem", "result"]
        problem = "mesh folder index family width distance source target resolved solvable"
        assert set(problem.split()) <= row["problem"].keys()
        found = "residual verified folded row_products seconds refined stop_reason verdict"
        assert set(found.split()) <= row["result"].keys()
    assert report["settings"]["meshes"] == {"ball": 162}
    assert [line.split()[0] for line in lines] == ["preparing", "1/2", "2/2"]


def row(problem, **result):
    kind = dict.fromkeys(("folder", "resolved", "solvable", "distance", "width", "family"))
    return {"problem": kind | problem, "result": result}


def test_table_has_a_row_for_each_group():
    machine = ("processor", "cores", "system", "python", "numpy", "scipy", "numba")
    fine = {"residual": 0.01, "verified": 0.02, "folded": 0.0, "success": True, "confirmed": True}
    bad = {"residual": None, "verified": None, "folded": None, "success": False, "confirmed": False}
    far = {"folder": "men", "solvable": True, "distance": "far", "width": 0.1, "family": "gaussian"}
    rows = [
        row(far, refined=1, row_products=120, seconds=8.0, **fine),
        row({"family": "eigenfunction"}, refined=0, row_products=20, seconds=1.0, **bad),
    ]
    settings = {"meshes": {"ball": 162}, "seed": 0}
    report = {"rows": rows, "settings": settings, "machine": dict.fromkeys(machine, "x")}
    table = [
        [cell.strip() for cell in line.strip("| ").split("|")]
        for line in success.report_text(report).splitlines()
        if line.startswith("|")
    ]
    cells = {line[0]: line[1:] for line in table}
    assert " | ".join(cells["all"]) == "1 of 2 | 1 of 2 | none | none | 50% | 1 of 2 | 70 | 4.5"
    gaussian = "1 of 1 | 1 of 1 | 0.01 | 0.02 | 100% | 1 of 1 | 1.2e+02 | 8"
    for name in ("far", "0.1", "gaussian", "solvable, gaussian, far", "men", "men, solvable"):
        assert " | ".join(cells[name]) == gaussian
    assert cells["eigenfunction"][0] == "0 of 1"
    assert "resolved" not in cells


def test_stopped_run_keeps_finished_problems_and_resumes(report, tmp_path):
    control, lines = Control(), []

    def log(line):
        lines.append(line.split()[0])
        if line.startswith("1/2"):
            control.cancel()

    part = run(log=log, folder=tmp_path, control=control)
    assert part["interrupted"]
    assert [row["problem"] for row in part["rows"]] == [report["rows"][0]["problem"]]
    assert lines == ["preparing", "1/2"]
    assert "1 problems" in success.report_text(part)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.glob("*.npz")}
    complete = run(folder=tmp_path)
    assert not complete["interrupted"]
    assert before.items() <= {p: p.stat().st_mtime_ns for p in tmp_path.glob("*.npz")}.items()
    assert complete["rows"][0] == part["rows"][0]  # its seconds are read from the ledger
    at_once = run(control=control)
    assert at_once["rows"] == []
    assert "0 of 0" in success.report_text(at_once)
