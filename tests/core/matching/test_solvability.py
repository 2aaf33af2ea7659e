"""What the functions alone say: bounds, constants, distances, peaks and resolution."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from abfm.matching.objective.matching_energy import MatchingEnergy
from abfm.matching.solvability import (
    Extrema,
    different_peaks,
    distance,
    peaks,
    peaks_apart,
    persistence,
    range_bound,
    resolution,
    source_is_constant,
    squeezed,
    stood_still,
    target_is_constant,
    vanished,
)
from abfm.matching.terms.functions import FunctionTerm
from abfm.mesh import TriangleMesh
from abfm.mesh.subdivision import interpolated, subdivided
from abfm.parameters import Parameters
from tests.core.fields import bump
from tests.core.surfaces import SURFACES
from tests.shapes import disc, icosphere, square, torus

SPHERE = icosphere(2)
COUNT = len(SPHERE.vertices)
SEEDS = st.integers(0, 10**6)


def random_problem(seed):
    rng = np.random.default_rng(seed)
    source, target = rng.normal(size=(2, 2, COUNT)) * rng.uniform(0.1, 2, (2, 2, 1))
    mask = rng.integers(0, 2, COUNT) * rng.uniform(size=COUNT)
    return FunctionTerm(SPHERE, source.T, target.T, mask, rng.uniform(size=2))


def at(degrees, width=0.15):
    """A Gaussian on the unit sphere, so far from the pole."""
    angle = np.deg2rad(degrees)
    return bump(SPHERE, [0, np.sin(angle), np.cos(angle)], width)


@given(SEEDS)
def test_the_mismatch_is_that_of_the_norms_and_the_solvers(seed):
    problem = random_problem(seed)
    energy = MatchingEnergy(
        SPHERE,
        problem.source.T,
        problem.target.T,
        Parameters(),
        mask=problem.mask,
        weights=problem.weights,
    )
    found = problem.relative_mismatch(problem.source)
    assert found == pytest.approx(energy.relative_mismatch(problem.source), rel=1e-12)
    assert found == pytest.approx(
        problem.norm(problem.source - problem.target) / problem.norm(problem.target), rel=1e-12
    )
    means = problem.source @ problem.areas / problem.areas.sum()
    assert problem.deviation(problem.source) == pytest.approx(
        problem.norm(problem.source - means[:, None]), rel=1e-12
    )


@given(SEEDS)
def test_nothing_with_the_sources_values_comes_below_the_bound(seed):
    """Values of the source in any order, or any between its least and largest."""
    problem = random_problem(seed)
    rng = np.random.default_rng(seed)
    low, high = problem.source.min(axis=1, keepdims=True), problem.source.max(axis=1, keepdims=True)
    for made in (
        rng.permuted(problem.source, axis=1),
        rng.uniform(low, high, problem.source.shape),
    ):
        assert problem.relative_mismatch(made) >= range_bound(problem)
    assert problem.relative_mismatch(np.clip(problem.target, low, high)) == pytest.approx(
        range_bound(problem), rel=1e-12
    )


@given(SEEDS, st.floats(1e-3, 1e3), st.floats(1, 3))
def test_the_bound_ignores_units_and_falls_with_a_wider_source(seed, unit, wider):
    problem = random_problem(seed)
    scaled = FunctionTerm(
        SPHERE, unit * problem.source.T, unit * problem.target.T, problem.mask, problem.weights
    )
    assert range_bound(scaled) == pytest.approx(range_bound(problem), rel=1e-9)
    middle = (problem.source.min(axis=1) + problem.source.max(axis=1))[:, None] / 2
    wide = middle + wider * (problem.source - middle)
    richer = FunctionTerm(SPHERE, wide.T, problem.target.T, problem.mask, problem.weights)
    assert range_bound(richer) <= range_bound(problem) + 1e-12


def test_the_bound_of_known_functions():
    # as vertices do not sample both tops alike
    assert range_bound(FunctionTerm(SPHERE, at(0), at(40))) < 0.05
    assert range_bound(FunctionTerm(SPHERE, at(0) - at(180), 0.9 * at(0))) == 0
    constant = np.full(COUNT, 0.5)
    assert range_bound(FunctionTerm(SPHERE, constant, 2 * constant)) == pytest.approx(0.5)
    assert range_bound(FunctionTerm(SPHERE, constant, at(0))) == pytest.approx(
        FunctionTerm(SPHERE, constant, at(0)).relative_mismatch(constant[None])
    )


def test_only_what_counts_is_bounded():
    """Where the mask is 0, or in a channel of weight 0, the target may have any values."""
    source, target = at(0), at(0).copy()
    target[:5] = 9
    mask = np.ones(COUNT)
    mask[:5] = 0
    assert range_bound(FunctionTerm(SPHERE, source, target)) > 0.5
    assert range_bound(FunctionTerm(SPHERE, source, target, mask)) == 0
    both = FunctionTerm(
        SPHERE,
        np.stack([source, source], axis=1),
        np.stack([source, target], axis=1),
        None,
        [1.0, 0],
    )
    assert range_bound(both) == 0
    assert not source_is_constant(both)
    assert different_peaks(both) is None


def test_constants_are_those_that_count():
    flat = np.full(COUNT, 0.3)
    outside = flat.copy()
    outside[:5] = 1
    mask = np.ones(COUNT)
    mask[:5] = 0
    assert source_is_constant(FunctionTerm(SPHERE, flat, at(0)))
    # its values may come from anywhere
    assert not source_is_constant(FunctionTerm(SPHERE, outside, at(0), mask))
    assert target_is_constant(FunctionTerm(SPHERE, at(0), outside, mask))
    assert not target_is_constant(FunctionTerm(SPHERE, at(0), outside))


def test_what_vanished_and_what_stood_still():
    problem = FunctionTerm(SPHERE, at(0), at(90))
    assert vanished(problem, (0.01 * at(30) + 0.1)[None])
    assert not vanished(problem, (0.5 * at(30))[None])
    assert stood_still(problem, (at(0) + 0.01 * at(30))[None])
    assert not stood_still(problem, (at(20))[None])
    flat = FunctionTerm(SPHERE, at(0), 0.01 * at(90))
    assert not vanished(flat, (0.01 * at(30))[None])  # as the target has it


@given(st.floats(10, 80))
def test_the_distance_is_that_between_gaussians(degrees):
    mesh = square(20)
    here, there = [0.5, 0.3, 0], [0.5, 0.3 + degrees / 200, 0]
    problem = FunctionTerm(mesh, bump(mesh, here, 0.04), bump(mesh, there, 0.04))
    apart = degrees / 200
    overlap = 0.04 * 4 / apart  # what they share cancels, and leaves centres farther apart
    assert apart * 0.95 <= distance(problem) <= apart + 0.04 * overlap
    assert distance(problem) == distance(FunctionTerm(mesh, problem.target.T, problem.source.T))


def test_no_distance_where_nothing_is_too_much():
    assert distance(FunctionTerm(SPHERE, at(0), 2 * at(0))) == 0


def test_peaks_are_not_told_where_a_mask_hides_some():
    two = np.maximum(at(0, 0.1), at(120, 0.1))
    assert different_peaks(FunctionTerm(SPHERE, at(0, 0.1), two)) == (0, (1, 1), (2, 1))
    assert (
        different_peaks(
            FunctionTerm(SPHERE, at(0, 0.1), two, (SPHERE.vertices[:, 2] > 0).astype(float))
        )
        is None
    )
    second = FunctionTerm(SPHERE, np.stack([two, two], axis=1), np.stack([two, at(0, 0.1)], axis=1))
    assert different_peaks(second) == (1, (2, 1), (1, 1))


def test_squeezing_is_told_from_moving_by_which_of_them_lowers_the_mismatch():
    f, g = (bump(SPHERE, centre, 0.15) for centre in ([0.0, 0.0, 1.0], [0.0, 1.0, 0.0]))
    halfway = bump(SPHERE, [0.0, np.sqrt(0.5), np.sqrt(0.5)], 0.15)
    problem = FunctionTerm(SPHERE, f, g)
    assert squeezed(problem, 0.5 * f[None])
    assert not squeezed(problem, 0.8 * f[None])  # not yet
    assert not squeezed(problem, halfway[None])
    assert not squeezed(problem, 0.5 * g[None])  # it moved, and came smaller
    assert not squeezed(FunctionTerm(SPHERE, f, 0.4 * f), 0.5 * f[None])  # as the target is smaller


FINE = icosphere(3)
BALL = icosphere(4)
SEEDS = st.integers(0, 10**6)


def gaussians(count):
    places = np.array([[0, 0, 1.0], [0, 1, 0], [1, 0, 0]])[:count]
    return np.max([bump(FINE, place, 0.1) for place in places], axis=0)


def slow_persistence(mesh, f):
    """For every vertex flood what lies above each lower value."""
    neighbours = [set() for _ in f]
    for a, b in mesh.edges.tolist():
        neighbours[a].add(b)
        neighbours[b].add(a)
    order = {v: k for k, v in enumerate(sorted(range(len(f)), key=lambda v: (-f[v], v)))}
    found = []
    for peak in range(len(f)):
        death = f.min()
        for level in sorted((v for v in order if order[v] >= order[peak]), key=order.__getitem__):
            reached, front = {peak}, [peak]
            while front:
                new = {w for w in neighbours[front.pop()] if order[w] <= order[level]} - reached
                reached |= new
                front += new
            if any(order[v] < order[peak] for v in reached):
                death = f[level]
                break
        found.append(f[peak] - death)
    return sorted((value for value in found if value > 0), reverse=True)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_gaussians_are_counted(count):
    assert peaks(FINE, gaussians(count)) == (count, 1)


@given(SEEDS, st.integers(1, 3))
def test_noise_below_the_bound_adds_none(seed, count):
    noise = np.random.default_rng(seed).uniform(-0.04, 0.04, len(FINE.vertices))
    assert peaks(FINE, gaussians(count) + noise) == (count, 1)
    assert len(persistence(FINE, gaussians(count) + noise)) > 3


def test_a_constant_has_no_peaks():
    for value in (0.0, 0.1, -7.0):
        assert peaks(FINE, np.full(len(FINE.vertices), value)) == (0, 0)
    assert peaks(FINE, 0.1 + 1e-17 * FINE.vertices[:, 0]) == (0, 0)


def test_plateaus_are_one_peak_each():
    x, y, _ = FINE.vertices.T
    assert_array_equal(persistence(FINE, (x > 0.5).astype(float)), [1])
    assert peaks(FINE, (np.abs(x) > 0.5).astype(float), 0.0) == (2, 1)
    assert peaks(FINE, np.sign(x * y) * (np.abs(x * y) > 0.2)) == (2, 2)


def test_the_edge_of_a_surface_has_peaks():
    mesh = square(12)
    x, y, _ = mesh.vertices.T
    assert peaks(mesh, x) == (1, 1)
    assert peaks(mesh, (2 * x - 1) * (2 * y - 1)) == (2, 2)
    assert peaks(mesh, (x - 0.5) ** 2 + (y - 0.5) ** 2) == (4, 1)


def test_persistence_is_the_depth_of_the_pass():
    """Of two equal Gaussians one lasts to the lowest value, the other to the saddle halfway."""
    width, apart = 0.15, 1.5  # in sqrt(area), in radians

    def height(angle):
        return float(np.exp(-((2 * np.sin(angle / 2)) ** 2) / (2 * width**2 * 4 * np.pi)))

    f = sum(bump(BALL, [0, np.sin(angle), np.cos(angle)], width) for angle in (0.0, apart))
    top, saddle = 1 + height(apart), 2 * height(apart / 2)
    found = persistence(BALL, f)
    assert_allclose(found[:2], [top, top - saddle], atol=0.01)
    assert len(found) == 2


@pytest.mark.parametrize(
    "name", [name for name, mesh in SURFACES.items() if len(mesh.vertices) < 130]
)
def test_the_slow_count_agrees(name):
    mesh = SURFACES[name]
    rng = np.random.default_rng(len(mesh.vertices))
    for f in (
        rng.normal(size=len(mesh.vertices)),
        rng.integers(0, 4, len(mesh.vertices)).astype(float),
    ):
        assert_allclose(persistence(mesh, f), slow_persistence(mesh, f), rtol=0, atol=1e-15)


@given(SEEDS, st.floats(1e-3, 1e3), st.floats(-1e3, 1e3))
def test_numbering_scale_and_offset_do_not_matter(seed, factor, offset):
    rng = np.random.default_rng(seed)
    f = np.sin(3 * FINE.vertices @ rng.normal(size=(3, 2))).sum(axis=1) + rng.normal(
        0, 0.1, len(FINE.vertices)
    )
    new = rng.permutation(len(f))
    values = np.empty_like(f)
    values[new] = f
    vertices = np.empty_like(FINE.vertices)
    vertices[new] = FINE.vertices
    other = TriangleMesh(vertices, new[FINE.faces])
    assert_array_equal(persistence(other, values), persistence(FINE, f))
    assert_allclose(
        persistence(FINE, factor * f + offset),
        factor * persistence(FINE, f),
        rtol=0,
        atol=1e-12 * (1e3 + factor),
    )
    assert peaks(FINE, -f) == peaks(FINE, f)[::-1]


@given(SEEDS, st.floats(0, 0.5), st.floats(0, 1))
def test_a_small_change_pairs_peaks_up(seed, change, least):
    """The theorem of stability: what stands out by ``least + 2 change`` before stands out by
    ``least`` afterwards.
    """
    rng = np.random.default_rng(seed)
    f = rng.normal(size=len(FINE.vertices))
    g = f + rng.uniform(-change, change, len(f))
    assert (persistence(FINE, f) >= least + 2 * change).sum() <= (
        persistence(FINE, g) >= least - 1e-12
    ).sum()


@given(SEEDS)
def test_functions_that_are_near_are_never_told_different(seed):
    rng = np.random.default_rng(seed)
    f = np.sin(6 * FINE.vertices @ rng.normal(size=(3, 2))).sum(axis=1)
    g = f + rng.uniform(-0.09, 0.09, len(f)) * np.ptp(f)
    assert peaks_apart(FINE, f, g) is None


def test_functions_with_other_peaks_are_told():
    found = peaks_apart(FINE, gaussians(1), gaussians(3))
    assert found == (Extrema(1, 1), Extrema(3, 1))
    assert str(found[1]) == "3 peaks and 1 pit"
    assert peaks_apart(FINE, -gaussians(3), -gaussians(1)) == (Extrema(1, 3), Extrema(1, 1))
    assert peaks_apart(FINE, gaussians(2), -3 * gaussians(2)) == (Extrema(2, 1), Extrema(1, 2))
    assert peaks_apart(FINE, gaussians(2), gaussians(2)) is None


def edge_of(mesh):
    """Edge length of as many equal equilateral triangles as the mesh has."""
    return float(np.sqrt(4 / np.sqrt(3) / len(mesh.faces)))


def gaussian(mesh, vertex, edges):
    """Gaussian so many even edges wide."""
    return bump(mesh, mesh.vertices[vertex], edges * edge_of(mesh))


@pytest.mark.parametrize("width", [1.0, 1.5, 2.0, 3.0, 5.0, 8.0])
def test_a_gaussian_is_as_wide_as_it_is(width):
    for mesh, vertex in (
        (icosphere(5), 0),
        (icosphere(5), 5000),
        (square(48), 1250),
        (disc(30), 400),
    ):
        assert_allclose(resolution(mesh, gaussian(mesh, vertex, width)), width, rtol=0.15)


def test_constants_scales_and_units_do_not_matter():
    mesh = torus(60, 40)
    f = gaussian(mesh, 100, 4)
    found = resolution(mesh, f)
    assert_allclose(resolution(mesh, 1000 - 3 * f), found, rtol=1e-9)
    assert_allclose(resolution(TriangleMesh(1e-5 * mesh.vertices, mesh.faces), f), found, rtol=1e-9)


def test_twice_as_many_edges_on_the_subdivided_mesh():
    mesh = icosphere(4)
    f = gaussian(mesh, 100, 4)
    assert_allclose(
        resolution(subdivided(mesh), interpolated(mesh, f)), 2 * resolution(mesh, f), rtol=0.1
    )


def test_the_narrower_of_two_bumps_counts():
    mesh = icosphere(5)
    narrow, wide = gaussian(mesh, 0, 2), gaussian(mesh, int(mesh.vertices[:, 2].argmin()), 12)
    assert resolution(mesh, wide) > 10
    assert 2 < resolution(mesh, narrow + wide) < 3
    assert resolution(mesh, np.stack([wide, narrow], axis=1)) == resolution(mesh, narrow)


def test_edges_count_where_the_function_varies():
    """Inside a fine patch of a mesh that is coarse elsewhere."""
    even = square(40)
    uneven = TriangleMesh(even.vertices**2 * [1, 1, 0], even.faces)  # fine towards one corner
    fine, coarse = ([0.1, 0.1, 0], [0.8, 0.8, 0])
    assert resolution(uneven, bump(uneven, fine, 0.05)) > 2 * resolution(
        uneven, bump(uneven, coarse, 0.05)
    )


def test_a_jump_spans_half_an_edge_and_a_constant_any_number():
    mesh = icosphere(4)
    assert resolution(mesh, (mesh.vertices[:, 2] > 0.1).astype(float)) == 0.5
    assert resolution(mesh, np.full(len(mesh.vertices), 3.3)) == np.inf
    assert (
        resolution(mesh, 3.3 + 1e-12 * np.random.default_rng(0).normal(size=len(mesh.vertices)))
        == np.inf
    )
    assert resolution(mesh, np.zeros(len(mesh.vertices))) == np.inf
