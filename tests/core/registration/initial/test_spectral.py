"""Maps by eigenfunctions: copies, poses, mirror images and symmetric bodies."""

from typing import NamedTuple

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from abfm.calculus.eigenbasis import unit_eigenbasis
from abfm.errors import AbfmError, FunctionError
from abfm.experiments.scripts import bundled
from abfm.maps import PointMap, functional_map, map_accuracy, vertex_points
from abfm.mesh import TriangleMesh, shapes
from abfm.mesh.coarsening import coarsened
from abfm.registration.initial import Landmarks, SpectralSearch, spectral
from abfm.registration.initial.descriptors import Hints, map_of_descriptors
from abfm.registration.initial.sign_search import candidates
from abfm.registration.initial.spectra import Spectra
from tests.core.surfaces import renumbered
from tests.messages import raises
from tests.shapes import icosphere, tetrahedron

BODY = shapes.five_limbs(200)
TURNED = shapes.two_armed(2)  # symmetric under half a turn
HALF_TURN = PointMap.project(TURNED, TURNED, TURNED.vertices * [-1, -1, 1]).nearest_vertices()


def moved(mesh, side=1):
    vertices = 7 * side * Rotation.from_rotvec([1, -2, 0.4]).apply(mesh.vertices.copy()) + [9, 8, 7]
    return TriangleMesh(vertices, mesh.faces[:, ::side])


def bent(mesh):
    """Return the mesh rolled up about an axis, which is nearly isometric for flat parts."""
    x, y, z = mesh.vertices.T
    angle, radius = x / 3, 3 + z
    return TriangleMesh(
        np.stack([radius * np.sin(angle), y, radius * np.cos(angle)], axis=1), mesh.faces
    )


class Fit(NamedTuple):
    """The best map, its orientation and defect, and the smallest defect of a different map."""

    functional_map: np.ndarray
    side: float
    defect: float
    rival: float


def start(a, b, mirrored=False, **known):
    search, side = SpectralSearch(a, b, **known), -1 if mirrored else 1
    points_a, points_b = (mesh.vertices / mesh.length_scale for mesh in (a, b))

    def images(C):
        return points_a[search.nearest(C, points_a, points_b)]

    best, *others = search.ranked(side)
    rivals = [
        search.defect(C, side)
        for C in others
        if np.linalg.norm(images(C) - images(best), axis=1).mean() > 0.05
    ]
    points, C = search.finished(best)
    return points, Fit(C, search.side(C), search.defect(best, side), min(rivals))


def mean_error(points, truth):
    return map_accuracy(points, truth, count_max=150).mean


def test_moved_and_renumbered_copies_are_mapped_exactly():
    b, order, _ = renumbered(moved(BODY), 3)
    points, fit = start(BODY, b)
    assert (points.domain, points.codomain) == (b, BODY)
    assert_array_equal(points.nearest_vertices(), order)
    assert fit.side == pytest.approx(1, abs=0.02)
    assert 2 * fit.defect < fit.rival
    assert_allclose(np.abs(fit.functional_map[:6, :6]), np.eye(6), atol=0.01)


def test_mirror_images_are_found_on_request():
    b = moved(BODY, side=-1)
    points, fit = start(BODY, b, mirrored=True)
    assert_array_equal(points.nearest_vertices(), np.arange(len(b.vertices)))
    assert fit.side == pytest.approx(-1, abs=0.02)


def test_left_and_right_of_poses_are_distinguished():
    a, b = bundled("human_A.off"), bundled("human_B.off")
    points, fit = start(a, b)
    assert mean_error(points, None) < 0.005
    assert fit.side > 0.9
    assert fit.rival > 1.3 * fit.defect


def test_triangulation_has_little_influence():
    b = moved(coarsened(bundled("human_A.off"), 800))
    points, _ = start(bundled("human_A.off"), b)
    truth = PointMap.project(b, points.codomain, coarsened(points.codomain, 800).vertices)
    assert mean_error(points, truth.nearest_vertices()) < 0.02


def test_large_meshes_are_coarsened(monkeypatch):
    monkeypatch.setattr(spectral, "VERTICES_MAX", 130)
    b = bent(BODY)
    points, _ = start(BODY, b)
    assert_allclose(mean_error(points, None), 0, atol=0.04)
    assert len(np.unique(points.faces)) > 0.6 * len(b.vertices)


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("by", ["landmark", "function"])
def test_landmarks_and_functions_choose_between_equal_maps(by, turned):
    truth = HALF_TURN if turned else np.arange(len(TURNED.vertices))
    known = {}
    if by == "landmark":
        tip = int(TURNED.vertices[:, 0].argmax())
        known["landmarks"] = Landmarks.of_vertices(TURNED, TURNED, [truth[tip]], [tip])
    else:
        f = TURNED.vertices[:, :2]
        known["functions"] = f, f[truth]
    points, fit = start(TURNED, TURNED, **known)
    assert mean_error(points, truth) < 1e-3
    assert fit.rival > 2 * fit.defect


def test_symmetric_bodies_have_two_equal_maps():
    fit = start(TURNED, TURNED)[1]
    assert fit.rival < fit.defect + 0.05


def test_search_finds_compositions_with_symmetries():
    spectra = Spectra.of(TURNED, TURNED, 30, 300)
    found = candidates(spectra, [], 4)  # two of them nearly reverse the orientation
    for truth in (np.arange(len(TURNED.vertices)), HALF_TURN):
        expected = functional_map(PointMap.of_vertices(TURNED, TURNED, truth), 24)
        assert min(np.linalg.norm(C - expected) for C in found) < 0.15 * np.linalg.norm(expected)


def test_isometries_have_defect_0_and_a_side_of_1_or_minus_1():
    spectra = Spectra.of(BODY, moved(BODY, side=-1), 30, 300)
    truth = functional_map(PointMap.of_vertices(moved(BODY, side=-1), BODY), 30)
    assert spectra.defect(truth) < 1e-6
    assert spectra.side(truth) == pytest.approx(-1, abs=1e-6)
    # the bracket is quadratic in the map
    assert spectra.side(-truth) == pytest.approx(1, abs=1e-6)
    same = Spectra.of(BODY, BODY, 30, 300)
    assert same.side(np.eye(30)) == pytest.approx(1, abs=1e-6)
    assert same.defect(2 * np.eye(30)) == pytest.approx(3, abs=1e-6)
    assert same.defect(np.zeros((30, 30))) == pytest.approx(1)


def hints(mesh, vertices, k):
    rows = vertex_points(mesh, vertices).pull_back(unit_eigenbasis(mesh, k)[1])
    return vertex_points(mesh, vertices).positions / mesh.length_scale, rows


def test_descriptors_and_landmarks_determine_an_isometry():
    b, order, _ = renumbered(BODY, 1)
    on_a = np.array([3, 50, 100, 166])
    (places, rows_a), (_, rows_b) = hints(BODY, on_a, 15), hints(b, np.argsort(order)[on_a], 15)
    none = np.zeros((15, 0)), np.zeros((15, 0))
    found = map_of_descriptors(BODY, b, Hints(places, (rows_a, rows_b), np.ones(4), none), 15)
    assert_allclose(found, functional_map(PointMap.of_vertices(b, BODY, order), 15), atol=1e-6)


def test_landmark_weights_count():
    (places, right), (_, wrong) = hints(BODY, [3, 50, 100], 15), hints(BODY, [3, 50, 166], 15)
    none = np.zeros((15, 0)), np.zeros((15, 0))

    def found(count, weights):
        given = Hints(places[:count], (right[:count], wrong[:count]), np.array(weights), none)
        return map_of_descriptors(BODY, BODY, given, 15)

    assert np.linalg.norm(found(2, [1, 1]) - np.eye(15)) < 1e-5
    assert np.linalg.norm(found(3, [1, 1, 1]) - np.eye(15)) > 0.1
    assert np.linalg.norm(found(3, [1, 1, 1e-8]) - np.eye(15)) < 1e-5


def test_invalid_arguments_are_refused():
    for a, b, which in ((tetrahedron(), BODY, "A has 4"), (BODY, icosphere(1), "B has 42")):
        with raises(AbfmError, which, 60):
            SpectralSearch(a, b)
    f = BODY.vertices
    with raises(FunctionError, 3, 2):
        SpectralSearch(BODY, BODY, functions=(f, f[:, :2]))
    with raises(FunctionError, 200):
        SpectralSearch(BODY, BODY, functions=(f[:, 0], f[1:, 0]))
