"""Closest points, point maps and distortion, compared with brute force and exact maps."""

import warnings

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from abfm.assets import asset_path
from abfm.calculus.operators import face_areas, l2_norm, vertex_areas
from abfm.errors import AbfmError, FunctionError, ParameterError
from abfm.flow.flow import Flow
from abfm.maps.distortion import chord_distortion
from abfm.maps.point_maps import PointMap
from abfm.maps.surface_points import (
    POINTS_PER_QUERY,
    SurfacePoints,
    points_by_area,
    project_onto_surface,
)
from abfm.mesh import TriangleMesh, load_mesh
from tests.core.fields import rotation_field
from tests.core.verification import near
from tests.messages import raises
from tests.shapes import ellipsoid, hemisphere, icosphere, square, torus

ANGLE, AXIS = 0.7, np.array([1.0, 2.0, -2.0]) / 3


def rotated(points, angle):
    return points @ Rotation.from_rotvec(angle * AXIS).as_matrix().T


def brute_force_distances(mesh, points):
    """Return the distance of each point from the surface, by testing every face with trimesh."""
    faces = len(mesh.faces)
    corners = np.tile(mesh.vertices[mesh.faces], (len(points), 1, 1))
    closest = trimesh.triangles.closest_point(corners, np.repeat(points, faces, axis=0))
    offsets = closest.reshape(len(points), faces, 3) - points[:, None]
    return np.linalg.norm(offsets, axis=2).min(axis=1)


def check_projection(mesh, points, unit=1.0):
    """Assert that a projection agrees with brute force and is closest within its face."""
    found = project_onto_surface(mesh, points)
    near(found.distances_from(points), brute_force_distances(mesh, points), 1e-14 * unit)
    assert found.barycentric.min() >= 0
    near(found.barycentric.sum(axis=1), 1, 1e-15)
    corners = mesh.vertices[mesh.faces[found.faces]]
    near(found.positions, (found.barycentric[..., None] * corners).sum(axis=1), 1e-14)
    offsets = (points - found.positions)[:, None]
    towards = ((corners - found.positions[:, None]) * offsets).sum(axis=2)
    assert towards.max() <= 1e-13 * (1 + np.abs(points).max()) ** 2


@settings(max_examples=40, derandomize=True)
@given(
    radii=arrays(float, 42, elements=st.floats(0.3, 2)),
    points=arrays(float, (12, 3), elements=st.floats(-3, 3)),
)
def test_closest_points_of_random_stars_are_exact(radii, points):
    sphere = icosphere(1)
    check_projection(TriangleMesh(sphere.vertices * radii[:, None], sphere.faces), points)


@pytest.mark.parametrize("thickness", [1e-2, 1e-5, 1e-8])
def test_closest_points_of_thin_triangles_are_exact(thickness):
    flat = torus(9, 7)
    mesh = TriangleMesh(flat.vertices * [1, thickness, 0.3], flat.faces)
    points = np.random.default_rng(2).uniform(-1.5, 1.5, size=(40, 3))
    check_projection(mesh, points * [1, thickness**0.5, 0.5])


def test_closest_points_of_a_body_are_exact():
    mesh = load_mesh(asset_path("human_A.off"))
    some = mesh.vertices[::20]
    noise = 0.05 * mesh.length_scale * np.random.default_rng(5).normal(size=some.shape)
    check_projection(mesh, some + noise, mesh.length_scale)


@settings(max_examples=60, derandomize=True)
@given(points=arrays(float, (5, 3), elements=st.floats(-2, 3)))
def test_projection_to_a_square_is_clamping(points):
    found, expected = project_onto_surface(square(5), points), np.clip(points, 0, [1, 1, 0])
    near(found.distances_from(points), np.linalg.norm(points - expected, axis=1), 1e-14)
    # a shift of 1e-8 along the surface changes the distance by rounding only
    near(found.positions, expected, 1e-7)


@pytest.mark.parametrize("mesh", [icosphere(2), hemisphere(5), torus(9, 8)])
def test_projection_preserves_points_of_the_surface(mesh):
    weights = np.random.default_rng(4).dirichlet([1, 1, 1], size=len(mesh.faces))
    found = project_onto_surface(mesh, np.einsum("fc,fcx->fx", weights, mesh.vertices[mesh.faces]))
    assert_array_equal(found.faces, np.arange(len(mesh.faces)))
    near(found.barycentric, weights, 1e-13)
    at_vertices = project_onto_surface(mesh, mesh.vertices)
    near(at_vertices.positions, mesh.vertices, 1e-15)
    assert_array_equal(at_vertices.nearest_vertices(), np.arange(len(mesh.vertices)))


def test_projection_does_not_depend_on_the_other_points():
    mesh, random = icosphere(3), np.random.default_rng(6)
    points = random.normal(size=(POINTS_PER_QUERY + 500, 3))
    points[::7] = 0  # the centre has the same distance from all faces
    order = random.permutation(len(points))
    found, shuffled = (project_onto_surface(mesh, each) for each in (points, points[order]))
    for name in ("faces", "barycentric", "positions"):
        assert_array_equal(getattr(shuffled, name), getattr(found, name)[order])
    assert project_onto_surface(mesh, np.zeros((0, 3))).positions.shape == (0, 3)


@pytest.mark.parametrize(
    ("points", "named"),
    [
        ([[0, 0, 0], [0, np.nan, 0], [0, np.nan, 0]], (2, 3, 1)),
        ([[0, 0, 0], [0, 0, np.inf]], (1, 2)),
        ([0, 0, 1], ("(3,)", 3)),
    ],
)
def test_invalid_points_are_refused(points, named):
    with raises(AbfmError, *named):
        project_onto_surface(icosphere(0), points)


def test_pull_back_is_linear_and_has_a_matrix():
    mesh = torus(8, 6)
    found = project_onto_surface(mesh, np.random.default_rng(1).normal(size=(30, 3)))
    near(found.pull_back(mesh.vertices), found.positions, 1e-15)
    values = found.pull_back(mesh.vertices @ [1, 2, 3] - 4)
    assert values.shape == (30,)
    near(values, found.positions @ [1, 2, 3] - 4, 1e-14)
    with raises(FunctionError, 11, 48):
        found.pull_back(np.zeros(11))
    a, b = icosphere(1), torus(8, 6)
    found = PointMap.project(a, b, 2 * a.vertices)
    matrix, h = found.to_matrix(), np.random.default_rng(0).normal(size=(len(b.vertices), 2))
    near(matrix @ h, found.pull_back(h), 1e-14)
    near(matrix.sum(axis=1), 1, 1e-14)
    expected = np.linalg.norm(2 * a.vertices - found.positions, axis=1)
    assert_allclose(found.distances, expected, rtol=1e-14)


def test_point_map_is_determined_by_faces_and_weights():
    mesh = icosphere(1)
    identity = PointMap.of_vertices(mesh, mesh)
    again = PointMap(mesh, mesh, identity.faces, identity.barycentric)
    assert_array_equal(again.positions, mesh.vertices)
    assert_array_equal(again.nearest_vertices(), np.arange(len(mesh.vertices)))
    assert_array_equal(again.distances, np.zeros(len(mesh.vertices)))
    near(again.distortion().singular_values, 1, 1e-12)


def test_invalid_maps_are_refused():
    mesh, count = icosphere(0), 12
    faces, weights = np.zeros(count, dtype=int), np.full((count, 3), 1 / 3)
    for wrong_faces, wrong_weights, named in (
        (faces[1:], weights[1:], (11, 12)),
        (faces + 20, weights, (20, 0, 19)),
        (faces, 2 * weights, ()),
        (faces, weights[:, :2], ("(P,)", "(P, 3)")),
    ):
        with raises(AbfmError, *named):
            PointMap(mesh, mesh, wrong_faces, wrong_weights)
    for distances in (np.zeros(3), np.zeros((count, 1)), np.zeros(0)):
        with raises(AbfmError, "distances", "(12,)"):
            PointMap(mesh, mesh, faces, weights, distances)
    for face, weight, named in ((0, np.nan, ""), (0, np.inf, ""), (0.5, 1, ""), (20, 1, 19)):
        with raises(ParameterError, named):
            SurfacePoints(mesh, [face], [[weight, 0, 0]])
    with raises(AbfmError, 5, 12):
        chord_distortion(icosphere(0), np.zeros((5, 3)))
    with raises(AbfmError):
        chord_distortion(icosphere(0), np.full((12, 3), np.nan))


def test_nearest_vertex_is_on_the_same_side():
    mesh, random = ellipsoid(2, 1, 1, 1e-3), np.random.default_rng(3)
    points = np.column_stack([random.uniform(-0.5, 0.5, (200, 2)), random.choice([-1, 1], 200)])
    found = project_onto_surface(mesh, points)
    nearest = found.nearest_vertices()
    assert (mesh.vertices[nearest, 2] * points[:, 2] >= 0).all()
    gaps = mesh.vertices[mesh.faces[found.faces]] - found.positions[:, None]
    assert_array_equal(
        np.linalg.norm(mesh.vertices[nearest] - found.positions, axis=1),
        np.linalg.norm(gaps, axis=2).min(axis=1),
    )


def test_maps_of_a_rotating_sphere_have_order_two():
    """Points have order 2; the distortion, a derivative of the map, has order 1."""
    errors = []
    for level in (3, 4):
        mesh = icosphere(level)
        flow = Flow(mesh, rotation_field(mesh, AXIS))
        forward, backward = flow.point_map(ANGLE), flow.point_map(-ANGLE)
        h = np.sin(2 * mesh.vertices) + mesh.vertices[:, [1, 2, 0]]
        off = [
            forward.positions - rotated(mesh.vertices, -ANGLE),
            forward.pull_back(backward.positions) - mesh.vertices,
            forward.pull_back(h) - flow.push(h, ANGLE),
        ]
        found, areas = forward.distortion(), face_areas(mesh)
        assert not found.flipped.any()
        stretches = [(x - 1) ** 2 for x in (found.area, found.conformal)]
        rough = [np.sqrt(np.average(x, weights=areas)) for x in stretches]
        errors.append([*(l2_norm(mesh, x) for x in off), *rough])
    orders = np.log2(np.array(errors[0]) / errors[1])
    assert (orders[:3] >= 1.85).all()
    assert (orders[3:] >= 0.65).all()
    assert errors[1][0] < 0.01
    assert max(errors[1][3:]) < 0.03


def test_only_collapsed_faces_have_infinite_distortion():
    mesh = icosphere(3)
    found = chord_distortion(mesh, rotated(mesh.vertices, 1.0))
    for values in (found.singular_values, found.area, found.conformal):
        near(values, 1, 1e-13)
    assert not found.flipped.any()
    mesh = icosphere(1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        point, line = (chord_distortion(mesh, mesh.vertices * x) for x in ([0, 0, 0], [0, 0, 1]))
    for found in (point, line):
        assert_array_equal(found.area, 0)
        assert_array_equal(found.conformal, np.inf)
        assert not found.flipped.any()
    assert_array_equal(point.singular_values, 0)
    assert (line.singular_values[:, 0] > 0).any()


@settings(max_examples=40, derandomize=True)
@given(matrix=arrays(float, (2, 2), elements=st.floats(-3, 3)))
def test_distortion_of_a_linear_map_has_its_singular_values(matrix):
    mesh = square(3)
    mapped = mesh.vertices.copy()
    mapped[:, :2] = mapped[:, :2] @ matrix.T
    found, expected = chord_distortion(mesh, mapped), np.linalg.svd(matrix, compute_uv=False)
    near(found.singular_values, np.tile(expected, (18, 1)), 1e-7)
    near(found.area, abs(np.linalg.det(matrix)), 1e-12)
    assert (found.conformal >= 1).all()
    if expected[1] > 0.01:
        assert_allclose(found.conformal, expected[0] / expected[1], rtol=1e-9)
        assert (found.flipped == (np.linalg.det(matrix) < 0)).all()


def test_means_over_points_by_area_are_integrals():
    mesh = square(9)
    points = points_by_area(mesh, 1000).positions
    expected = vertex_areas(mesh) @ mesh.vertices / vertex_areas(mesh).sum()
    assert_allclose(points.mean(axis=0), expected, atol=2e-3)
    assert_allclose((points[:, :2] ** 2).mean(axis=0), 1 / 3, atol=3e-3)
