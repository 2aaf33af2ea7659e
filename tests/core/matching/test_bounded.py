"""The closest match within a bound of distortion."""

import math
from functools import cache

import numpy as np
import pytest

from abfm import Parameters, Problem, load, match
from abfm.errors import ParameterError
from abfm.matching import BOUNDED_SHARE, limit_distortion
from abfm.workers import Control
from tests.messages import raises
from tests.shapes import icosphere

MESH = icosphere(3)


def keeps(match, most):
    return match.distortion().bound(most).is_kept


@pytest.fixture(scope="module")
def found():
    """A match of a wide bump that becomes narrow: faces must grow and shrink."""
    f, g = (np.exp(-((MESH.vertices[:, 2] - 1) ** 2) / w) for w in (0.9, 0.25))
    return match(Problem(MESH, f, g, Parameters(refine=0, divergence=1)))


@pytest.mark.parametrize("most", [0.9, 0.4, 0.15])
def test_nearly_all_faces_keep_the_bound_and_a_tighter_one_leaves_more(found, most):
    within = limit_distortion(found, most)
    told = within.distortion()
    logs = np.abs(np.log2([told.area, told.conformal]))
    assert (logs <= most).all(axis=0).mean() == told.share_within(most) >= BOUNDED_SHARE
    least = told.bound_of(BOUNDED_SHARE)
    assert told.share_within(least) >= BOUNDED_SHARE > told.share_within(least * (1 - 1e-9))
    assert told.folded == 0
    assert found.residual < within.residual < found.initial_residual
    # the bound is used: the field is none that keeps half of it, too
    assert told.share_within(0.4 * most) < BOUNDED_SHARE
    looser = limit_distortion(found, 2 * most)
    assert looser.residual <= within.residual


def test_a_match_within_the_bound_stays(found):
    within = limit_distortion(found, 1e3)
    assert within.fine_velocity is found.fine_velocity
    assert within.verdict == found.verdict
    assert within.bound.is_kept
    assert within.bound.max_distortion == 1e3
    again = limit_distortion(within, 1e3)
    assert again is within


def test_the_path_is_within_the_bound(found):
    """The steps that keep the bound are the path of the result, up to its own."""
    within = limit_distortion(found, 0.4)
    sigmas = [each.sigma for each in within.path]
    assert sigmas == sorted(sigmas, reverse=True)
    assert within.path[within.step].velocity is within.fine_velocity
    assert all(keeps(within.at_step(number), 0.4) for number in range(len(within.path)))
    assert not keeps(found, 0.4)


@cache
def match_of(name):
    """Return short matches of several kinds, some of which fail."""
    sphere = icosphere(2)
    x, y, z = sphere.vertices.T
    short = Parameters.of(iterations=40, refine=0)
    problems = {
        "far": (np.exp(-((x - 1) ** 2) / 0.2), np.exp(-((x + 1) ** 2) / 0.2), short),
        "near": (np.exp(-((x - 1) ** 2) / 0.3), np.exp(-((y - 0.2) ** 2 + z**2) / 0.3), short),
        "turned": (x * y, y * z, short),
        "two fields": (x, y, Parameters.of(iterations=30, refine=0, segments=2)),
        "paper": (x, z, Parameters.of(iterations=30, refine=0, reach=0, levels=1, sigma=0.1)),
        "smaller": (np.exp(-((z - 1) ** 2) / 0.9), np.exp(-((z - 1) ** 2) / 0.2), short),
        "linearised": (x, y, Parameters.of(iterations=20, method="linearised", refine=0)),
    }
    return match(Problem(sphere, *problems[name]))


@pytest.mark.parametrize("most", [1.5, 0.3, 0.05])
@pytest.mark.parametrize(
    "name", ["far", "near", "turned", "two fields", "paper", "smaller", "linearised"]
)
def test_no_step_within_the_bound_is_closer(name, most):
    """Nor is the field without motion, and the bound is kept."""
    found = match_of(name)
    within = limit_distortion(found, most)
    assert keeps(within, most)
    assert within.bound.is_kept
    if keeps(found, most):
        assert within.fine_velocity is found.fine_velocity
        return
    assert within.worse_residual <= found.initial_residual * (1 + 1e-9)
    for number in range(len(found.path)):
        each = found.at_step(number)
        if not math.isnan(each.verified_residual) and keeps(each, most):
            assert within.worse_residual <= each.worse_residual
    assert within.problem is found.problem
    replayed = found.with_step(within.path[within.step])
    assert replayed.worse_residual == pytest.approx(within.worse_residual, rel=1e-6)


def test_landmarks_come_as_close_as_the_bound_lets_them():
    """They have a weight of their own, which falls along the path as that of functions does."""
    places = [[1, 0, 0], [1, 0.4, 0], [0, 0, 1], [0, 0.4, 1]]
    nearest = [int((MESH.vertices @ place).argmax()) for place in places]
    found = match(Problem(MESH, None, None, landmarks=np.reshape(nearest, (2, 2))))
    left = [found.landmark_errors.mean()]
    for most in (0.5, 0.25):
        within = limit_distortion(found, most)
        assert keeps(within, most)
        assert within.distortion().share_within(0.5 * most) < BOUNDED_SHARE
        left.append(within.landmark_errors.mean())
    assert not keeps(found, 0.5)
    left.append(found.problem.landmarks.initial_errors.mean())
    assert left == sorted(left)
    assert left[1] < 0.6 * left[-1]


def test_a_match_stays_if_no_field_keeps_the_bound(found):
    def measure(each):
        """Return the distortion of a map that is beyond the bound before any flow."""
        return each.distortion().scaled(3.0)

    within = limit_distortion(found, 0.1, measure)
    assert within.fine_velocity is found.fine_velocity
    assert within.verdict == found.verdict
    assert not within.bound.is_kept
    assert len(within.facts.warnings) == len(found.facts.warnings) + 1
    assert any("0.1" in warning for warning in within.facts.warnings)


def test_a_search_that_is_cancelled_ends_within_the_bound(found):
    control = Control()
    control.cancel()
    within = limit_distortion(found, 0.4, control=control)
    assert keeps(within, 0.4)


def test_facts_and_files_name_the_bound(found, tmp_path):
    within = limit_distortion(found, 0.4)
    facts = within.facts
    assert facts.numbers["max_distortion"] == 0.4
    assert facts.numbers["share_within"] == within.distortion().share_within(0.4)
    assert facts.numbers["distortion_99"] == within.distortion().bound_of(BOUNDED_SHARE)
    assert "0.4" in facts.headline
    assert "0.4" in facts.reason
    assert "max_distortion" not in found.facts.numbers
    within.save(tmp_path / "m.npz")
    loaded = load(tmp_path / "m.npz")
    assert loaded.bound == within.bound
    assert loaded.facts.headline == facts.headline
    assert loaded.at_step(0).bound is None


@pytest.mark.parametrize("most", [0, -1, np.nan, "1"])
def test_bounds_are_positive_numbers(found, most):
    with raises(ParameterError):
        limit_distortion(found, most)
