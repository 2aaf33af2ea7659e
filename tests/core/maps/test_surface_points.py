"""Closest points, point maps and distortion, against brute force and maps known exactly."""

import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose, assert_array_equal
from scipy.sparse.linalg import expm_multiply

from abfm.calculus.operators import face_areas, l2_norm
from abfm.calculus.vector_fields import directional_derivative, to_frame
from abfm.errors import AbfmError, FunctionError
from abfm.maps.distortion import distortion
from abfm.maps.point_maps import PointMap
from abfm.maps.surface_points import POINTS_PER_QUERY, project_onto_surface
from abfm.mesh import TriangleMesh, load_mesh
from tests.shapes import ellipsoid, hemisphere, icosphere, square, torus

HUMAN = Path(__file__).parents[3] / "assets" / "human_A.off"
ANGLE = 0.7
AXIS = np.array([1.0, 2.0, -2.0]) / 3


def rotated(points, angle):
    """Points turned about AXIS (Rodrigues)."""
    along = np.outer(points @ AXIS, AXIS)
    return along + np.cos(angle) * (points - along) + np.sin(angle) * np.cross(AXIS, points)


def carried_by_rotation(mesh, h, angle):
    """``exp(-angle D_v) h`` for the field of unit rotation about AXIS."""
    centres = mesh.vertices[mesh.faces].mean(axis=1)
    operator = directional_derivative(mesh, to_frame(mesh, np.cross(AXIS, centres)))
    return expm_multiply(-angle * operator, h)


def rotation_map(mesh, angle):
    return PointMap.project(mesh, mesh, carried_by_rotation(mesh, mesh.vertices, angle))


def observed_order(coarse, fine):
    return float(np.log2(coarse / fine))


def brute_force_distances(mesh, points):
    """Distance of each point to the closest of all faces, one by one with trimesh."""
    faces = len(mesh.faces)
    corners = np.tile(mesh.vertices[mesh.faces], (len(points), 1, 1))
    closest = trimesh.triangles.closest_point(corners, np.repeat(points, faces, axis=0))
    return np.linalg.norm(closest.reshape(len(points), faces, 3) - points[:, None], axis=2).min(
        axis=1
    )


def assert_consistent(mesh, points, found):
    """The parts of the answer agree, and each point is the closest one of its face."""
    assert found.barycentric.min() >= 0
    assert_allclose(found.barycentric.sum(axis=1), 1, rtol=0, atol=1e-15)
    corners = mesh.vertices[mesh.faces[found.faces]]
    assert_allclose(
        found.positions, (found.barycentric[..., None] * corners).sum(axis=1), rtol=0, atol=1e-14
    )
    towards = ((corners - found.positions[:, None]) * (points - found.positions)[:, None]).sum(
        axis=2
    )
    scale = 1 + np.abs(points).max()
    assert towards.max() <= 1e-13 * scale**2


class TestProjection:
    @settings(deadline=None, max_examples=40, derandomize=True)
    @given(
        radii=arrays(float, 42, elements=st.floats(0.3, 2)),
        points=arrays(float, (12, 3), elements=st.floats(-3, 3)),
    )
    def test_agrees_with_brute_force_on_random_stars(self, radii, points):
        sphere = icosphere(1)
        mesh = TriangleMesh(sphere.vertices * radii[:, None], sphere.faces)
        found = project_onto_surface(mesh, points)
        assert_allclose(
            found.distances_from(points), brute_force_distances(mesh, points), rtol=0, atol=1e-14
        )
        assert_consistent(mesh, points, found)

    @pytest.mark.parametrize("thickness", [1e-2, 1e-5, 1e-8])
    def test_agrees_with_brute_force_on_thin_triangles(self, thickness):
        flat = torus(9, 7)
        mesh = TriangleMesh(flat.vertices * [1, thickness, 0.3], flat.faces)
        points = np.random.default_rng(2).uniform(-1.5, 1.5, size=(40, 3)) * [
            1,
            thickness**0.5,
            0.5,
        ]
        found = project_onto_surface(mesh, points)
        assert_allclose(
            found.distances_from(points), brute_force_distances(mesh, points), rtol=0, atol=1e-14
        )
        assert_consistent(mesh, points, found)

    def test_agrees_with_brute_force_on_a_body(self):
        mesh = load_mesh(HUMAN)
        random = np.random.default_rng(5)
        points = mesh.vertices[::20] + 0.05 * mesh.length_scale * random.normal(
            size=(len(mesh.vertices[::20]), 3)
        )
        found = project_onto_surface(mesh, points)
        assert_allclose(
            found.distances_from(points),
            brute_force_distances(mesh, points),
            rtol=0,
            atol=1e-14 * mesh.length_scale,
        )
        assert_consistent(mesh, points, found)

    @settings(deadline=None, max_examples=60, derandomize=True)
    @given(points=arrays(float, (5, 3), elements=st.floats(-2, 3)))
    def test_is_clamping_for_a_square(self, points):
        found, expected = project_onto_surface(square(5), points), np.clip(points, 0, [1, 1, 0])
        assert_allclose(
            found.distances_from(points),
            np.linalg.norm(points - expected, axis=1),
            rtol=0,
            atol=1e-14,
        )
        # moving sideways by 1e-8 changes no distance
        assert_allclose(found.positions, expected, rtol=0, atol=1e-7)

    @pytest.mark.parametrize("mesh", [icosphere(2), hemisphere(5), torus(9, 8)])
    def test_leaves_points_of_the_surface(self, mesh):
        random = np.random.default_rng(4)
        weights = random.dirichlet([1, 1, 1], size=len(mesh.faces))
        points = np.einsum("fc,fcx->fx", weights, mesh.vertices[mesh.faces])
        found = project_onto_surface(mesh, points)
        assert_array_equal(found.faces, np.arange(len(mesh.faces)))
        assert_allclose(found.barycentric, weights, rtol=0, atol=1e-13)
        at_vertices = project_onto_surface(mesh, mesh.vertices)
        assert_allclose(at_vertices.positions, mesh.vertices, rtol=0, atol=1e-15)
        assert_array_equal(at_vertices.nearest_vertices(), np.arange(len(mesh.vertices)))

    def test_does_not_depend_on_the_other_points(self):
        mesh, random = icosphere(3), np.random.default_rng(6)
        points = random.normal(size=(POINTS_PER_QUERY + 500, 3))
        points[::7] = 0  # as far from every face
        order = random.permutation(len(points))
        found = project_onto_surface(mesh, points)
        shuffled = project_onto_surface(mesh, points[order])
        assert_array_equal(shuffled.faces, found.faces[order])
        assert_array_equal(shuffled.barycentric, found.barycentric[order])
        assert_array_equal(shuffled.positions, found.positions[order])

    def test_no_points(self):
        assert project_onto_surface(icosphere(0), np.zeros((0, 3))).positions.shape == (0, 3)

    @pytest.mark.parametrize("bad", [np.nan, np.inf])
    def test_refuses_points_that_are_not_finite(self, bad):
        points = np.zeros((4, 3))
        points[2:, 1] = bad
        with pytest.raises(AbfmError, match=r"2 of 4 points are not finite \(first: row 2\)"):
            project_onto_surface(icosphere(0), points)

    def test_refuses_other_shapes(self):
        with pytest.raises(AbfmError, match=r"shape \(3,\); expected \(P, 3\)"):
            project_onto_surface(icosphere(0), [0, 0, 1])


class TestPullBack:
    def test_is_linear_in_each_face(self):
        mesh = torus(8, 6)
        found = project_onto_surface(mesh, np.random.default_rng(1).normal(size=(30, 3)))
        assert_allclose(found.pull_back(mesh.vertices), found.positions, rtol=0, atol=1e-15)
        values = found.pull_back(mesh.vertices @ [1, 2, 3] - 4)
        assert values.shape == (30,)
        assert_allclose(values, found.positions @ [1, 2, 3] - 4, rtol=0, atol=1e-14)

    def test_refuses_functions_of_other_meshes(self):
        mesh = icosphere(0)
        with pytest.raises(FunctionError, match="11 values were given for a mesh of 12 vertices"):
            project_onto_surface(mesh, mesh.vertices).pull_back(np.zeros(11))


class TestPointMaps:
    def test_pulling_back_is_a_matrix_whose_rows_sum_to_one(self):
        a, b = icosphere(1), torus(8, 6)
        found = PointMap.project(a, b, 2 * a.vertices)
        matrix = found.to_matrix()
        h = np.random.default_rng(0).normal(size=(len(b.vertices), 2))
        assert_allclose(matrix @ h, found.pull_back(h), rtol=0, atol=1e-14)
        assert_allclose(matrix.sum(axis=1), 1, rtol=0, atol=1e-14)
        assert_allclose(
            found.distances, np.linalg.norm(2 * a.vertices - found.positions, axis=1), rtol=1e-14
        )

    def test_it_is_made_of_faces_and_weights(self):
        mesh = icosphere(1)
        identity = PointMap.of_vertices(mesh, mesh)
        again = PointMap(mesh, mesh, identity.faces, identity.barycentric)
        assert_array_equal(again.positions, mesh.vertices)
        assert_array_equal(again.nearest_vertices(), np.arange(len(mesh.vertices)))
        assert_array_equal(again.distances, np.zeros(len(mesh.vertices)))
        assert_allclose(again.distortion().singular_values, 1, rtol=0, atol=1e-12)

    def test_what_is_no_map_is_refused(self):
        mesh, count = icosphere(0), 12
        faces, weights = np.zeros(count, dtype=int), np.full((count, 3), 1 / 3)
        for wrong_faces, wrong_weights, words in (
            (faces[1:], weights[1:], "11 points for 12 vertices: give one point per vertex"),
            (faces + 20, weights, "faces 20 to 20; expected 0 to 19"),
            (faces, 2 * weights, "negative or do not sum to 1"),
            (faces, weights[:, :2], r"expected \(P,\) whole numbers and \(P, 3\)"),
        ):
            with pytest.raises(AbfmError, match=words):
                PointMap(mesh, mesh, wrong_faces, wrong_weights)


class TestNearestVertices:
    def test_stays_on_its_side_of_a_thin_part(self):
        mesh = ellipsoid(2, 1, 1, 1e-3)
        random = np.random.default_rng(3)
        points = np.column_stack(
            [random.uniform(-0.5, 0.5, size=(200, 2)), random.choice([-1, 1], size=200)]
        )
        found = project_onto_surface(mesh, points)
        nearest = found.nearest_vertices()
        assert (mesh.vertices[nearest, 2] * points[:, 2] >= 0).all()
        corners = mesh.vertices[mesh.faces[found.faces]]
        assert_array_equal(
            np.linalg.norm(mesh.vertices[nearest] - found.positions, axis=1),
            np.linalg.norm(corners - found.positions[:, None], axis=2).min(axis=1),
        )


class TestFlowMaps:
    """A rotation of the sphere, whose map is known: errors have order two."""

    meshes = (icosphere(3), icosphere(4))

    def test_map_is_where_values_came_from(self):
        errors = [
            l2_norm(mesh, rotation_map(mesh, ANGLE).positions - rotated(mesh.vertices, -ANGLE))
            for mesh in self.meshes
        ]
        assert observed_order(*errors) >= 1.85
        assert errors[1] < 0.01

    def test_backward_map_is_the_inverse(self):
        errors = []
        for mesh in self.meshes:
            there, back = rotation_map(mesh, ANGLE), rotation_map(mesh, -ANGLE)
            errors.append(l2_norm(mesh, there.pull_back(back.positions) - mesh.vertices))
        assert observed_order(*errors) >= 1.85

    def test_pulling_back_agrees_with_advection(self):
        errors = []
        for mesh in self.meshes:
            h = np.sin(2 * mesh.vertices) + mesh.vertices[:, [1, 2, 0]]
            pulled = rotation_map(mesh, ANGLE).pull_back(h)
            errors.append(l2_norm(mesh, pulled - carried_by_rotation(mesh, h, ANGLE)))
        assert observed_order(*errors) >= 1.85

    def test_a_rotation_distorts_less_and_less(self):
        """Distortion takes one derivative of the map, whose error is rough: one order less."""
        results = [rotation_map(mesh, ANGLE).distortion() for mesh in self.meshes]
        for name in ("area", "conformal"):
            coarse, fine = (
                np.sqrt(np.average((getattr(result, name) - 1) ** 2, weights=face_areas(mesh)))
                for mesh, result in zip(self.meshes, results, strict=True)
            )
            assert observed_order(coarse, fine) >= 0.65
            assert fine < 0.03
        assert not any(result.flipped.any() for result in results)


class TestDistortion:
    def test_of_an_exact_rotation(self):
        mesh = icosphere(3)
        result = distortion(mesh, rotated(mesh.vertices, 1.0))
        assert_allclose(result.singular_values, 1, rtol=0, atol=1e-13)
        assert_allclose(result.area, 1, rtol=0, atol=1e-13)
        assert_allclose(result.conformal, 1, rtol=0, atol=1e-13)
        assert not result.flipped.any()

    @settings(deadline=None, max_examples=40, derandomize=True)
    @given(matrix=arrays(float, (2, 2), elements=st.floats(-3, 3)))
    def test_of_a_linear_map_of_the_plane(self, matrix):
        mesh = square(3)
        mapped = mesh.vertices.copy()
        mapped[:, :2] = mapped[:, :2] @ matrix.T
        result = distortion(mesh, mapped)
        expected = np.linalg.svd(matrix, compute_uv=False)
        assert_allclose(result.singular_values, np.tile(expected, (18, 1)), rtol=0, atol=1e-7)
        assert_allclose(result.area, abs(np.linalg.det(matrix)), rtol=0, atol=1e-12)
        assert (result.conformal >= 1).all()
        if expected[1] > 0.01:
            assert_allclose(result.conformal, expected[0] / expected[1], rtol=1e-9)
            assert (result.flipped == (np.linalg.det(matrix) < 0)).all()

    def test_of_collapsed_faces(self):
        mesh = icosphere(1)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            point = distortion(mesh, np.tile([0.0, 0.0, 1.0], (len(mesh.vertices), 1)))
            line = distortion(mesh, mesh.vertices * [0, 0, 1])
        for result in (point, line):
            assert_array_equal(result.area, 0)
            assert_array_equal(result.conformal, np.inf)
            assert not result.flipped.any()
        assert_array_equal(point.singular_values, 0)
        assert (line.singular_values[:, 0] > 0).any()

    def test_refuses_positions_of_other_vertices(self):
        with pytest.raises(AbfmError, match="5 mapped positions for 12 vertices"):
            distortion(icosphere(0), np.zeros((5, 3)))
        with pytest.raises(AbfmError, match="not finite"):
            distortion(icosphere(0), np.full((12, 3), np.nan))
