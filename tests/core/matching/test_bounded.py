"""Matches with a bound of distortion."""

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


def is_within(match, limit):
    return match.distortion().bound(limit).is_satisfied


@pytest.fixture(scope="module")
def found():
    """Match a wide bump to a narrow one, which changes areas."""
    f, g = (np.exp(-((MESH.vertices[:, 2] - 1) ** 2) / w) for w in (0.9, 0.25))
    return match(Problem(MESH, f, g, Parameters(refine=0, divergence=1)))


@pytest.mark.parametrize("limit", [0.9, 0.4, 0.15])
def test_tighter_bound_has_larger_residual(found, limit):
    within = limit_distortion(found, limit)
    distortion = within.distortion()
    logs = np.abs(np.log2([distortion.area, distortion.conformal]))
    assert (logs <= limit).all(axis=0).mean() == distortion.share_within(limit) >= BOUNDED_SHARE
    least = distortion.bound_of(BOUNDED_SHARE)
    assert distortion.share_within(least) >= BOUNDED_SHARE
    assert distortion.share_within(least * (1 - 1e-9)) < BOUNDED_SHARE
    assert distortion.folded == 0
    assert found.residual < within.residual < found.initial_residual
    # the field makes use of the bound
    assert distortion.share_within(0.4 * limit) < BOUNDED_SHARE
    looser = limit_distortion(found, 2 * limit)
    assert looser.residual <= within.residual


def test_match_within_bound_is_unchanged(found):
    within = limit_distortion(found, 1e3)
    assert within.fine_velocity is found.fine_velocity
    assert within.verdict == found.verdict
    assert within.bound.is_satisfied
    assert within.bound.max_distortion == 1e3
    again = limit_distortion(within, 1e3)
    assert again is within


def test_path_is_within_the_bound(found):
    within = limit_distortion(found, 0.4)
    sigmas = [each.sigma for each in within.path]
    assert sigmas == sorted(sigmas, reverse=True)
    assert within.path[within.step].velocity is within.fine_velocity
    assert all(is_within(within.at_step(number), 0.4) for number in range(len(within.path)))
    assert not is_within(found, 0.4)


@cache
def match_of(name):
    """Return short matches of several kinds; some of them fail."""
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


@pytest.mark.parametrize("limit", [1.5, 0.3, 0.05])
@pytest.mark.parametrize(
    "name", ["far", "near", "turned", "two fields", "paper", "smaller", "linearised"]
)
def test_no_step_within_bound_is_better(name, limit):
    found = match_of(name)
    within = limit_distortion(found, limit)
    assert is_within(within, limit)
    assert within.bound.is_satisfied
    if is_within(found, limit):
        assert within.fine_velocity is found.fine_velocity
        return
    assert within.worse_residual <= found.initial_residual * (1 + 1e-9)
    for number in range(len(found.path)):
        each = found.at_step(number)
        if not math.isnan(each.verified_residual) and is_within(each, limit):
            assert within.worse_residual <= each.worse_residual
    assert within.problem is found.problem
    replayed = found.with_step(within.path[within.step])
    assert replayed.worse_residual == pytest.approx(within.worse_residual, rel=1e-6)


def test_landmark_errors_grow_with_tighter_bounds():
    places = [[1, 0, 0], [1, 0.4, 0], [0, 0, 1], [0, 0.4, 1]]
    nearest = [int((MESH.vertices @ place).argmax()) for place in places]
    found = match(Problem(MESH, None, None, landmarks=np.reshape(nearest, (2, 2))))
    errors = [found.landmark_errors.mean()]
    for limit in (0.5, 0.25):
        within = limit_distortion(found, limit)
        assert is_within(within, limit)
        assert within.distortion().share_within(0.5 * limit) < BOUNDED_SHARE
        errors.append(within.landmark_errors.mean())
    assert not is_within(found, 0.5)
    errors.append(found.problem.landmarks.initial_errors.mean())
    assert errors == sorted(errors)
    assert errors[1] < 0.6 * errors[-1]


def test_match_is_unchanged_without_candidates(found):
    def measure(each):
        """Return a distortion that exceeds the bound even without motion."""
        return each.distortion().scaled(3.0)

    within = limit_distortion(found, 0.1, measure)
    assert within.fine_velocity is found.fine_velocity
    assert within.verdict == found.verdict
    assert not within.bound.is_satisfied
    assert len(within.facts.warnings) == len(found.facts.warnings) + 1
    assert any("0.1" in warning for warning in within.facts.warnings)


def test_cancelled_search_ends_within_the_bound(found):
    control = Control()
    control.cancel()
    within = limit_distortion(found, 0.4, control=control)
    assert is_within(within, 0.4)


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


@pytest.mark.parametrize("limit", [0, -1, np.nan, "1"])
def test_bound_has_to_be_positive(found, limit):
    with raises(ParameterError):
        limit_distortion(found, limit)
