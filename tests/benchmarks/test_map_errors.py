import json
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from abfm import PointMap
from abfm.calculus.operators import vertex_areas
from abfm.workers import Control
from benchmarks import map_errors
from benchmarks.trials import Trials
from tests.shapes import icosphere

BALL = icosphere(3)
TRIALS = Trials({"ball": BALL}, count=1)


def problems(count, seed=0, **meshes):
    return map_errors.map_problems(meshes or {"ball": BALL}, seed, count)


@pytest.fixture(scope="module")
def report():
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(map_errors, "SIGMAS", (3.0, 0.3))
        return map_errors.run(TRIALS)


def test_problems_are_of_all_kinds_and_independent():
    drawn = problems(8)
    kinds = set(product(map_errors.SIZES, map_errors.LENGTHS, map_errors.SMOOTHNESSES))
    assert {(p.size, p.length, p.smoothness) for p in drawn} == kinds
    first, again = drawn[0], problems(1, other=icosphere(1), ball=BALL)[1]
    for values in ("texture", "noise"):
        np.testing.assert_array_equal(getattr(first, values)(), getattr(again, values)())
    assert not np.array_equal(first.texture(), problems(1, seed=1)[0].texture())


def test_flows_and_textures_have_their_sizes():
    areas = vertex_areas(BALL)
    drawn = problems(8)
    for problem in drawn:
        v = problem.flow().velocity / BALL.length_scale
        size = np.sqrt((v**2).sum(axis=-1).mean())
        assert size == pytest.approx(problem.size, rel=0.02)
        f = problem.texture()
        assert np.average(f, weights=areas) == pytest.approx(0, abs=1e-12)
        assert np.average(f**2, weights=areas) == pytest.approx(1)
        assert problem.noise().std() == pytest.approx(map_errors.NOISE, rel=0.1)
    still = PointMap.of_vertices(BALL, BALL)
    moved = [map_errors.map_distance(p.flow().point_map(), still) / p.size for p in drawn]
    assert 0.5 < min(moved) <= max(moved) < 1.1


def test_distance_of_a_rotation_is_exact():
    angle = 0.1
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0]])
    turned = PointMap.project(BALL, BALL, BALL.vertices @ np.vstack([turn, [0, 0, 1]]).T)
    # a chord of 2 sin(angle / 2) rho, the mean of rho = sin(theta) over a sphere being pi / 4
    expected = 2 * np.sin(angle / 2) * np.pi / 4 / np.sqrt(4 * np.pi)
    still = PointMap.of_vertices(BALL, BALL)
    assert map_errors.map_distance(still, turned) == pytest.approx(expected, rel=0.02)
    assert map_errors.map_distance(turned, turned) == 0


def test_report_is_json_and_map_beats_identity(report):
    assert json.loads(json.dumps(report, allow_nan=False)) == report
    assert list(report) == ["rows", "interrupted", "settings", "machine"]
    (row,) = report["rows"]
    found, sigmas = row["defaults"], row["fixed"]
    assert sigmas.keys() == {"3", "0.3"}
    assert sigmas["0.3"]["sigma"] == 0.3
    assert found["error"] < row["problem"]["error"]
    assert map_errors.best(row)[1] == min(each["error"] for each in sigmas.values())
    text = map_errors.report_text(report)
    assert f"{found['error']:.4f}" in text
    assert found["verdict"] in text


def test_failures_and_cancelled_runs_are_reported(report):
    (row,) = report["rows"]
    failed = {"error": None, "verdict": "too fast"}
    rows = [{**row, "defaults": failed, "fixed": {"3": failed}}]
    text = map_errors.report_text({**report, "rows": rows})
    assert "too fast" in text
    assert "0 of 1; median ratio none" in text
    control = Control()
    control.cancel()
    stopped = map_errors.run(replace(TRIALS, control=control))
    assert stopped["interrupted"]
    assert stopped["rows"] == []
    assert "0 problems" in map_errors.report_text(stopped)
