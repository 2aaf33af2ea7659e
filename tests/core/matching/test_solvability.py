"""Properties of functions: bounds, constants, distances, peaks and resolution."""

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from abfm.calculus.operators import l2_norm
from abfm.matching import solvability
from abfm.matching.objective.matching_energy import MatchingEnergy
from abfm.matching.solvability import Extrema, peaks, persistence, range_bound, resolution
from abfm.matching.terms.functions import FunctionTerm
from abfm.mesh import TriangleMesh
from abfm.mesh.subdivision import interpolated, subdivided
from tests.core.fields import bump
from tests.core.surfaces import SURFACES, renumbered
from tests.shapes import disc, icosphere, open_cylinder, square, torus

SPHERE, FINE, BALL = icosphere(2), icosphere(3), icosphere(4)
COUNT = len(SPHERE.vertices)
SEEDS = st.integers(0, 10**6)


def random_problem(seed):
    rng = np.random.default_rng(seed)
    source, target = rng.normal(size=(2, 2, COUNT)) * rng.uniform(0.1, 2, (2, 2, 1))
    mask = rng.integers(0, 2, COUNT) * rng.uniform(size=COUNT)
    return FunctionTerm(SPHERE, source.T, target.T, mask, rng.uniform(size=2))


def at(degrees, width=0.15):
    """Return a Gaussian on the unit sphere at this angle from the pole."""
    angle = np.deg2rad(degrees)
    return bump(SPHERE, [0, np.sin(angle), np.cos(angle)], width)


def term(f, g, *weighted):
    return FunctionTerm(SPHERE, f, g, *weighted)


def pair(one, other):
    return np.stack([one, other], axis=1)


@given(SEEDS)
def test_no_rearrangement_is_below_the_bound(seed):
    """Any other order of the source's values, as a flow gives, has at least this residual."""
    problem, rng = random_problem(seed), np.random.default_rng(seed)
    source, target, bound = problem.source, problem.target, range_bound(problem)
    given = {"mask": problem.mask, "weights": problem.weights}
    energy = MatchingEnergy(SPHERE, source.T, target.T, **given)
    found = problem.residual(source)
    assert found == pytest.approx(energy.residual(source), rel=1e-12)
    root = np.sqrt(problem.weights)[:, None]
    mean = (target @ problem.areas / problem.areas.sum())[:, None]
    norms = [
        l2_norm(SPHERE, (root * h).T, problem.mask)
        for h in (source - target, target - mean, target)
    ]
    assert found == pytest.approx(norms[0] / norms[1], rel=1e-12)
    assert problem.mismatch(source) == pytest.approx(norms[0] / norms[2], rel=1e-12)
    deviation = source - (source @ problem.areas / problem.areas.sum())[:, None]
    assert problem.deviation(source) == pytest.approx(problem.norm(deviation), rel=1e-12)
    low, high = source.min(axis=1, keepdims=True), source.max(axis=1, keepdims=True)
    for made in (rng.permuted(source, axis=1), rng.uniform(low, high, source.shape)):
        assert problem.residual(made) >= bound
    best = np.clip(target, low, high)
    assert problem.residual(best) == pytest.approx(bound, rel=1e-12)


@given(SEEDS, st.floats(1e-3, 1e3), st.floats(1, 3))
def test_bound_is_scale_invariant_and_monotonic(seed, unit, wider):
    problem = random_problem(seed)
    source, target, weighted = problem.source, problem.target, (problem.mask, problem.weights)
    scaled = term(unit * source.T, unit * target.T, *weighted)
    assert range_bound(scaled) == pytest.approx(range_bound(problem), rel=1e-9)
    middle = (source.min(axis=1) + source.max(axis=1))[:, None] / 2
    wide = middle + wider * (source - middle)
    assert range_bound(term(wide.T, target.T, *weighted)) <= range_bound(problem) + 1e-12


def test_bound_of_known_functions_is_exact():
    # both peaks are sampled at different vertices
    assert range_bound(term(at(0), at(40))) < 0.05
    assert range_bound(term(at(0) - at(180), 0.9 * at(0))) == 0
    flat = np.full(COUNT, 0.5)
    assert range_bound(term(flat, 2 * flat)) == pytest.approx(0.5)
    still = term(flat, at(0)).residual(flat[None])
    assert range_bound(term(flat, at(0))) == pytest.approx(still)


def test_masked_values_do_not_affect_the_bound():
    source, target, mask, flat = at(0), at(0).copy(), np.ones(COUNT), np.full(COUNT, 0.3)
    target[:5], mask[:5] = 9, 0
    assert range_bound(term(source, target)) > 0.5
    assert range_bound(term(source, target, mask)) == 0
    both = term(pair(source, source), pair(source, target), None, [1.0, 0])
    assert range_bound(both) == 0
    assert not solvability.source_is_constant(both)
    assert solvability.first_difference(both) is None
    outside = flat.copy()
    outside[:5] = 1
    assert solvability.source_is_constant(term(flat, at(0)))
    # a flow may move source values from masked vertices to others
    assert not solvability.source_is_constant(term(outside, at(0), mask))
    assert solvability.target_is_constant(term(at(0), outside, mask))
    assert not solvability.target_is_constant(term(at(0), outside))


def test_vanished_unmoved_and_squeezed_sources_are_found():
    f, halfway, g = at(0), at(45), at(90)
    problem = term(f, g)
    assert solvability.vanished(problem, (0.01 * at(30) + 0.1)[None])
    assert not solvability.vanished(problem, (0.5 * at(30))[None])
    assert solvability.hardly_moved(problem, (f + 0.01 * at(30))[None])
    assert not solvability.hardly_moved(problem, (at(20))[None])
    # not vanished, as the target is also small
    assert not solvability.vanished(term(f, 0.01 * g), (0.01 * at(30))[None])
    assert solvability.distance(term(f, 2 * f)) == 0  # the source is nowhere larger
    assert solvability.squeezed(problem, 0.5 * f[None])
    assert not solvability.squeezed(problem, 0.8 * f[None])  # not yet small
    assert not solvability.squeezed(problem, halfway[None])
    assert not solvability.squeezed(problem, 0.5 * g[None])  # moved, but smaller
    assert not solvability.squeezed(term(f, 0.4 * f), 0.5 * f[None])  # the target is smaller


@given(st.floats(10, 80))
def test_distance_is_that_between_gaussians(degrees):
    mesh, distance = square(20), degrees / 200
    f, g = (bump(mesh, [0.5, y, 0], 0.04) for y in (0.3, 0.3 + distance))
    found = solvability.distance(FunctionTerm(mesh, f, g))
    # the overlap cancels, so the centres of the difference are farther apart
    assert distance * 0.95 <= found <= distance + 0.04 * 0.04 * 4 / distance
    assert found == solvability.distance(FunctionTerm(mesh, g, f))


def test_peaks_are_not_compared_with_a_mask():
    one, two = at(0, 0.1), np.maximum(at(0, 0.1), at(120, 0.1))
    assert solvability.first_difference(term(one, two)) == (0, (1, 1), (2, 1))
    half = (SPHERE.vertices[:, 2] > 0).astype(float)
    assert solvability.first_difference(term(one, two, half)) is None
    assert solvability.first_difference(term(pair(two, two), pair(two, one))) == (1, (2, 1), (1, 1))


def gaussians(count):
    places = np.array([[0, 0, 1.0], [0, 1, 0], [1, 0, 0]])[:count]
    return np.max([bump(FINE, place, 0.1) for place in places], axis=0)


def slow_persistence(mesh, f):
    """Return persistences by a search for a higher vertex above each lower value."""
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


@given(SEEDS, st.integers(1, 3))
def test_small_noise_adds_no_peaks(seed, count):
    noise = np.random.default_rng(seed).uniform(-0.04, 0.04, len(FINE.vertices))
    assert peaks(FINE, gaussians(count)) == (count, 1)
    assert peaks(FINE, gaussians(count) + noise) == (count, 1)
    assert len(persistence(FINE, gaussians(count) + noise)) > 3


def test_peaks_are_counted_on_plateaus_and_boundaries():
    for value in (0.0, 0.1, -7.0):
        assert peaks(FINE, np.full(len(FINE.vertices), value)) == (0, 0)
    assert peaks(FINE, 0.1 + 1e-17 * FINE.vertices[:, 0]) == (0, 0)
    x, y, _ = FINE.vertices.T
    assert_array_equal(persistence(FINE, (x > 0.5).astype(float)), [1])
    assert peaks(FINE, (np.abs(x) > 0.5).astype(float), 0.0) == (2, 1)
    assert peaks(FINE, np.sign(x * y) * (np.abs(x * y) > 0.2)) == (2, 2)
    mesh = square(12)
    x, y, _ = mesh.vertices.T
    assert peaks(mesh, x) == (1, 1)
    assert peaks(mesh, (2 * x - 1) * (2 * y - 1)) == (2, 2)
    assert peaks(mesh, (x - 0.5) ** 2 + (y - 0.5) ** 2) == (4, 1)


def test_persistence_is_the_height_above_the_pass():
    """Of two equal Gaussians, one counts from the lowest value, the other from the saddle."""
    width, distance = 0.15, 1.5  # in sqrt(area), and in radians

    def height(angle):
        return float(np.exp(-((2 * np.sin(angle / 2)) ** 2) / (2 * width**2 * 4 * np.pi)))

    f = sum(bump(BALL, [0, np.sin(angle), np.cos(angle)], width) for angle in (0.0, distance))
    top, saddle = 1 + height(distance), 2 * height(distance / 2)
    found = persistence(BALL, f)
    assert_allclose(found[:2], [top, top - saddle], atol=0.01)
    assert len(found) == 2


@pytest.mark.parametrize(
    "name", [name for name, mesh in SURFACES.items() if len(mesh.vertices) < 130]
)
def test_persistence_agrees_with_direct_search(name):
    mesh = SURFACES[name]
    count = len(mesh.vertices)
    rng = np.random.default_rng(count)
    for f in (rng.normal(size=count), rng.integers(0, 4, count).astype(float)):
        assert_allclose(persistence(mesh, f), slow_persistence(mesh, f), rtol=0, atol=1e-15)


@given(SEEDS, st.floats(1e-3, 1e3), st.floats(-1e3, 1e3))
def test_persistence_is_invariant(seed, factor, offset):
    rng = np.random.default_rng(seed)
    f = np.sin(3 * FINE.vertices @ rng.normal(size=(3, 2))).sum(axis=1)
    f += rng.normal(0, 0.1, len(f))
    found, (mesh, vertices, _) = persistence(FINE, f), renumbered(FINE, seed)
    assert_array_equal(persistence(mesh, f[vertices]), found)
    scaled = persistence(FINE, factor * f + offset)
    assert_allclose(scaled, factor * found, rtol=0, atol=1e-12 * (1e3 + factor))
    assert peaks(FINE, -f) == peaks(FINE, f)[::-1]


@given(SEEDS, st.floats(0, 0.5), st.floats(0, 1))
def test_persistence_is_stable(seed, change, least):
    """A peak remains if its persistence exceeds twice the change of the function."""
    rng = np.random.default_rng(seed)
    f = rng.normal(size=len(FINE.vertices))
    after = persistence(FINE, f + rng.uniform(-change, change, len(f)))
    assert (persistence(FINE, f) >= least + 2 * change).sum() <= (after >= least - 1e-12).sum()


@given(SEEDS)
def test_similar_functions_have_no_extrema_difference(seed):
    rng = np.random.default_rng(seed)
    f = np.sin(6 * FINE.vertices @ rng.normal(size=(3, 2))).sum(axis=1)
    g = f + rng.uniform(-0.09, 0.09, len(f)) * np.ptp(f)
    assert solvability.extrema_difference(FINE, f, g) is None


def test_different_numbers_of_peaks_are_found():
    found = solvability.extrema_difference(FINE, gaussians(1), gaussians(3))
    assert found == (Extrema(1, 1), Extrema(3, 1))
    assert str(found[1]) == "3 peaks and 1 pit"
    extrema = Extrema(1, 3), Extrema(1, 1)
    assert solvability.extrema_difference(FINE, -gaussians(3), -gaussians(1)) == extrema
    assert solvability.extrema_difference(FINE, gaussians(2), -3 * gaussians(2)) == (
        Extrema(2, 1),
        Extrema(1, 2),
    )
    assert solvability.extrema_difference(FINE, gaussians(2), gaussians(2)) is None


@given(SEEDS, st.floats(0.01, 100), st.floats(-10, 10))
def test_rotated_disc_has_no_boundary_difference(seed, factor, offset):
    mesh, rng = disc(16), np.random.default_rng(seed)
    waves, angle = rng.normal(size=(2, 3)) * 3, rng.uniform(0, 2 * np.pi)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    points = mesh.vertices[:, :2]
    f, g = (np.sin(places @ waves).sum(axis=1) for places in (points, points @ turn))
    assert solvability.boundary_difference(mesh, factor * f + offset, factor * g + offset) is None


def test_different_boundary_values_are_found():
    mesh = disc(16)
    inner, outer = (bump(mesh, [place, 0, 0], 0.1) for place in (0, 1))
    words = "values from 0 to 1 on a boundary", "values from 0 to 0 there"
    assert solvability.boundary_difference(mesh, outer, inner) == words
    assert solvability.first_difference(FunctionTerm(mesh, 3 * inner, 3 * outer)) == (
        *(0, "values from 0 to 0 on a boundary"),
        "values from 0 to 3 there",
    )
    assert solvability.boundary_difference(mesh, outer, bump(mesh, [0, 1, 0], 0.1)) is None
    height = SPHERE.vertices[:, 2]
    assert solvability.boundary_difference(SPHERE, height, -height) is None


def test_boundaries_are_compared_separately():
    mesh = open_cylinder(24, 24)
    ends = mesh.vertices[:, 2].min(), mesh.vertices[:, 2].max()
    low, high = (bump(mesh, [1, 0, z], 0.1) for z in ends)
    assert peaks(mesh, low) == peaks(mesh, high)
    here, there = solvability.boundary_difference(mesh, low, high)
    assert {here.split()[4], there.split()[4]} == {"0", "1"}
    assert solvability.boundary_difference(mesh, low, bump(mesh, [-1, 0, ends[0]], 0.1)) is None


def test_parts_at_a_pinched_vertex_are_separate():
    """Two spheres share a vertex, through which no flow moves a bump."""
    count = len(SPHERE.vertices)
    both = np.concatenate([SPHERE.vertices, SPHERE.vertices + np.array([2, 0, 0])])
    ends = int(np.argmax(SPHERE.vertices[:, 0])), count + int(np.argmin(SPHERE.vertices[:, 0]))
    both[list(ends)] = [1, 0, 0]
    faces = np.concatenate([SPHERE.faces, count + SPHERE.faces])
    mesh = TriangleMesh(both, np.where(faces == ends[1], ends[0], faces))
    assert mesh.is_pinched_vertex.sum() == 1
    left, higher, right = (bump(mesh, at, 0.05) for at in ([-1, 0, 0], [0, 0, 1], [3, 0, 0]))
    assert peaks(mesh, left) == peaks(mesh, right)
    assert solvability.boundary_difference(mesh, left, higher) is None
    expected = "values from 0 to 1 on a part joined only at vertices", "values from 0 to 0 there"
    assert solvability.boundary_difference(mesh, left, right) == expected
    assert solvability.first_difference(FunctionTerm(mesh, left, right)) == (0, *expected)


def ridges(*heights):
    """Return a strip, and a function with these heights along it."""
    count = len(heights)
    places = np.stack(np.meshgrid(np.arange(count), [0, 1], [0]), axis=-1).reshape(-1, 3)
    left, right = np.arange(count - 1), np.arange(1, count)
    faces = [[left, right, left + count], [right, right + count, left + count]]
    mesh = TriangleMesh(places, np.concatenate([np.stack(face, axis=1) for face in faces]))
    return mesh, np.tile(np.array(heights, dtype=float), 2)


def test_equal_persistence_at_other_values_is_found():
    mesh, f = ridges(0, 1, 0.5, 0.9, 0)
    _, g = ridges(0, 1, 0.2, 0.6, 0)
    assert_allclose(persistence(mesh, f), persistence(mesh, g), atol=1e-12)
    high, low = "a peak at 0.9 above a pass at 0.5", "a peak at 0.6 above a pass at 0.2"
    assert solvability.extrema_difference(mesh, f, g) == (high, low)
    _, shifted = ridges(0.09, 0.91, 0.41, 0.99, 0.09)
    assert solvability.extrema_difference(mesh, f, shifted) is None


DIAGRAMS = st.lists(st.tuples(*[st.integers(0, 9)] * 2).filter(lambda row: row[0] > row[1]))


@given(DIAGRAMS.filter(lambda rows: len(rows) < 4), DIAGRAMS.filter(lambda rows: len(rows) < 4))
def test_unpaired_peaks_agree_with_all_pairings(one, other):
    """Peaks are unpaired only at differences below the bottleneck distance of all pairings."""
    here, there = ([*rows, *[None] * len(others)] for rows, others in ((one, other), (other, one)))

    def cost(a, b):
        if a and b:
            return max(abs(a[0] - b[0]), abs(a[1] - b[1]))
        return sum((row[0] - row[1]) / 2 for row in (a, b) if row)

    least = min(
        max((cost(a, b) for a, b in zip(here, order, strict=True)), default=0)
        for order in permutations(there)
    )
    rows = [np.array(diagram, dtype=float).reshape(-1, 2) for diagram in (one, other)]
    for difference in range(10):
        unpaired = [solvability._unpaired(*pair, difference) for pair in (rows, rows[::-1])]
        assert (least <= difference) == (not any(map(len, unpaired)))


def gaussian(mesh, vertex, edges):
    """Return a Gaussian with a width of this many edges of equilateral triangles."""
    return bump(mesh, mesh.vertices[vertex], edges * np.sqrt(4 / np.sqrt(3) / len(mesh.faces)))


@pytest.mark.parametrize("width", [1.0, 1.5, 2.0, 3.0, 5.0, 8.0])
def test_resolution_of_a_gaussian_is_its_width(width):
    ball = icosphere(5)
    for mesh, vertex in ((ball, 0), (ball, 5000), (square(48), 1250), (disc(30), 400)):
        assert_allclose(resolution(mesh, gaussian(mesh, vertex, width)), width, rtol=0.15)


def test_resolution_is_invariant():
    mesh = torus(60, 40)
    f = gaussian(mesh, 100, 4)
    found = resolution(mesh, f)
    assert_allclose(resolution(mesh, 1000 - 3 * f), found, rtol=1e-9)
    assert_allclose(resolution(TriangleMesh(1e-5 * mesh.vertices, mesh.faces), f), found, rtol=1e-9)
    f = gaussian(BALL, 100, 4)
    found = resolution(subdivided(BALL), interpolated(BALL, f))
    assert_allclose(found, 2 * resolution(BALL, f), rtol=0.1)


def test_resolution_is_that_of_the_narrowest_feature():
    """On uneven meshes, only edges count along which the function varies."""
    mesh = icosphere(5)
    narrow, wide = gaussian(mesh, 0, 2), gaussian(mesh, int(mesh.vertices[:, 2].argmin()), 12)
    assert resolution(mesh, wide) > 10
    assert 2 < resolution(mesh, narrow + wide) < 3
    assert resolution(mesh, pair(wide, narrow)) == resolution(mesh, narrow)
    even = square(40)
    uneven = TriangleMesh(even.vertices**2 * [1, 1, 0], even.faces)  # finer near one corner
    fine, coarse = (resolution(uneven, bump(uneven, [x, x, 0], 0.05)) for x in (0.1, 0.8))
    assert fine > 2 * coarse


def test_jumps_have_resolution_one_half_and_constants_infinity():
    assert resolution(BALL, (BALL.vertices[:, 2] > 0.1).astype(float)) == 0.5
    flat = np.full(len(BALL.vertices), 3.3)
    noise = 1e-12 * np.random.default_rng(0).normal(size=len(flat))
    for f in (flat, flat + noise, 0 * flat):
        assert resolution(BALL, f) == np.inf
