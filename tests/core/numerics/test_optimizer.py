"""L-BFGS and its line search on problems with known answers."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.optimize import minimize, rosen, rosen_der

from abfm.numerics.optimizer import (
    LBFGS,
    TRIALS_MAX,
    WOLFE_CURVATURE,
    WOLFE_DECREASE,
    Trial,
    strong_wolfe,
)


@dataclass
class Point:
    energy: float
    gradient: np.ndarray


def run(search, x, most=500):
    state = search.init(np.asarray(x, dtype=float))
    energies = [state.point.energy]
    while search.stop_reason(state) is None and len(energies) <= most:
        state = search.step(state)
        energies.append(state.point.energy)
    return state, energies


def rosenbrock(x):
    return Point(float(rosen(x)), rosen_der(x))


def test_rosenbrock_minimum_equals_scipy():
    start = np.array([-1.2, 1.0, 0.5, -0.7, 1.3])
    state, energies = run(LBFGS(rosenbrock, tolerance=1e-9), start)
    expected = minimize(rosen, start, jac=rosen_der, method="BFGS").x
    assert state.x == pytest.approx(expected, abs=1e-5)
    assert all(after < before for before, after in pairwise(energies))
    search = LBFGS(rosenbrock)
    assert search.stop_reason(search.init(np.ones(3))) == "converged"


def test_perfect_preconditioner_needs_one_step():
    diagonal, target = np.logspace(0, 6, 30), np.arange(30.0)

    def quadratic(x):
        return Point(float(0.5 * diagonal @ (x - target) ** 2), diagonal * (x - target))

    state, energies = run(LBFGS(quadratic, lambda g: g / diagonal), np.zeros(30))
    assert len(energies) == 2
    assert state.x == pytest.approx(target)
    assert len(run(LBFGS(quadratic), np.zeros(30))[1]) > 11


def test_steps_respect_the_largest_size():
    lengths = []
    search = LBFGS(lambda x: Point(float(0.5 * x @ x), x.copy()), step_size_max=0.25)
    state = search.init(np.full(4, 3.0))
    for _ in range(8):
        after = search.step(state)
        lengths.append(np.abs(after.x - state.x).max())
        state = after
    assert max(lengths) <= 0.25 * (1 + 1e-12)
    assert lengths[0] > 0


def test_infinite_energies_shorten_the_step():
    def walled(x):
        energy = float(-x[0] - 0.1 * np.log(1 - x[0])) if x[0] < 1 else np.inf
        return Point(energy, -1 + 0.1 / (1 - x))

    state, _ = run(LBFGS(walled, tolerance=1e-8), [0.0])
    assert state.x == pytest.approx(0.9, abs=1e-6)


def test_failed_line_search_keeps_the_iterate():
    search = LBFGS(lambda x: Point(float(x @ x), -2 * x))
    state, energies = run(search, [1.0, 2.0])
    assert search.stop_reason(state) == "line search failed"
    assert np.array_equal(state.x, [1.0, 2.0])
    assert energies == [5.0, 5.0]


@example(bend=1.0, wave=1.0, first=1e-4, shift=2.75)
@given(
    bend=st.floats(0.01, 100),
    wave=st.floats(0, 3),
    first=st.floats(1e-4, 100),
    shift=st.floats(0.1, 10),
)
def test_accepted_lengths_satisfy_strong_wolfe_conditions(bend, wave, first, shift):
    def value(t):
        return bend * (t - shift) ** 2 + wave * np.sin(5 * t)

    def slope(t):
        return 2 * bend * (t - shift) + 5 * wave * np.cos(5 * t)

    start = Trial(0.0, value(0.0), slope(0.0), Point(value(0.0), np.zeros(1)))
    if not start.slope < 0:
        return
    tried = []

    def evaluate(t):
        tried.append(t)
        return Point(value(t), np.array([slope(t)]))

    found = strong_wolfe(evaluate, lambda point: float(point.gradient[0]), start, first, np.inf)
    assert found is not None
    assert found.value <= start.value + WOLFE_DECREASE * found.length * start.slope
    assert abs(found.slope) <= WOLFE_CURVATURE * abs(start.slope) or len(tried) == TRIALS_MAX


def test_rounding_preconditioner_causes_no_division_by_zero():
    """A preconditioner may round small gradient changes to 0."""

    def quadratic(x):
        return Point(float(0.5 * x @ (x * [1, 1.001])), x * [1, 1.001])

    search = LBFGS(quadratic, lambda gradient: np.round(gradient), step_size_max=1e-3)
    with np.errstate(all="raise"):
        state, energies = run(search, [3.0, 2.0], most=5)
    assert all(after < before for before, after in pairwise(energies))
    assert np.isfinite(state.scale)


def test_slopes_are_computed_only_at_low_values():
    slopes, tried = [], []

    def evaluate(t):
        tried.append(t)
        return Point((t - 1) ** 2 if t < 3 else np.inf, np.array([2 * (t - 1)]))

    def slope_at(point):
        slopes.append(point.energy)
        return float(point.gradient[0])

    start = Trial(0.0, 1.0, -2.0, Point(1.0, np.array([-2.0])))
    found = strong_wolfe(evaluate, slope_at, start, 25.0, np.inf)
    assert tried[:2] == [25.0, 2.5]
    assert len(tried) == 3  # the minimum of the parabola through the values at 0 and 2.5
    assert found.length == pytest.approx(1.0)
    assert slopes == [found.value]


def test_plain_search_is_rotation_invariant():
    rotation = np.linalg.qr(np.random.default_rng(0).normal(size=(8, 8)))[0]
    bend = np.logspace(0, 3, 8)

    def quadratic(x):
        return Point(float(0.5 * bend @ (x - 1) ** 2), bend * (x - 1))

    def turned(x):
        point = quadratic(rotation.T @ x)
        return Point(point.energy, rotation @ point.gradient)

    one, other = LBFGS(quadratic), LBFGS(turned)
    state, same = one.init(np.zeros(8)), other.init(np.zeros(8))
    for _ in range(5):
        state, same = one.step(state), other.step(same)
        assert rotation @ state.x == pytest.approx(same.x, abs=1e-9)
