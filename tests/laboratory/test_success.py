"""The benchmark of successes: problems are fixed, the report is whole, the table is right."""

import json
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from abfm import Control, ParameterError, Parameters, Problem, TriangleMesh
from abfm.batch import Ledger, problem_row
from abfm.batch import ledger as ledgers
from abfm.batch.attempt import Task, attempt
from abfm.calculus.geodesics import geodesic_distance
from laboratory import success
from laboratory.common import LEVEL
from laboratory.success import (
    BEFORE,
    VERSIONS,
    Record,
    Selection,
    record_of,
    run_success,
)
from laboratory.trials import Place
from tests.messages import raises
from tests.shapes import icosphere, square

SHORT = {name: each.with_values(iterations=15, refine=0) for name, each in VERSIONS.items()}
BALL = icosphere(2)


@pytest.fixture(scope="module")
def told():
    return []


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """What is solved for the report."""
    return tmp_path_factory.mktemp("report")


@pytest.fixture(scope="module")
def report(told, folder):
    return run_success({"ball": BALL}, told.append, Selection(count=2), SHORT, Place(folder))


def problems(count, seed=0, **meshes):
    return list(success.success_problems(meshes, seed, count))


def described(problems):
    return [problem.to_dict() for problem in problems]


def test_problems_are_the_same_whatever_else_is_drawn():
    alone = described(problems(6, ball=BALL))
    beside = described(problems(8, square=square(6), ball=BALL))
    assert alone == [each for each in beside if each["mesh"] == "ball" and each["index"] < 6]
    assert alone != described(problems(6, seed=1, ball=BALL))
    assert alone != described(problems(6, other=BALL))


def test_ninety_problems_are_of_every_kind():
    drawn = problems(90, ball=BALL)
    assert {problem.family for problem in drawn} == set(success.FAMILIES)
    families = ("gaussian", "one to two", "disc")
    placed = {(p.family, p.distance, p.width) for p in drawn if p.family in families}
    assert placed == set(product(families, success.DISTANCES, success.WIDTHS))
    others = [problem for problem in drawn if problem.family not in families]
    assert all(p.distance is None and p.width is None for p in others)


def test_targets_are_as_far_as_they_say():
    mesh = icosphere(3)  # fine enough for a vertex in every range
    gaussians = [p for p in problems(20, ball=mesh) if p.family == "gaussian"]
    assert len(gaussians) == 8
    for problem in gaussians:
        here, there = (int(np.argmax(values)) for values in problem.functions())
        distances = geodesic_distance(mesh, [here])
        low, high = success.DISTANCES[problem.distance]
        assert low <= distances[there] / distances.max() <= high


def test_surfaces_without_a_mirror_have_no_descriptors():
    x, y, z = BALL.vertices.T
    factors = (1 + 0.3 * np.sin(x + 2 * y + 0.5 * z))[:, None] * [1, 0.8, 0.6]
    uneven = TriangleMesh(BALL.vertices * factors, BALL.faces)
    families = [problem.family for problem in problems(10, uneven=uneven)]
    assert "descriptor" not in families
    assert len(families) == 9


def test_before_is_the_solver_without_what_came_later():
    paper = {"reach": 0.0, "order": 1, "levels": 1, "sigma_unit": "absolute"}
    assert paper.items() <= BEFORE.to_dict().items()
    assert list(VERSIONS) == ["before", "now"]
    assert VERSIONS["now"] == Parameters()


def tried(folder, parameters, source, target, mesh=BALL):
    """The record of a problem that is solved here and now."""
    ledger = Ledger(folder)
    row = problem_row(Problem(mesh, source, target, parameters), folder)
    attempt(Task(row, folder, ledger.make()))
    return record_of(ledger.entry(row))


def test_record_says_what_came_out_and_what_it_cost(tmp_path):
    places = ("gaussian:vertex=0,width=0.2", "gaussian:vertex=12,width=0.2")
    record, again = (tried(tmp_path / name, BEFORE, *places) for name in "ab")
    assert record.residual <= LEVEL
    assert 0 < record.seconds_to_level <= record.seconds
    assert record.evaluations >= record.iterations > 0
    assert record.row_products % len(BALL.vertices) == 0
    assert record.row_products > record.evaluations * len(BALL.vertices)
    times = {"seconds": record.seconds, "seconds_to_level": record.seconds_to_level}
    assert replace(again, **times) == record


def test_solvable_problems_alone_may_be_selected(tmp_path):
    at_rest = {"now": Parameters.of(iterations=0, refine=0)}
    selections = (success.Selection(count=9, solvable=wanted) for wanted in (False, True))
    whole, some = (
        [row["problem"] for row in run_success({"ball": BALL}, print, *given)["rows"]]
        for given in ((one, at_rest, Place(tmp_path)) for one in selections)
    )
    assert some == [problem for problem in whole if problem["solvable"]]
    assert 0 < len(some) < len(whole)


def test_functions_are_evaluated_anew_on_finer_meshes(tmp_path):
    places = "indicator:vertex=1,radius=0.4", "indicator:vertex=31,radius=0.4"
    loose = TriangleMesh([*BALL.vertices[:1] + 9, *BALL.vertices], BALL.faces + 1)
    records = [tried(tmp_path, Parameters(), *places, mesh) for mesh in (loose, BALL)]
    for record in records:  # of jumps, which are none between values that are interpolated
        assert record.verified > LEVEL
        assert record.refined == 0


def test_what_fails_is_recorded_as_such(tmp_path):
    ledger = Ledger(tmp_path)
    ledger.make()
    row = problem_row(Problem(BALL, "coordinate:x", "coordinate:y"), tmp_path)
    record = record_of(ledger.record(row, ledgers.Record(reason="out of memory"))).to_dict()
    assert record["stop_reason"] == "out of memory"
    assert record["residual"] is record["seconds"] is None
    assert not record["success"]
    assert not record["confirmed"]


def test_report_is_whole_survives_json_and_every_problem_is_told(report, told):
    assert json.loads(json.dumps(report, allow_nan=False)) == report
    assert list(report) == ["rows", "interrupted", "settings", "machine"]
    assert not report["interrupted"]
    assert len(report["rows"]) == 2
    for row in report["rows"]:
        assert list(row) == ["problem", "before", "now"]
        problem = "mesh folder index family width distance source target resolved solvable"
        assert set(problem.split()) <= row["problem"].keys()
        found = "residual verified folded row_products seconds refined stop_reason verdict"
        assert set(found.split()) <= row["now"].keys()
    assert report["settings"]["meshes"] == {"ball": 162}
    assert [line.split()[0] for line in told] == ["stating", "1/2", "2/2"]
    assert all("before" in line and "now" in line for line in told[1:])


def test_parts_and_their_reports_put_together_are_the_whole(report, folder):
    ended = Control()
    ended.cancel()

    def part(place=None, **selection):
        chosen, place = Selection(**selection), place or Place(folder)
        return run_success({"ball": BALL}, selection=chosen, versions=SHORT, place=place)

    whole = success.merged([part(count=2, part=(k, 2)) for k in (1, 2)])
    for found, wanted in zip(whole["rows"], report["rows"], strict=True):
        assert found == wanted
    with raises(ParameterError, "seed"):
        success.merged([report, part(Place(control=ended), seed=1)])
    with raises(ParameterError):
        success.merged([])


def test_a_success_needs_both_witnesses():
    numbers = [(0.04, 0.04), (0.04, 0.09), (0.06, 0.04), (0.04, np.nan)]
    records = [Record(residual=left, verified=by_lines).to_dict() for left, by_lines in numbers]
    assert [record["arrived"] for record in records] == [True, True, False, True]
    assert [record["success"] for record in records] == [True, False, False, False]
    assert [record["confirmed"] for record in records] == [True, True, True, False]


@pytest.fixture
def made():
    """A report of two problems, the first of which is refined now, and the second arrives now."""
    names = (
        *("success", "confirmed", "arrived", "residual", "verified", "folded"),
        *("refined", "seconds", "row_products"),
    )
    slow, now, fine, bad = (
        dict(zip(names, values, strict=True))
        for values in (
            (False, True, True, 0.01, 0.08, 0.0, 0, 4.0, 60),
            (True, True, True, 0.01, 0.02, 0.0, 0, 1.0, 20),
            (True, True, True, 0.01, 0.02, 0.0, 1, 8.0, 120),
            (False, False, False, None, None, None, 0, 3.0, 10),
        )
    )
    kind = ("folder", "resolved", "solvable", "distance", "width", "family")
    far = dict(zip(kind, ("men", True, True, "far", 0.1, "gaussian"), strict=True))
    other = dict(zip(kind, ("", False, False, None, None, "eigenfunction"), strict=True))
    machine = ("processor", "cores", "system", "python", "numpy", "scipy", "numba")
    return {
        "rows": [
            {"problem": far, "before": slow, "now": fine},
            {"problem": other, "before": bad, "now": now},
        ],
        "settings": {"versions": {"before": {}, "now": {}}, "meshes": {"ball": 162}, "seed": 0},
        "machine": dict.fromkeys(machine, "x"),
    }


def table_of(report):
    lines = [
        [cell.strip() for cell in line.strip("| ").split("|")]
        for line in success.success_table(report).splitlines()
    ]
    return {line[0]: line[1:] for line in lines if len(line) > 2}


def test_table_has_a_row_for_every_group(made):
    rows = table_of(made)
    assert " | ".join(rows) == (
        "problems | --- | all | resolved | distance far | width 0.1 | gaussian | eigenfunction | "
        "solvable | solvable, resolved | solvable, far | gaussian, solvable, far | "
        "men | men, solvable | men, solvable, far | men, gaussian, solvable, far"
    )
    assert " | ".join(rows["all"]) == (
        "0 → 2 of 2 | 1 → 2 of 2 | none → 0.01 | none → 0.02 | 50% → 100% | 0 → 1 of 2 | 0.5 | 0.5"
        " | 0.5 | none"
    )
    assert " | ".join(rows["eigenfunction"]) == (
        "0 → 1 of 1 | 0 → 1 of 1 | none → 0.01 | none → 0.02 | 0% → 100% | 0 → 0 of 1 | none | none"
        " | none | none"
    )
    assert rows["men"] == rows["men, solvable, far"] == rows["gaussian"]
    text = success.format_success(made)
    assert all(name in text for name in ("distance far", "7 s → 9 s in all", "before costs over"))


def test_one_version_alone_is_told_in_seconds(made):
    made["settings"]["versions"] = {"now": {}}
    assert " | ".join(table_of(made)["all"]) == (
        "2 of 2 | 2 of 2 | 0.01 | 0.02 | 100% | 1 of 2 | 70 | 4.5 | 8 | 1"
    )
    assert "Products (of rows of D_v), seconds: medians" in success.format_success(made)


def test_what_was_finished_is_kept_when_it_is_stopped_and_gone_on_with(report, tmp_path):
    chosen, told, control = Selection(count=2), [], Control()

    def tell(line):
        told.append(line.split()[0])
        if line.startswith("1/2"):
            control.cancel()

    part = run_success({"ball": BALL}, tell, chosen, SHORT, Place(tmp_path, control=control))
    assert part["interrupted"]
    assert [row["problem"] for row in part["rows"]] == [report["rows"][0]["problem"]]
    assert told == ["stating", "1/2"]
    assert "1 problems" in success.format_success(part)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.glob("*.npz")}
    whole = run_success({"ball": BALL}, tell, chosen, SHORT, Place(tmp_path))
    assert not whole["interrupted"]
    assert before.items() <= {p: p.stat().st_mtime_ns for p in tmp_path.glob("*.npz")}.items()
    assert whole["rows"][0] == part["rows"][0]  # with its seconds, which the ledger has
    assert len({path.name for path in tmp_path.glob("*.npz")}) == 4
    at_once = run_success({"ball": BALL}, tell, chosen, SHORT, Place(control=control))
    assert at_once["rows"] == []
    assert "0 of 0" in success.format_success(at_once)
