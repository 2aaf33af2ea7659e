"""The closest match within a bound of distortion."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from abfm import Flow, Parameters, Problem, match
from abfm.errors import ParameterError
from abfm.matching import SHARE, bounded, keeps
from tests.messages import raises
from tests.shapes import icosphere

MESH = icosphere(3)


@pytest.fixture(scope="module")
def found():
    """A match of a wide bump that becomes narrow: faces must grow and shrink."""
    f, g = (np.exp(-((MESH.vertices[:, 2] - 1) ** 2) / w) for w in (0.9, 0.25))
    return match(Problem(MESH, f, g, Parameters(refine=0, divergence=1)))


@pytest.mark.parametrize("most", [0.9, 0.4, 0.15])
def test_nearly_all_faces_keep_the_bound_and_a_tighter_one_leaves_more(found, most):
    within = bounded(found, most)
    told = within.distortion()
    logs = np.abs(np.log2([told.area, told.conformal]))
    assert (logs <= most).all(axis=0).mean() == told.share_within(most) >= SHARE
    least = told.bound_of(SHARE)
    assert told.share_within(least) >= SHARE > told.share_within(least * (1 - 1e-9))
    assert told.folded == 0
    assert found.residual < within.residual < found.initial_residual
    # the bound is used: the field is none that keeps half of it, too
    assert told.share_within(0.4 * most) < SHARE
    looser = bounded(found, 2 * most)
    assert looser.residual <= within.residual


def test_what_keeps_it_already_stays_and_the_path_goes_on_to_what_is_found(found):
    assert bounded(found, 1e3) is found
    within = bounded(found, 0.4)
    sigmas = [each.sigma for each in within.path]
    assert sigmas == sorted(sigmas, reverse=True)
    assert within.path[within.step].velocity is within.fine_velocity
    assert keeps(within, 0.4)
    assert not keeps(found, 0.4)


def test_landmarks_come_as_close_as_the_bound_lets_them():
    """They have a weight of their own, which falls along the path as that of functions does."""
    places = [[1, 0, 0], [1, 0.4, 0], [0, 0, 1], [0, 0.4, 1]]
    nearest = [int((MESH.vertices @ place).argmax()) for place in places]
    found = match(Problem(MESH, None, None, landmarks=np.reshape(nearest, (2, 2))))
    left = [found.landmark_errors.mean()]
    for most in (0.5, 0.25):
        within = bounded(found, most)
        assert keeps(within, most)
        assert within.distortion().share_within(0.5 * most) < SHARE
        left.append(within.landmark_errors.mean())
    assert not keeps(found, 0.5)
    left.append(found.problem.landmarks.first_errors.mean())
    assert left == sorted(left)
    assert left[1] < 0.6 * left[-1]


def test_what_no_field_keeps_gives_the_smoothest(found):
    def measure(each):
        """Of a map whose own distortion is beyond the bound, before any flow."""
        return each.distortion().scaled(3.0)

    smoothest = bounded(found, 0.1, measure)
    assert not keeps(smoothest, 0.1, measure)
    assert smoothest.path[-1].sigma > found.path[0].sigma
    # unless it is known that standing still is beyond it
    assert bounded(found, 0.1, measure, at_rest=lambda: measure(smoothest)) is found
    still = Flow(MESH, np.zeros((len(MESH.faces), 3)), 1.0).distortion()
    looked = bounded(found, 0.1, measure, at_rest=lambda: still)
    assert_array_equal(looked.fine_velocity, smoothest.fine_velocity)


@pytest.mark.parametrize("most", [0, -1, np.nan, "1"])
def test_bounds_are_positive_numbers(found, most):
    with raises(ParameterError):
        bounded(found, most)
