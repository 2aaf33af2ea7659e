"""What a field says of places that it has not seen: how they are dealt out, what is measured."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy.spatial.transform import Rotation

from abfm import MatchingEnergy, Parameters
from abfm.calculus.operators import vertex_areas
from abfm.matching.solving.course import Course, Way
from abfm.matching.solving.held_out import HeldOut, folds, without
from abfm.mesh import TriangleMesh
from tests.core.fields import bump
from tests.shapes import hemisphere, icosphere, torus

SPHERE = icosphere(4)
MASK = np.clip(SPHERE.vertices[:, 0] + 0.3, 0, 1)
ONE = Way(0.01, 1)


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
    parts = without(whole)
    given = np.ones(len(SPHERE.vertices)) if mask is None else mask
    assert_array_equal(sum(hidden for _, hidden in parts), given)
    for part, hidden in parts:
        assert_array_equal(part.functions.mask + hidden, given)
        assert not (part.functions.mask * hidden).any()
        assert part.functions.function_size == pytest.approx(whole.functions.function_size, rel=0.2)
        assert part.regularizer(0.5) is whole.regularizer(0.5)  # factored once for all
    few = np.where(folds(whole.mesh) == 1, given, 0.0)
    assert without(energy(*bumps(5), few)) == []


def test_what_is_told_is_the_mismatch_of_what_no_fold_has_seen():
    whole = energy(*bumps(5))
    rest = np.zeros(whole.shape)
    stage = Course(Parameters(iterations=0), whole.functions, 1).stage(0, 1.0, ONE)
    left = [
        whole.functions.weighed(hidden).residual(whole.functions.source)
        for _, hidden in without(whole)
    ]
    found = HeldOut(whole, rest).follow([stage])
    assert found == pytest.approx(np.sqrt(np.mean(np.square(left))))


def test_fields_of_a_fold_know_nothing_of_what_it_hides():
    """Another target there is another number, of the same field."""
    (f, g), fields, p = (
        bumps(5),
        [],
        Parameters(iterations=5, sigma_unit="absolute", divergence=1.0),
    )
    stage = Course(p, energy(f, g).functions, 1).stage(0, 0.3, ONE)
    for target in (g, np.where(folds(SPHERE.normalized()) == 0, -g, g)):
        whole = MatchingEnergy(SPHERE, f, target, p)
        held = HeldOut(whole, np.zeros(whole.shape))
        held.follow([stage])
        fields.append(held._fields)
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
        course = Course(Parameters(iterations=20), whole.functions, 1)
        still, held = (HeldOut(whole, np.zeros(whole.shape)) for _ in range(2))
        before = still.follow([course.stage(0, 1e6, Way(1.0, 1))])
        after = held.follow([course.stage(0, sigma, ONE) for sigma in (3.0, 1.0, 0.3)])
        assert (after < 0.8 * before) == gains
        assert (after > before) != gains
