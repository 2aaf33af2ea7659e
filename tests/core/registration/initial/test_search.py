"""The search among initial maps: costs of candidates, relaxation, and the choice."""

import tracemalloc
from functools import cache

import numpy as np
import pytest
from hypothesis import given as drawn
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

import abfm
from abfm.maps import PointMap, map_accuracy
from abfm.maps.functional_maps import nearest
from abfm.mesh import TriangleMesh, shapes
from abfm.mesh.coarsening import coarsened
from abfm.registration.initial import Landmarks, initial_map, sphere_maps
from abfm.registration.initial.map_input import MapInput
from abfm.registration.initial.searching import extremities
from abfm.registration.initial.searching.coarse_shape import coarse_shape, ranks
from abfm.registration.initial.searching.map_cost import map_cost
from abfm.registration.initial.searching.reversible import relax, two_way_map
from abfm.registration.initial.searching.search import Relaxed, Start, _Search
from tests.messages import raises
from tests.shapes import icosphere

BODY = shapes.five_limbs(400)
FINE = shapes.five_limbs(700)
COARSE = coarse_shape(FINE, 300)
TURN = Rotation.from_rotvec([2, 1, -1])


def cost_of(a, b, to_a):
    descriptors = a.descriptors, b.descriptors
    return map_cost(a, b, two_way_map(a, b, to_a), descriptors, np.ones(5))


def mirrored(mesh):
    return TriangleMesh(mesh.vertices * [-1, 1, 1], mesh.faces[:, ::-1])


def other_body(stretch=(1, 1.5, 1), seed=0):
    """Return a stretched, moved and remeshed body, and its true vertices of `BODY`."""
    fewer = coarsened(BODY, 340)
    order = np.random.default_rng(seed).permutation(len(fewer.vertices))
    faces = np.argsort(order)[fewer.faces]
    truth = PointMap.project(fewer, BODY, fewer.vertices).nearest_vertices()[order]
    vertices = 3 * TURN.apply(fewer.vertices[order] * stretch) + [5, 0, 0]
    return TriangleMesh(vertices, faces), truth


def test_identity_costs_two():
    found = cost_of(COARSE, COARSE, np.arange(len(COARSE.areas)))
    assert_allclose(found[:4], (2, 0, 0, 1), atol=1e-9)
    assert found.total() == pytest.approx(2)
    assert found.total(side=-1) == pytest.approx(3)


def test_mirror_image_has_the_same_cost():
    identity = np.arange(len(COARSE.areas))
    image = mirrored(COARSE.mesh)
    shape = coarse_shape(image, 300)
    found = cost_of(shape, COARSE, identity)
    # rays of the shape diameter are not symmetric on the mesh
    assert_allclose(found[:4], (2, 0, 0, -1), atol=0.1)


def test_relaxation_reduces_the_energy():
    rng = np.random.default_rng(0)
    around = np.argsort(COARSE.distances, axis=1)[:, :20]
    to_a = around[np.arange(len(around)), rng.integers(0, 20, len(around))]
    start = two_way_map(COARSE, COARSE, to_a)
    none = COARSE.descriptors[:, :0]
    settings = {"weight": 0, "penalties": np.geomspace(0.05, 10, 8), "iterations": 2}
    found = relax(COARSE, COARSE, start, (none, none), **settings)

    def error(map_):
        return COARSE.areas @ COARSE.distances[map_, np.arange(len(map_))]

    assert cost_of(COARSE, COARSE, found.to_a).energy < cost_of(COARSE, COARSE, to_a).energy / 2
    assert error(found.to_a) < 0.5 * error(to_a)


def test_distances_on_a_sphere_are_hardly_too_short():
    """Graph distances over unfolded faces are 2% too long on average, and hardly ever too short."""
    ball = coarse_shape(icosphere(3), 1000)
    directions = ball.mesh.vertices * np.sqrt(4 * np.pi)
    true = np.arccos(np.clip(directions @ directions.T, -1, 1)) / np.sqrt(4 * np.pi)
    far = true > 0.05
    ratio = ball.distances[far] / true[far]
    assert ratio.min() > 0.98
    assert ratio.mean() < 1.02
    assert np.percentile(ratio, 95) < 1.05


@drawn(st.lists(st.floats(-100, 100), min_size=3, max_size=30))
def test_ranks_do_not_depend_on_monotone_scales(values):
    f = np.unique(np.round(values, 3))[:, None]
    areas = np.arange(1.0, len(f) + 1)
    areas /= areas.sum()
    found = ranks(f, areas)
    assert_allclose(ranks(np.exp(f / 50), areas), found)
    assert_allclose(areas @ found, 0, atol=1e-12)
    assert (np.diff(found[:, 0]) > 0).all()


def test_equal_values_have_equal_ranks():
    areas = np.full(4, 0.25)
    found = ranks(np.array([[1.0], [3], [3], [2]]), areas)[:, 0]
    assert found[1] == found[2] > found[3] > found[0]


def test_extremities_are_ends_of_limbs():
    ends = extremities.extremities(COARSE)
    assert len(ends) == 5
    assert len(extremities.extremities(coarse_shape(icosphere(3), 300))) <= 6


def test_brackets_distinguish_mirror_images():
    ends = extremities.extremities(COARSE)
    for side in (1, -1):
        to_a = extremities.map_by_vertices(COARSE, COARSE, ends, ends, side)
        assert side * cost_of(COARSE, COARSE, to_a).side > 0.2
    to_a = extremities.map_by_vertices(COARSE, COARSE, ends, ends, 1)
    assert_array_equal(to_a, np.arange(len(to_a)))


@cache
def found_on_other_body(method):
    """Return the map of `BODY` onto a body of other proportions, and its true vertices."""
    b, truth = other_body((1, 1.2, 1))
    return initial_map(method, MapInput(BODY, b)).correspondence, truth


@pytest.mark.parametrize("method", [None, "spectral", "extremities"])
def test_body_of_other_proportions_is_mapped(method):
    found, truth = found_on_other_body(method)
    assert map_accuracy(found.points, truth, 150).mean < 0.08
    distortion = found.distortion()
    assert distortion.folded == distortion.collapsed == 0
    assert found.candidates[0].name == (method or found.candidates[0].name)
    costs = [each.cost for each in found.candidates[1:]]
    assert costs == sorted(costs)


def test_incompatible_functions_have_little_influence():
    b, truth = other_body()
    rng = np.random.default_rng(1)
    f = rng.normal(size=(6, len(BODY.vertices))) ** 3
    g = rng.uniform(size=(6, len(b.vertices)))
    found = initial_map("spectral", MapInput(BODY, b, f, g)).correspondence
    assert map_accuracy(found.points, truth, 150).mean < 0.08


def test_mirror_image_is_found_on_request():
    b, truth = other_body((1, 1, 1))
    found = initial_map("spectral:mirror", MapInput(mirrored(BODY), b)).correspondence
    assert found.is_mirrored
    assert map_accuracy(found.points, truth, 150).mean < 0.08
    assert found.distortion().folded == found.distortion().collapsed == 0


def test_spheres_with_equal_faces_may_be_rotated():
    ball = icosphere(2)
    weights = np.random.default_rng(3).normal(size=(3, 3))
    f = np.cos(ball.vertices @ weights * 2).sum(axis=1)
    turn = Rotation.from_rotvec([0.3, 0.7, -0.4])
    g = np.cos(turn.inv().apply(ball.vertices.copy()) @ weights * 2).sum(axis=1)
    found = initial_map(None, MapInput(ball, ball, f[None], g[None])).correspondence
    assert found.candidates[0].name == "sphere"
    places = turn.inv().apply(ball.vertices.copy())
    assert np.linalg.norm(found.points.positions - places, axis=1).mean() < 0.03


def test_no_search_if_vertex_numbers_are_good(monkeypatch):
    ball = icosphere(2)
    f, g = ball.vertices[None, :, 2], (ball.vertices @ [0.3, 0.2, 0.9])[None]
    given, directions = MapInput(ball, ball, f, g), (ball.vertices, ball.vertices)
    for mirror in (False, True):
        other = sphere_maps.map_through_spheres(given, *directions, mirror).correspondence
        assert sphere_maps._cost(given, other) >= 0
    monkeypatch.delattr(sphere_maps, "map_through_spheres")
    found = initial_map(None, given).correspondence
    assert [each.name for each in found.candidates] == ["connectivity"]
    assert_array_equal(found.points.positions, ball.vertices)


def test_spheres_of_both_hemispheres_are_mirrored():
    ball = icosphere(2)
    rng = np.random.default_rng(3)
    weights, phases = 3 * rng.normal(size=(3, 8)), rng.uniform(0, 6, 8)
    f = np.cos(ball.vertices @ weights + phases).sum(axis=1)
    g = np.cos(ball.vertices * [-1, 1, 1] @ weights + phases).sum(axis=1)
    found = initial_map(None, MapInput(ball, ball, f[None], g[None])).correspondence
    assert found.candidates[0].name == "sphere:mirror"


def test_mirror_image_with_a_boundary_is_found():
    body = shapes.five_limbs(200)
    upper = body.faces[body.vertices[body.faces, 2].mean(axis=1) > -0.3]
    half = TriangleMesh(body.vertices, upper, largest_component=True)
    other = TriangleMesh(TURN.apply(half.vertices.copy()), half.faces[::-1])
    a = mirrored(half)
    found = initial_map("auto:mirror", MapInput(a, other)).correspondence
    assert found.is_mirrored
    gaps = np.linalg.norm(found.points.positions - a.vertices, axis=1)
    assert np.median(gaps) < 0.1 * half.length_scale


def test_files_store_candidates(tmp_path):
    found, _ = found_on_other_body("extremities")
    found.save(tmp_path / "map.npz")
    assert abfm.load(tmp_path / "map.npz").candidates == found.candidates
    elsewhere = TriangleMesh(found.b.vertices + 1, found.b.faces)
    assert found.on_surfaces(BODY, elsewhere).candidates == found.candidates


def test_methods_that_do_not_apply_are_refused():
    ball = icosphere(2)
    longer = TriangleMesh(ball.vertices * [1, 1, 3], ball.faces)
    with raises(abfm.AbfmError, 2):
        initial_map("extremities", MapInput(FINE, longer))
    landmarks = Landmarks.of_vertices(ball, ball, [0, 1], [0, 1])
    with raises(abfm.AbfmError, 2, 3):
        initial_map("landmarks", MapInput(ball, ball, landmarks=landmarks))


def test_fine_meshes_need_no_distance_matrix():
    ball = icosphere(5)
    a = TriangleMesh(ball.vertices * [1, 1.3, 1.7], ball.faces)
    b = TriangleMesh(ball.vertices * [1, 1.4, 1.7], ball.faces)
    found = _Search(MapInput(a, b))
    pair = found.pair(1000)
    same = two_way_map(pair.a, pair.b, nearest(pair.b.mesh.vertices, pair.a.mesh.vertices))
    best = Relaxed(Start("closest", 1, lambda _: same.to_a), same, 2.0, pair.cost(same), 0.0)
    tracemalloc.start()
    found.polished(best)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < len(a.vertices) * len(b.vertices)  # bytes; a matrix has at least 4 an entry
