"""Functional maps, against known isometries, the definition, and characters of rotations."""

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose, assert_array_equal

import abfm
from abfm.assets import asset_path
from abfm.calculus.eigenbasis import eigenbasis
from abfm.calculus.operators import vertex_areas
from abfm.errors import AbfmError, FunctionError, ParameterError
from abfm.maps.functional_maps import (
    carry,
    functional_map,
    point_map,
    spectral_coefficients,
    zoom_out,
)
from abfm.maps.point_maps import PointMap
from abfm.maps.surface_points import vertex_points
from abfm.mesh import TriangleMesh, load_mesh
from tests.shapes import ellipsoid, icosphere


def moved_copy(mesh):
    """The mesh renumbered, turned, shifted and scaled, and the old numbers of vertices."""
    old = np.random.default_rng(3).permutation(len(mesh.vertices))
    new = np.argsort(old)
    turn = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    return TriangleMesh(3.0 * mesh.vertices[old] @ turn.T + [1, 2, 3], new[mesh.faces]), old


def refined(mesh):
    """The same surface with every face cut into four; the old vertices come first."""
    vertices, faces = trimesh.remesh.subdivide(mesh.vertices, mesh.faces)
    return TriangleMesh(vertices, faces)


@pytest.fixture(scope="module")
def isometric():
    a = ellipsoid(3, 1.0, 1.4, 2.1)
    b, old = moved_copy(
        TriangleMesh(
            a.vertices * (1 + 0.1 * np.sin(a.vertices[:, :1] + a.vertices[:, 1:2])), a.faces
        )
    )
    return (
        TriangleMesh(
            a.vertices * (1 + 0.1 * np.sin(a.vertices[:, :1] + a.vertices[:, 1:2])), a.faces
        ),
        b,
        old,
    )


def test_map_of_a_surface_to_itself_is_the_identity():
    mesh = ellipsoid(2, 1, 2, 3)
    identity = PointMap.of_vertices(mesh, mesh)
    assert_allclose(functional_map(identity, 20), np.eye(20), atol=1e-9)


def test_an_isometry_is_diagonal_whatever_size_and_numbering(isometric):
    a, b, old = isometric
    assert_allclose(
        np.abs(functional_map(PointMap.of_vertices(b, a, old), 15)), np.eye(15), atol=1e-6
    )


def test_point_map_of_an_isometry_is_recovered(isometric):
    a, b, old = isometric
    found = point_map(a, b, functional_map(PointMap.of_vertices(b, a, old), 25))
    assert_array_equal(found.positions, a.vertices[old])


def test_delta_functions_are_carried_by_the_functional_map_itself():
    """Not back by its adjoint, which only an orthogonal map has as its inverse."""
    a, b = icosphere(1), ellipsoid(1, 1, 1.5, 2)
    C = np.random.default_rng(6).normal(size=(5, 8))
    arrived = eigenbasis(a.normalized(), 8)[1] @ C.T
    wanted = eigenbasis(b.normalized(), 5)[1]
    gaps = np.linalg.norm(wanted[:, None] - arrived, axis=2)
    assert_array_equal(point_map(a, b, C).positions, a.vertices[gaps.argmin(axis=1)])


def test_point_map_of_an_isometry_is_recovered_from_a_cut_off_map(isometric):
    """Missing rows leave less to compare by; the adjoint would lead to wrong places."""
    a, b, old = isometric
    found = point_map(a, b, functional_map(PointMap.of_vertices(b, a, old), 25)[:12])
    assert_array_equal(found.positions, a.vertices[old])


def test_zoom_out_reaches_an_isometry_from_few_eigenfunctions(isometric):
    a, b, old = isometric
    truth = PointMap.of_vertices(b, a, old)
    start = functional_map(truth, 4) + 0.05 * np.random.default_rng(0).normal(size=(4, 4))
    assert (point_map(a, b, start).positions != a.vertices[old]).any()
    refined = zoom_out(a, b, start, 30, step=2)
    assert refined.shape == (30, 30)
    assert_allclose(refined, functional_map(truth, 30), atol=1e-6)


def refined_error(truth, few):
    """Mean error of a map cut off at a few eigenfunctions and refined to 100, in sqrt(area)."""
    a, b, start = truth.codomain, truth.domain, functional_map(truth, few)
    found = [point_map(a, b, C) for C in (start, zoom_out(a, b, start, 100, 8))]
    before, after = (
        np.linalg.norm(each.positions - truth.positions, axis=1).mean() for each in found
    )
    return float(before / a.length_scale), float(after / a.length_scale)


@pytest.mark.parametrize("few", [8, 20])
def test_zoom_out_finds_the_map_between_two_poses(few):
    """By the adjoint 0.0105 and 0.0086 are left of 0.0288 and 0.0126."""
    a, b = (load_mesh(asset_path(f"human_{pose}.off")) for pose in "AB")
    assert refined_error(PointMap.of_vertices(b, a), few)[1] < 0.002


@pytest.mark.parametrize(("finer", "expected"), [("source", 0.012), ("target", 0.02)])
def test_zoom_out_improves_a_map_between_different_triangulations(finer, expected):
    """By the adjoint 0.0303 and 0.0270 are left; the coarse source's vertices miss by 0.0117."""
    a, b = (load_mesh(asset_path(f"human_{pose}.off")) for pose in "AB")
    if finer == "source":
        truth = PointMap.of_vertices(b, refined(a), np.arange(len(a.vertices)))
    else:
        truth = PointMap.project(refined(b), a, refined(a).vertices)
    before, after = refined_error(truth, 12)
    assert after < expected
    assert after < 0.5 * before


def test_definition_with_the_pseudoinverse_as_oracle():
    a, b = icosphere(2), ellipsoid(2, 1, 1.5, 2)
    points = PointMap.project(b, a, np.random.default_rng(1).normal(size=b.vertices.shape))
    basis_a, basis_b = eigenbasis(a.normalized(), 7)[1], eigenbasis(b.normalized(), 7)[1]
    root = np.sqrt(vertex_areas(b))[:, None]
    expected = np.linalg.lstsq(root * basis_b, root * points.pull_back(basis_a))[0]
    assert_allclose(functional_map(points, 7), expected, atol=1e-10)


def test_carried_functions_are_those_of_the_point_map(isometric):
    a, b, old = isometric
    smooth = eigenbasis(a.normalized(), 12)[1] @ np.random.default_rng(2).normal(size=(12, 2))
    C = functional_map(PointMap.of_vertices(b, a, old), 12)
    assert_allclose(carry(a, b, C, smooth), smooth[old], atol=1e-6)
    assert_allclose(carry(a, b, C, smooth[:, 0]), smooth[old, 0], atol=1e-6)


def test_coefficients_of_a_combination_are_its_weights():
    mesh = ellipsoid(2, 1, 2, 3)
    weights = np.arange(1.0, 6)
    assert_allclose(
        spectral_coefficients(mesh, eigenbasis(mesh.normalized(), 5)[1] @ weights, 5), weights
    )


def match_of(mesh, velocity, tau):
    f = mesh.vertices[:, 0]
    return abfm.match(mesh, f, f, abfm.Parameters(tau=tau, iterations=0), start=velocity)


def test_flow_of_a_rotation_has_the_characters_of_the_rotation_group():
    sphere, angle = icosphere(4), 0.7
    centres = sphere.vertices[sphere.faces].mean(axis=1)
    C = match_of(sphere, np.cross([0.0, 0.6, 0.8], centres), angle).functional_map(9)
    assert_allclose(C @ C.T, np.eye(9), atol=0.01)
    assert_allclose(np.trace(C[1:4, 1:4]), 1 + 2 * np.cos(angle), atol=0.01)
    assert_allclose(np.trace(C[4:, 4:]), 1 + 2 * np.cos(angle) + 2 * np.cos(2 * angle), atol=0.02)
    assert_allclose(C[1:4, 4:], 0, atol=0.01)


def test_functional_map_of_a_match_carries_coefficients():
    mesh = ellipsoid(2, 1, 1.3, 1.7)
    centres = mesh.vertices[mesh.faces].mean(axis=1)
    found = match_of(mesh, np.cross(centres, [1.0, 0.5, 0.0]), 1.0)
    assert_allclose(found.functional_map(10, 0.0), np.eye(10), atol=1e-9)
    weights = np.random.default_rng(5).normal(size=10)
    carried = found.push(eigenbasis(mesh.normalized(), 10)[1] @ weights, 0.4)
    assert_allclose(
        found.functional_map(10, 0.4) @ weights, spectral_coefficients(mesh, carried, 10), atol=1e-8
    )


@pytest.mark.parametrize("bad", [np.full((3, 3), np.nan), np.zeros(3), np.zeros((0, 3))])
def test_what_is_no_functional_map_is_refused(bad):
    mesh = icosphere(1)
    for use in (
        point_map,
        lambda a, b, C: carry(a, b, C, a.vertices),
        lambda a, b, C: zoom_out(a, b, C, 5),
    ):
        with pytest.raises(ParameterError, match="functional map"):
            use(mesh, mesh, bad)


def test_numbers_out_of_range_are_refused():
    mesh = icosphere(1)
    with pytest.raises(ParameterError, match="step"):
        zoom_out(mesh, mesh, np.eye(3), 5, step=0)
    with pytest.raises(ParameterError, match="at least the size"):
        zoom_out(mesh, mesh, np.eye(6), 5)
    with pytest.raises(FunctionError):
        point_map(mesh, mesh, np.eye(len(mesh.vertices) + 1))
    for wrong in ([-1], [len(mesh.vertices)], [0.5], [[0]]):
        with pytest.raises(AbfmError, match="vertices"):
            vertex_points(mesh, wrong)
