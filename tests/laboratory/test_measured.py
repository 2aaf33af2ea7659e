"""The benchmark of measured functions: what is known of its problems, and its report."""

import json
from itertools import product

import numpy as np
import pytest

from abfm import Control, PointMap
from abfm.calculus.operators import vertex_areas
from laboratory import measured
from laboratory.success import Selection
from laboratory.trials import Place
from tests.shapes import icosphere

BALL = icosphere(3)


def problems(count, seed=0, **meshes):
    return measured.measured_problems(meshes or {"ball": BALL}, seed, count)


@pytest.fixture(scope="module")
def report():
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(measured, "SIGMAS", (3.0, 0.3))
        return measured.run_measured({"ball": BALL}, selection=Selection(count=1))


def test_eight_problems_are_of_every_kind_and_hang_on_nothing_else():
    drawn = problems(8)
    kinds = set(product(measured.SIZES, measured.LENGTHS, measured.SMOOTHNESSES))
    assert {(p.size, p.length, p.smoothness) for p in drawn} == kinds
    first, again = drawn[0], problems(1, other=icosphere(1), ball=BALL)[1]
    for values in ("texture", "noise"):
        np.testing.assert_array_equal(getattr(first, values)(), getattr(again, values)())
    assert not np.array_equal(first.texture(), problems(1, seed=1)[0].texture())


def test_flows_are_as_large_and_textures_as_wide_as_they_say():
    areas = vertex_areas(BALL)
    drawn = problems(8)
    for problem in drawn:
        v = problem.flow().velocity / BALL.length_scale
        size = np.sqrt((v**2).sum(axis=-1).mean())
        assert size == pytest.approx(problem.size, rel=0.02)  # faces are about of one size
        f = problem.texture()
        assert np.average(f, weights=areas) == pytest.approx(0, abs=1e-12)
        assert np.average(f**2, weights=areas) == pytest.approx(1)
        assert problem.noise().std() == pytest.approx(measured.NOISE, rel=0.1)
    still = PointMap.of_vertices(BALL, BALL)
    moved = [measured.apart(each.flow().point_map(), still) / each.size for each in drawn]
    assert 0.5 < min(moved) <= max(moved) < 1.1


def test_distance_of_maps_is_that_of_a_turn():
    angle = 0.1
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0]])
    turned = PointMap.project(BALL, BALL, BALL.vertices @ np.vstack([turn, [0, 0, 1]]).T)
    # a chord of 2 sin(angle / 2) rho, the mean of rho = sin(theta) over a sphere being pi / 4
    expected = 2 * np.sin(angle / 2) * np.pi / 4 / np.sqrt(4 * np.pi)
    still = PointMap.of_vertices(BALL, BALL)
    assert measured.apart(still, turned) == pytest.approx(expected, rel=0.02)
    assert measured.apart(turned, turned) == 0


def test_report_is_whole_and_the_map_found_is_nearer_than_none(report):
    assert json.loads(json.dumps(report, allow_nan=False)) == report
    assert list(report) == ["rows", "interrupted", "settings", "machine"]
    (row,) = report["rows"]
    found, sigmas = row["defaults"], row["fixed"]
    assert sigmas.keys() == {"3", "0.3"}
    assert sigmas["0.3"]["sigma"] == 0.3
    assert found["error"] < row["problem"]["error"]
    assert measured.best(row)[1] == min(each["error"] for each in sigmas.values())
    text = measured.format_measured(report)
    assert f"{found['error']:.4f}" in text
    assert found["verdict"] in text


def test_what_fails_and_what_is_stopped_is_told(report):
    (row,) = report["rows"]
    failed = {"error": None, "verdict": "too fast"}
    alone = {**report, "rows": [{**row, "defaults": failed, "fixed": {"3": failed}}]}
    text = measured.format_measured(alone)
    assert "too fast" in text
    assert "0 of 1; median ratio none" in text
    ended = Control()
    ended.cancel()
    stopped = measured.run_measured({"ball": BALL}, place=Place(control=ended))
    assert stopped["interrupted"]
    assert stopped["rows"] == []
    assert "0 problems" in measured.format_measured(stopped)
