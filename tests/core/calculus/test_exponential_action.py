"""The exponential of a general matrix: SciPy as oracle, group laws, inputs that could hang it."""

import numpy as np
import pytest
from scipy import sparse
from scipy.linalg import expm

from abfm.calculus.operators import Matrix
from abfm.calculus.vector_fields import exponential_action
from abfm.errors import AdvectionError


def random_matrix():
    rng = np.random.default_rng(0)
    return Matrix(sparse.random_array((40, 40), density=0.2, rng=rng, data_sampler=rng.normal))


@pytest.mark.parametrize("t", [0.0, 1e-9, 0.3, -0.3, 4.0])
def test_equals_the_dense_exponential_of_scipy(t):
    matrix, x = random_matrix(), np.random.default_rng(1).normal(size=40)
    expected = expm(t * matrix.toarray()) @ x
    np.testing.assert_allclose(
        exponential_action(matrix, x, t), expected, rtol=0, atol=1e-12 * abs(expected).max()
    )


def test_many_steps_stay_accurate():
    """A rotation by 100 rad takes 25 steps."""
    turn = Matrix(np.array([[0.0, -1.0], [1.0, 0.0]]))
    np.testing.assert_allclose(
        exponential_action(turn, np.array([1.0, 0.0]), 100.0),
        [np.cos(100), np.sin(100)],
        rtol=0,
        atol=1e-13,
    )


def test_time_composes_and_goes_back():
    matrix, x = random_matrix(), np.random.default_rng(1).normal(size=40)
    half = exponential_action(matrix, x, 0.5)
    np.testing.assert_allclose(
        exponential_action(matrix, half, 0.5), exponential_action(matrix, x, 1.0), atol=1e-12
    )
    np.testing.assert_allclose(exponential_action(matrix, half, -0.5), x, atol=1e-12)


def test_nilpotent_series_ends():
    shift = Matrix(np.diag([1.0, 2.0, 3.0], 1))
    expected = expm(shift.toarray()) @ np.ones(4)
    np.testing.assert_allclose(exponential_action(shift, np.ones(4), 1.0), expected, rtol=1e-15)


def test_zero_stays_zero_and_a_zero_matrix_changes_nothing():
    assert not exponential_action(random_matrix(), np.zeros(40), 3.0).any()
    x = np.random.default_rng(1).normal(size=40)
    np.testing.assert_array_equal(exponential_action(Matrix((40, 40)), x, 5.0), x)


def test_tiny_and_huge_vectors_scale():
    matrix, x = random_matrix(), np.random.default_rng(1).normal(size=40)
    expected = exponential_action(matrix, x, 1.0)
    for scale in (1e-300, 1e300):
        np.testing.assert_allclose(
            exponential_action(matrix, scale * x, 1.0) / scale, expected, rtol=1e-6, atol=1e-10
        )


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_bad_vectors_end_and_show(bad):
    x = np.ones(40)
    x[3] = bad
    with np.errstate(invalid="ignore"):
        assert not np.isfinite(exponential_action(random_matrix(), x, 3.0)).all()


def test_overflow_ends_and_shows():
    with np.errstate(invalid="ignore", over="ignore"):
        assert not np.isfinite(exponential_action(Matrix(np.eye(2)), np.ones(2), 1e4)).all()


@pytest.mark.parametrize(
    ("scale", "t"), [(1.0, np.nan), (1.0, np.inf), (np.nan, 1.0), (np.inf, 1.0), (1e30, 1.0)]
)
def test_too_long_a_time_is_refused(scale, t):
    with pytest.raises(AdvectionError, match="shorten the time or slow the field"):
        exponential_action(Matrix(np.array([[scale, 1.0], [1.0, 0.0]])), np.ones(2), t)
