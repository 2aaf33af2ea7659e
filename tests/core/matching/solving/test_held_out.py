"""What a field says of places that it has not seen: how they are dealt out, what is measured."""

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
ONE = Variant(0.01, 1)


def energy(f, g, mask=None):
    return MatchingEnergy(SPHERE, f, g, mask=mask)


def bumps(b):
    return bump(SPHERE, [0, 0, 1], 0.2), bump(SPHERE, SPHERE.vertices[b], 0.2)


@pytest.mark.parametrize("mesh", [SPHERE, torus(60, 30), hemisphere(30), icosphere(1)])
def test_patches_are_dealt_out_evenly_and_always_alike(mesh):
    fold = folds(mesh)
    assert set(fold) == {0, 1, 2}
    shares = np.bincount(fold, vertex_areas(mesh)) / vertex_areas(mesh).sum()
    assert (np.abs(shares - 1 / 3) < 0.1).all()
    assert_array_equal(folds(TriangleMesh(mesh.vertices, mesh.faces)), fold)


@pytest.mark.parametrize("mesh", [SPHERE, torus(60, 30)])
def test_rounding_deals_out_nothing_where_a_surface_has_symmetries(mesh):
    """Many points are as far from what is dealt out, wherever the surface lies."""
    for turn in range(3):
        moved = Rotation.random(random_state=turn).apply(mesh.vertices.copy())
        other = TriangleMesh(3.7 * moved + turn, mesh.faces)
        assert_array_equal(folds(other), folds(mesh))


def test_they_are_patches_and_not_vertices_here_and_there():
    """Most neighbours are in one fold: else what is held out is known by them."""
    same = np.equal(*folds(SPHERE)[SPHERE.edges].T)
    assert same.mean() > 0.6


@pytest.mark.parametrize("mask", [None, MASK])
def test_each_fold_sees_all_but_its_patches_and_every_vertex_is_hidden_once(mask):
    whole = energy(*bumps(5), mask)
    parts = fold_energies(whole)
    given = np.ones(len(SPHERE.vertices)) if mask is None else mask
    assert_array_equal(sum(hidden for _, hidden in parts), given)
    for part, hidden in parts:
        assert_array_equal(part.functions.mask + hidden, given)
        assert not (part.functions.mask * hidden).any()
        assert part.functions.function_size == pytest.approx(whole.functions.function_size, rel=0.2)
        assert part.regularizer(0.5) is whole.regularizer(0.5)  # factored once for all
    few = np.where(folds(whole.mesh) == 1, given, 0.0)
    assert fold_energies(energy(*bumps(5), few)) == []


def test_what_is_told_is_the_mismatch_of_what_no_fold_has_seen():
    whole = energy(*bumps(5))
    rest = np.zeros(whole.shape)
    stage = Schedule(Parameters.of(iterations=0), whole.functions, 1).stage(0, 1.0, ONE)
    left = [
        whole.functions.with_mask(hidden).residual(whole.functions.source)
        for _, hidden in fold_energies(whole)
    ]
    found = HeldOut.at(whole, rest).follow([stage]).score(0.0)
    assert found == pytest.approx((np.sqrt(np.mean(np.square(left))),) * 3)


def test_fields_of_a_fold_know_nothing_of_what_it_hides():
    """Another target there is another number, of the same field."""
    (f, g), fields, p = (
        bumps(5),
        [],
        Parameters.of(iterations=5, sigma_unit="absolute", divergence=1.0),
    )
    stage = Schedule(p, energy(f, g).functions, 1).stage(0, 0.3, ONE)
    for target in (g, np.where(folds(SPHERE.normalized()) == 0, -g, g)):
        whole = MatchingEnergy(SPHERE, f, target, p)
        held = HeldOut.at(whole, np.zeros(whole.shape)).follow([stage])
        fields.append([fold.fields for fold in held.folds])
    apart = [
        np.abs(one - other).max() / np.abs(one).max() for one, other in zip(*fields, strict=True)
    ]
    assert apart[0] < 1e-9
    assert min(apart[1:]) > 0.01


def test_noise_is_not_found_where_it_was_not_seen_and_a_flow_is():
    f, g = bumps(5)
    rng = np.random.default_rng(0)
    noisy = f + 0.3 * rng.normal(size=len(f)), f + 0.3 * rng.normal(size=len(f))
    for functions, gains in (((f, g), True), (noisy, False)):
        whole = energy(*functions)
        schedule = Schedule(Parameters.of(iterations=20), whole.functions, 1)
        held = HeldOut.at(whole, np.zeros(whole.shape))
        before = held.follow([schedule.stage(0, 1e6, Variant(1.0, 1))]).score(0.0).held_out
        stages = [schedule.stage(0, sigma, ONE) for sigma in (3.0, 1.0, 0.3)]
        after = held.follow(stages).score(0.0).held_out
        assert (after < 0.8 * before) == gains
        assert (after > before) != gains


SIGMAS = np.array([6.0, 3.0, 2.0])  # steps need not be equally far from each other


@pytest.mark.parametrize("best", [2.3, 3.0, 4.1])
def test_parabola_finds_exact_minimum(best):
    """Scores that are quadratic in log sigma; values there are interpolated without an error."""
    scores = 0.7 + 0.04 * np.log(SIGMAS / best) ** 2
    sigma, weights = best_between(SIGMAS, scores)
    assert sigma == pytest.approx(best, rel=1e-9)
    assert weights @ scores == pytest.approx(0.7, rel=1e-12)
    others = 1 + 2 * np.log(SIGMAS) - 3 * np.log(SIGMAS) ** 2
    assert weights @ others == pytest.approx(1 + 2 * np.log(best) - 3 * np.log(best) ** 2)


def test_parabola_is_invariant():
    """Offset and scale of the scores change nothing; sigma keeps its unit."""
    scores = np.array([0.62, 0.58, 0.59])
    sigma, weights = best_between(SIGMAS, scores)
    for times, offset, unit in ((1, 5, 1), (20, 0, 1), (1e-3, -0.3, 1), (1, 0, 7.0)):
        again, others = best_between(unit * SIGMAS, times * scores + offset)
        assert again == pytest.approx(unit * sigma, rel=1e-9)
        assert_allclose(others, weights, rtol=1e-9)
    assert SIGMAS[2] < sigma < SIGMAS[0]


@pytest.mark.parametrize("scores", [[1, 1, 1], [3, 2, 1], [1, np.nan, 1], [np.inf, 1, 2]])
def test_parabola_without_minimum(scores):
    assert best_between([4.0, 2.0, 1.0], scores) is None


# a subject's sulcal depth on fsaverage5 with three masks, see docs/cortex.md
@pytest.mark.parametrize(
    "scores",
    [[0.58046, 0.57574, 0.58225], [0.58811, 0.5828, 0.58645], [0.57568, 0.57204, 0.57771]],
)
def test_score_error_moves_sigma_little(scores):
    """An error of 0.001 in any score moves sigma by less than 5%, where steps are 73% apart."""
    sigmas = 18 / np.sqrt(3) ** np.arange(2, 5)
    sigma, _ = best_between(sigmas, scores)
    for error in 0.001 * np.vstack([np.eye(3), -np.eye(3)]):
        moved, _ = best_between(sigmas, scores + error)
        assert abs(np.log(moved / sigma)) < 0.05


def test_score_adds_price_of_areas():
    whole = energy(*bumps(5))
    held = HeldOut.at(whole, np.zeros(whole.shape))
    assert held.score(0.2).value == pytest.approx(held.score(0.0).value + 0.05)
    assert np.isnan(held.score(np.nan).value)
