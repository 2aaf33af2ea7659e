import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from abfm import MatchingEnergy, Parameters
from abfm.calculus.operators import vertex_areas
from abfm.matching.solving.held_out import HeldOut, best_between, fold_energies, folds
from abfm.matching.solving.schedule import Schedule, Variant
from abfm.mesh import TriangleMesh
from tests.core.fields import bump
from tests.shapes import hemisphere, icosphere, torus

SPHERE = icosphere(4)
MASK = np.clip(SPHERE.vertices[:, 0] + 0.3, 0, 1)
VARIANT = Variant(0.01, 1)


def energy(f, g, mask=None):
    return MatchingEnergy(SPHERE, f, g, mask=mask)


def bumps(b):
    return bump(SPHERE, [0, 0, 1], 0.2), bump(SPHERE, SPHERE.vertices[b], 0.2)


@pytest.mark.parametrize("mesh", [SPHERE, torus(60, 30), hemisphere(30), icosphere(1)])
def test_folds_are_even_and_deterministic(mesh):
    fold = folds(mesh)
    assert set(fold) == {0, 1, 2}
    shares = np.bincount(fold, vertex_areas(mesh)) / vertex_areas(mesh).sum()
    assert (np.abs(shares - 1 / 3) < 0.1).all()
    assert_array_equal(folds(TriangleMesh(mesh.vertices, mesh.faces)), fold)


@pytest.mark.parametrize("mesh", [SPHERE, torus(60, 30)])
def test_folds_of_symmetric_surfaces_ignore_rounding(mesh):
    """Ties between equally distant points are broken independently of rounding and motion."""
    for turn in range(3):
        moved = Rotation.random(random_state=turn).apply(mesh.vertices.copy())
        other = TriangleMesh(3.7 * moved + turn, mesh.faces)
        assert_array_equal(folds(other), folds(mesh))


def test_folds_consist_of_patches():
    """Most neighbours are in the same fold, so that they do not reveal held-out values."""
    same = np.equal(*folds(SPHERE)[SPHERE.edges].T)
    assert same.mean() > 0.6


@pytest.mark.parametrize("mask", [None, MASK])
def test_every_vertex_is_held_out_once(mask):
    complete = energy(*bumps(5), mask)
    parts = fold_energies(complete)
    given = np.ones(len(SPHERE.vertices)) if mask is None else mask
    assert_array_equal(sum(hidden for _, hidden in parts), given)
    for part, hidden in parts:
        assert_array_equal(part.functions.mask + hidden, given)
        assert not (part.functions.mask * hidden).any()
        assert part.functions.function_size == pytest.approx(
            complete.functions.function_size, rel=0.2
        )
        assert part.regularizer(0.5) is complete.regularizer(0.5)
    few = np.where(folds(complete.mesh) == 1, given, 0.0)
    assert fold_energies(energy(*bumps(5), few)) == []


def test_score_is_the_residual_of_held_out_patches():
    complete = energy(*bumps(5))
    rest = np.zeros(complete.shape)
    stage = Schedule(Parameters.of(iterations=0), complete.functions, 1).stage(0, 1.0, VARIANT)
    residuals = [
        complete.functions.with_mask(hidden).residual(complete.functions.source)
        for _, hidden in fold_energies(complete)
    ]
    found = HeldOut.at(complete, rest).follow([stage]).score(0.0)
    assert found == pytest.approx((np.sqrt(np.mean(np.square(residuals))),) * 3)


def test_fields_do_not_depend_on_held_out_values():
    (f, g), fields = bumps(5), []
    p = Parameters.of(iterations=5, sigma_unit="absolute", divergence=1.0)
    stage = Schedule(p, energy(f, g).functions, 1).stage(0, 0.3, VARIANT)
    for target in (g, np.where(folds(SPHERE.normalized()) == 0, -g, g)):
        complete = MatchingEnergy(SPHERE, f, target, p)
        held = HeldOut.at(complete, np.zeros(complete.shape)).follow([stage])
        fields.append([fold.fields for fold in held.folds])
    differences = [
        np.abs(one - other).max() / np.abs(one).max() for one, other in zip(*fields, strict=True)
    ]
    assert differences[0] < 1e-9
    assert min(differences[1:]) > 0.01


def test_held_out_residual_distinguishes_flow_from_noise():
    f, g = bumps(5)
    rng = np.random.default_rng(0)
    noisy = f + 0.3 * rng.normal(size=len(f)), f + 0.3 * rng.normal(size=len(f))
    for functions, gains in (((f, g), True), (noisy, False)):
        complete = energy(*functions)
        schedule = Schedule(Parameters.of(iterations=20), complete.functions, 1)
        held = HeldOut.at(complete, np.zeros(complete.shape))
        before = held.follow([schedule.stage(0, 1e6, Variant(1.0, 1))]).score(0.0).held_out
        stages = [schedule.stage(0, sigma, VARIANT) for sigma in (3.0, 1.0, 0.3)]
        after = held.follow(stages).score(0.0).held_out
        assert (after < 0.8 * before) == gains
        assert (after > before) != gains


SIGMAS = np.array([6.0, 3.0, 2.0])  # Gaussians at different distances


@pytest.mark.parametrize("best", [2.3, 3.0, 4.1])
def test_parabola_finds_exact_minimum(best):
    scores = 0.7 + 0.04 * np.log(SIGMAS / best) ** 2
    sigma, weights = best_between(SIGMAS, scores)
    assert sigma == pytest.approx(best, rel=1e-9)
    assert weights @ scores == pytest.approx(0.7, rel=1e-12)
    others = 1 + 2 * np.log(SIGMAS) - 3 * np.log(SIGMAS) ** 2
    assert weights @ others == pytest.approx(1 + 2 * np.log(best) - 3 * np.log(best) ** 2)


def test_parabola_is_invariant():
    scores = np.array([0.62, 0.58, 0.59])
    sigma, weights = best_between(SIGMAS, scores)
    for times, offset, unit in ((1, 5, 1), (20, 0, 1), (1e-3, -0.3, 1), (1, 0, 7.0)):
        again, others = best_between(unit * SIGMAS, times * scores + offset)
        assert again == pytest.approx(unit * sigma, rel=1e-9)
        assert_allclose(others, weights, rtol=1e-9)
    assert SIGMAS[2] < sigma < SIGMAS[0]


@pytest.mark.parametrize("scores", [[1, 1, 1], [3, 2, 1], [1, np.nan, 1], [np.inf, 1, 2]])
def test_parabola_without_minimum_is_none(scores):
    assert best_between([4.0, 2.0, 1.0], scores) is None


# a subject's sulcal depth on fsaverage5 with three masks, see docs/cortex.md
@pytest.mark.parametrize(
    "scores", [[0.58046, 0.57574, 0.58225], [0.58811, 0.5828, 0.58645], [0.57568, 0.57204, 0.57771]]
)
def test_score_error_moves_sigma_little(scores):
    """An error of 0.001 in a score moves sigma by less than 5%; steps differ by 73%."""
    sigmas = 18 / np.sqrt(3) ** np.arange(2, 5)
    sigma, _ = best_between(sigmas, scores)
    for error in 0.001 * np.vstack([np.eye(3), -np.eye(3)]):
        moved, _ = best_between(sigmas, scores + error)
        assert abs(np.log(moved / sigma)) < 0.05


def test_score_includes_the_change_of_areas():
    complete = energy(*bumps(5))
    held = HeldOut.at(complete, np.zeros(complete.shape))
    assert held.score(0.2).value == pytest.approx(held.score(0.0).value + 0.05)
    assert np.isnan(held.score(np.nan).value)
