"""Figure 7: the match is close, and the numbers for a path's smoothness mean what they say."""

from __future__ import annotations

import numpy as np
import pytest

from abfm.experiments.figure_07 import smoothness, spread_gap
from abfm.functions import function
from tests.core.experiments.small import ran, run, stated
from tests.shapes import ellipsoid, torus


def test_matches_by_a_smooth_path() -> None:
    _, findings = ran(7)
    mismatch, by_flow_lines, _, folded, length, step, turn, rise = (
        measure.value for measure in findings.measures
    )
    assert mismatch < 0.1
    assert mismatch < by_flow_lines < 1
    assert folded < 0.05
    assert 1 < length < 1.5
    assert 1 < step < 2
    assert turn < 0.5
    assert rise < 1.5


def test_a_straight_path_is_as_smooth_as_can_be() -> None:
    mesh = torus(12, 8)
    start, end = function(mesh, "coordinate:x"), function(mesh, "coordinate:y")
    path = np.array([start + t * (end - start) for t in np.linspace(0, 1, 6)])
    length, step, turn, rise = (measure.value for measure in smoothness(mesh, path, end))
    assert (length, step, rise) == pytest.approx((1, 1, 1))
    assert turn < 1e-12


def test_a_kink_shows() -> None:
    mesh = torus(12, 8)
    f = function(mesh, "coordinate:x")
    path = np.array([f, 2 * f, 3 * f, 2 * f, f])  # turns round: a change of two steps
    turn = smoothness(mesh, path, f)[2]
    assert turn.value == pytest.approx(2)
    assert not turn.reproduces


def test_values_spread_alike_whatever_their_places() -> None:
    mesh = ellipsoid(2, 1, 1, 1)
    x, y = function(mesh, "coordinate:x"), function(mesh, "coordinate:y")
    assert spread_gap(mesh, x, y) < 0.01
    assert spread_gap(mesh, x, x + 0.5) == pytest.approx(0.5, rel=1e-3)  # ties may sort otherwise


def test_sign_of_the_target_is_the_one_whose_values_fit() -> None:
    mesh = ellipsoid(3, 1, 0.8, 0.6)
    problem = stated(7, mesh).problem
    source, target = problem.source[:, 0], problem.target[:, 0]
    assert spread_gap(mesh, source, target) <= 1.02 * spread_gap(mesh, source, -target)
    np.testing.assert_allclose(np.abs(target), np.abs(function(mesh, "eigenfunction:8")))


def test_on_another_mesh() -> None:
    assert run(7, torus(24, 12))[1].measures
