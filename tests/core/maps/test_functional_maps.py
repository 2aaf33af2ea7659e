"""Functional maps, compared with isometries, the definition, and rotation characters."""

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose, assert_array_equal

import abfm
from abfm.assets import asset_path
from abfm.calculus.eigenbasis import eigenbasis
from abfm.calculus.operators import vertex_areas
from abfm.errors import AbfmError, FunctionError, ParameterError
from abfm.maps import functional_map, point_map, vertex_points, zoom_out
from abfm.maps.functional_maps import refined, spectral_coefficients, transfer
from abfm.maps.point_maps import PointMap
from abfm.maps.surface_points import SurfacePoints, points_by_area
from abfm.mesh import TriangleMesh, load_mesh
from tests.messages import raises
from tests.shapes import ellipsoid, icosphere


def subdivided(mesh):
    """Return the surface with every face divided into four; the old vertices come first."""
    return TriangleMesh(*trimesh.remesh.subdivide(mesh.vertices, mesh.faces))


def basis(mesh, k):
    return eigenbasis(mesh.normalized(), k)[1]


@pytest.fixture(scope="module")
def isometric():
    """Return a mesh, a moved, scaled and renumbered copy, and the map from the copy to the mesh."""
    plain = ellipsoid(3, 1.0, 1.4, 2.1)
    bumps = 1 + 0.1 * np.sin(plain.vertices[:, :1] + plain.vertices[:, 1:2])
    a = TriangleMesh(plain.vertices * bumps, plain.faces)
    old = np.random.default_rng(3).permutation(len(a.vertices))
    turn = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    vertices = 3.0 * a.vertices[old] @ turn.T + [1, 2, 3]
    b = TriangleMesh(vertices, np.argsort(old)[a.faces])
    return a, b, PointMap.of_vertices(b, a, old)


def test_isometries_have_diagonal_maps(isometric):
    assert_allclose(np.abs(functional_map(isometric[2], 15)), np.eye(15), atol=1e-6)


@pytest.mark.parametrize("rows", [25, 12])
def test_point_map_of_an_isometry_is_recovered(isometric, rows):
    """The point map of an isometry is exact, also by fewer rows of its functional map.

    The adjoint of the functional map would lead to wrong vertices.
    """
    a, b, truth = isometric
    found = point_map(a, b, functional_map(truth, 25)[:rows])
    assert_array_equal(found.positions, truth.positions)


def test_delta_functions_are_transferred_by_the_map():
    """Points are found by transferred delta functions, not by the adjoint of the map."""
    a, b = icosphere(1), ellipsoid(1, 1, 1.5, 2)
    C = np.random.default_rng(6).normal(size=(5, 8))
    gaps = np.linalg.norm(basis(b, 5)[:, None] - basis(a, 8) @ C.T, axis=2)
    assert_array_equal(point_map(a, b, C).positions, a.vertices[gaps.argmin(axis=1)])


def test_zoom_out_finds_an_isometry_from_few_functions(isometric):
    a, b, truth = isometric
    start = functional_map(truth, 4) + 0.05 * np.random.default_rng(0).normal(size=(4, 4))
    assert (point_map(a, b, start).positions != truth.positions).any()
    found = zoom_out(a, b, start, 30, step=2)
    assert found.shape == (30, 30)
    assert_allclose(found, functional_map(truth, 30), atol=1e-6)


def refined_errors(truth, few):
    """Return mean errors, in sqrt(area), with few eigenfunctions and after refinement to 100."""
    a, b, start = truth.codomain, truth.domain, functional_map(truth, few)
    found = (point_map(a, b, C).positions for C in (start, zoom_out(a, b, start, 100, 8)))
    return [np.linalg.norm(x - truth.positions, axis=1).mean() / a.length_scale for x in found]


POSES = [load_mesh(asset_path(f"human_{pose}.off")) for pose in "AB"]


@pytest.mark.parametrize("few", [8, 20])
def test_zoom_out_finds_the_map_between_poses(few):
    """Mean errors fall from 0.0288 and 0.0126 to below 0.002 sqrt(area).

    By the adjoint they would fall to 0.0105 and 0.0086 only.
    """
    a, b = POSES
    assert refined_errors(PointMap.of_vertices(b, a), few)[1] < 0.002


@pytest.mark.parametrize(("finer", "expected"), [("source", 0.012), ("target", 0.02)])
def test_zoom_out_works_between_different_triangulations(finer, expected):
    """Errors are below 0.012 (finer source) and 0.02 sqrt(area) (finer target).

    By the adjoint they would be 0.0303 and 0.0270. A coarse source gives at least 0.0117.
    """
    a, b = POSES
    if finer == "source":
        truth = PointMap.of_vertices(b, subdivided(a), np.arange(len(a.vertices)))
    else:
        truth = PointMap.project(subdivided(b), a, subdivided(a).vertices)
    before, after = refined_errors(truth, 12)
    assert after < expected
    assert after < 0.5 * before


def test_functional_map_equals_its_definition():
    a, b = icosphere(2), ellipsoid(2, 1, 1.5, 2)
    points = PointMap.project(b, a, np.random.default_rng(1).normal(size=b.vertices.shape))
    root = np.sqrt(vertex_areas(b))[:, None]
    expected = np.linalg.lstsq(root * basis(b, 7), root * points.pull_back(basis(a, 7)))[0]
    assert_allclose(functional_map(points, 7), expected, atol=1e-10)


def test_transfer_agrees_with_the_point_map(isometric):
    a, b, truth = isometric
    smooth = basis(a, 12) @ np.random.default_rng(2).normal(size=(12, 2))
    for h in (smooth, smooth[:, 0]):
        found = transfer(a, b, functional_map(truth, 12), h)
        assert_allclose(found, truth.pull_back(h), atol=1e-6)
    mesh, weights = ellipsoid(2, 1, 2, 3), np.arange(1.0, 6)
    assert_allclose(spectral_coefficients(mesh, basis(mesh, 5) @ weights, 5), weights)


def test_refinement_by_sampled_points_finds_the_isometry(isometric):
    """Points spread by area suffice, although eigenfunctions are not orthonormal there."""
    a, b, truth = isometric
    some = points_by_area(a, 500)
    same = SurfacePoints(b, some.faces, some.barycentric)  # corresponding points
    start = functional_map(truth, 6) + 0.03 * np.random.default_rng(0).normal(size=(6, 6))
    at = some.pull_back(basis(a, 25)), same.pull_back(basis(b, 25))
    found = refined(*at, np.full(500, 1 / 500), start, range(7, 26))
    assert_allclose(found, functional_map(truth, 25), atol=1e-6)


def test_zoom_out_alternates_with_point_maps():
    a, b = POSES
    C = start = functional_map(PointMap.of_vertices(b, a), 9)
    for size in (12, 15, 16):
        C = functional_map(point_map(a, b, C), 16)[:size, :size]
    assert_allclose(zoom_out(a, b, start, 16, step=3), C, atol=1e-9)


def match_of(mesh, axis, tau):
    f, velocity = mesh.vertices[:, 0], np.cross(axis, mesh.vertices[mesh.faces].mean(axis=1))
    return abfm.match(mesh, f, f, abfm.Parameters.of(tau=tau, iterations=0), start=velocity)


def test_rotation_flow_has_the_characters_of_rotations():
    angle = 0.7
    C = match_of(icosphere(4), [0.0, 0.6, 0.8], angle).functional_map(9)
    assert_allclose(C @ C.T, np.eye(9), atol=0.01)
    assert_allclose(np.trace(C[1:4, 1:4]), 1 + 2 * np.cos(angle), atol=0.01)
    assert_allclose(np.trace(C[4:, 4:]), 1 + 2 * np.cos(angle) + 2 * np.cos(2 * angle), atol=0.02)
    assert_allclose(C[1:4, 4:], 0, atol=0.01)


def test_functional_map_of_a_match_transfers_coefficients():
    mesh, weights = ellipsoid(2, 1, 1.3, 1.7), np.random.default_rng(5).normal(size=10)
    found = match_of(mesh, [-1.0, -0.5, 0.0], 1.0)
    assert_allclose(found.functional_map(10, 0.0), np.eye(10), atol=1e-9)
    transferred = spectral_coefficients(mesh, found.push(basis(mesh, 10) @ weights, 0.4), 10)
    assert_allclose(found.functional_map(10, 0.4) @ weights, transferred, atol=1e-8)


BALL = icosphere(1)
COUNT = len(BALL.vertices)


@pytest.mark.parametrize("bad", [np.full((3, 3), np.nan), np.zeros(3), np.zeros((0, 3))])
def test_invalid_functional_maps_are_refused(bad):
    for use, more in ((point_map, ()), (transfer, (BALL.vertices,)), (zoom_out, (5,))):
        with raises(ParameterError):
            use(BALL, BALL, bad, *more)


def test_numbers_out_of_range_are_refused():
    for size, step in ((3, 0), (6, 1)):
        with raises(ParameterError):
            zoom_out(BALL, BALL, np.eye(size), 5, step=step)
    with pytest.raises(FunctionError):
        point_map(BALL, BALL, np.eye(COUNT + 1))
    for wrong in ([-1], [COUNT], [0.5], [[0]]):
        with raises(AbfmError):
            vertex_points(BALL, wrong)
