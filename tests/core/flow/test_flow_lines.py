"""Flow lines against motions known exactly, against advection, and on fields made to trap them."""

from importlib import import_module

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose, assert_array_equal

from abfm import advect
from abfm.calculus.operators import l2_norm
from abfm.errors import ParameterError
from abfm.flow.flow_lines import flow_lines
from abfm.maps.surface_points import SurfacePoints, project_onto_surface
from abfm.mesh import TriangleMesh
from tests.core.fields import rotation_field, tangent, wavy_field
from tests.shapes import hemisphere, icosphere, open_cylinder, square, tetrahedron, torus

AXIS = np.array([1.0, 2.0, -2.0]) / 3

MODULE = import_module("abfm.flow.flow_lines")  # the room has a function of this name


def random_start(mesh, count):
    rng = np.random.default_rng(0)
    return SurfacePoints(
        mesh, rng.integers(0, len(mesh.faces), count), rng.dirichlet([1, 1, 1], count)
    )


def centre(mesh, face):
    return SurfacePoints(mesh, np.array([face]), np.full((1, 3), 1 / 3))


def constant(mesh, vector):
    return np.tile(np.asarray(vector, dtype=float), (len(mesh.faces), 1))


def starts(lines):
    return np.array([line.positions[0] for line in lines])


def ends(lines):
    return np.array([line.positions[-1] for line in lines])


def strip(left, right):
    """Two triangles, left and right of the edge from (0, 0) to (0, 1), and a vector in each."""
    mesh = TriangleMesh([[0, 0, 0], [0, 1, 0], [-1, 0.5, 0], [1, 0.5, 0]], [[0, 1, 2], [1, 0, 3]])
    return mesh, np.array([left, right], dtype=float)


class TestExactMotions:
    def test_constant_field_on_a_plane(self):
        mesh, velocity = square(8), np.array([0.7, -0.4, 0])
        lines = flow_lines(mesh, constant(mesh, velocity), random_start(mesh, 50), 0.3)
        for line in lines:
            assert_allclose(
                line.positions,
                line.positions[0] + line.times[:, None] * velocity,
                rtol=0,
                atol=1e-14,
            )
            for t in (0, 0.1 * line.times[-1], line.times[-1]):
                assert_allclose(line.at(t), line.positions[0] + t * velocity, rtol=0, atol=1e-14)
        inside = ((starts(lines) + 0.3 * velocity)[:, :2] > 0).all(axis=1) & (
            starts(lines)[:, 0] + 0.21 < 1
        )
        assert_array_equal([line.ended == "time" for line in lines], inside)
        assert {line.ended for line in lines} == {"time", "boundary"}

    def test_places_lie_in_their_faces(self):
        mesh = torus(12, 9)
        for line in flow_lines(mesh, wavy_field(mesh, 1), random_start(mesh, 20), 1.5):
            corners = mesh.vertices[mesh.faces[line.faces]]
            assert_allclose(
                np.einsum("kc,kcx->kx", line.barycentric, corners),
                line.positions,
                rtol=0,
                atol=1e-15,
            )
            assert line.barycentric.min() >= 0
            assert (np.diff(line.times) >= 0).all()

    def test_rotation_of_a_sphere(self):
        """A face has the field of its centre; off it the error is of first order."""
        errors = []
        for level in (3, 4, 5, 6):
            mesh = icosphere(level)
            lines = flow_lines(mesh, rotation_field(mesh, AXIS), random_start(mesh, 200), 2.0)
            before = starts(lines)
            along = np.outer(before @ AXIS, AXIS)
            expected = along + np.cos(2) * (before - along) + np.sin(2) * np.cross(AXIS, before)
            errors.append(np.sqrt(((ends(lines) - expected) ** 2).sum(axis=1).mean()))
        assert errors[-1] < 1e-3
        assert np.log2(errors[0] / errors[-1]) / 3 > 1.2

    def test_agrees_with_advected_coordinates(self):
        """Flow lines backwards end where advection says that values came from."""
        errors = []
        for level in (3, 4, 5):
            mesh = icosphere(level)
            velocity = wavy_field(mesh, 2)
            at_vertices = project_onto_surface(mesh, mesh.vertices)
            origins = project_onto_surface(
                mesh, advect(mesh, velocity, mesh.vertices, 0.15)
            ).positions
            lines = flow_lines(mesh, velocity, at_vertices, -0.15)
            assert {line.ended for line in lines} <= {"time", "stagnation"}
            errors.append(l2_norm(mesh, ends(lines) - origins) / l2_norm(mesh, mesh.vertices))
        assert errors[2] < 0.02
        assert np.log2(errors[0] / errors[2]) / 2 > 0.8

    def test_reversed_field_returns(self):
        mesh = icosphere(4)
        velocity = rotation_field(mesh, AXIS)
        there = flow_lines(mesh, velocity, random_start(mesh, 50), 1.0)
        turned = SurfacePoints(
            mesh,
            np.array([line.faces[-1] for line in there]),
            np.array([line.barycentric[-1] for line in there]),
        )
        for back in (
            flow_lines(mesh, -velocity, turned, 1.0),
            flow_lines(mesh, velocity, turned, -1.0),
        ):
            distances = np.linalg.norm(ends(back) - starts(there), axis=1)
            assert np.median(distances) < 1e-13
            # where lines met at an edge the way back may leave it elsewhere
            assert distances.max() < 0.05

    def test_negative_times_run_backwards(self):
        mesh = square(6)
        [line] = flow_lines(mesh, constant(mesh, [0.1, 0, 0]), centre(mesh, 30), -2.0)
        assert line.times[-1] == -2
        for t in (0.0, -0.7, -2.0):
            assert_allclose(line.at(t), line.positions[0] + [0.1 * t, 0, 0], rtol=0, atol=1e-15)
        assert_allclose(line.at(-9), line.positions[-1], rtol=0, atol=0)

    def test_starts_at_the_points_that_are_given(self):
        mesh = icosphere(2)
        points = project_onto_surface(mesh, mesh.vertices[:7])
        lines = flow_lines(mesh, rotation_field(mesh, AXIS), points, 0.0)
        assert_allclose(starts(lines), points.positions, rtol=0, atol=1e-15)
        assert [line.ended for line in lines] == ["time"] * 7
        assert (
            flow_lines(
                mesh,
                rotation_field(mesh, AXIS),
                SurfacePoints(mesh, np.zeros(0, int), np.zeros((0, 3))),
                1.0,
            )
            == []
        )


class TestFieldsInARow:
    def test_each_lasts_its_part_and_the_last_goes_on(self):
        mesh = square(6)
        fields = np.stack(
            [constant(mesh, [0.1, 0, 0]), constant(mesh, [0, 0, 0]), constant(mesh, [0, 0.15, 0])]
        )
        [line] = flow_lines(mesh, fields, centre(mesh, 30), 4.0, tau=3.0)
        for t, x, y in (
            (0.5, 0.05, 0),
            (1, 0.1, 0),
            (1.7, 0.1, 0),
            (2, 0.1, 0),
            (3, 0.1, 0.15),
            (4, 0.1, 0.3),
        ):
            assert_allclose(line.at(t) - line.positions[0], [x, y, 0], rtol=0, atol=1e-14)
        assert line.ended == "time"

    def test_equal_fields_are_one_field(self):
        mesh = torus(12, 9)
        velocity, start = wavy_field(mesh, 4), random_start(mesh, 10)
        one = flow_lines(mesh, velocity, start, 1.2)
        four = flow_lines(mesh, np.stack([velocity] * 4), start, 1.2, tau=1.0)
        assert_allclose(ends(four), ends(one), rtol=0, atol=1e-10)

    def test_short_walks_need_only_the_first(self):
        mesh = square(6)
        fields = np.stack([constant(mesh, [0.1, 0, 0]), constant(mesh, [0, 0.1, 0])])
        [ahead], [back] = (
            flow_lines(mesh, fields, centre(mesh, 30), t, tau=2.0) for t in (0.5, -0.5)
        )
        assert_allclose(ahead.positions[-1] - ahead.positions[0], [0.05, 0, 0], rtol=0, atol=1e-15)
        assert_allclose(back.positions[-1] - back.positions[0], [-0.05, 0, 0], rtol=0, atol=1e-15)


class TestEdgesAndVertices:
    def test_slides_along_an_edge_between_opposing_faces(self):
        """Filippov: the mean of (1, 0.4) and (-3, 0.8) with no part across the edge is (0, 0.5)."""
        mesh, velocity = strip([1, 0.4, 0], [-3, 0.8, 0])
        start = SurfacePoints(mesh, np.array([0]), np.array([[0.6, 0.3, 0.1]]))
        [line] = flow_lines(mesh, velocity, start, 0.5)
        assert line.ended == "time"
        meets = -line.positions[0, 0]
        assert_allclose(
            line.at(meets), line.positions[0] + meets * np.array([1, 0.4, 0]), rtol=0, atol=1e-15
        )
        assert_allclose(
            line.at(0.5) - line.at(meets), [0, 0.5 * (0.5 - meets), 0], rtol=0, atol=1e-15
        )
        [longer] = flow_lines(mesh, velocity, start, 50.0)
        assert longer.ended == "boundary"
        assert_allclose(longer.positions[-1], [0, 1, 0], rtol=0, atol=1e-15)

    def test_rests_on_an_edge_between_equal_opponents(self):
        mesh, velocity = strip([1, 0, 0], [-2, 0, 0])
        [line] = flow_lines(mesh, velocity, centre(mesh, 0), 5.0)
        assert line.ended == "stagnation"
        assert_allclose(line.at(5), [0, 0.5, 0], rtol=0, atol=1e-15)

    def test_passes_through_vertices(self):
        """Along edges and diagonals of a regular grid, from a vertex, in eight directions."""
        x, y = np.meshgrid(np.arange(9.0), np.arange(9.0), indexing="ij")
        cells = (np.arange(8)[:, None] * 9 + np.arange(8)).ravel()
        faces = np.concatenate([cells[:, None] + [0, 9, 10], cells[:, None] + [0, 10, 1]])
        mesh = TriangleMesh(np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3), faces)
        middle = project_onto_surface(mesh, [[4.0, 4.0, 0.0]])
        for direction in np.array(
            [[1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0], [-1, -1], [0, -1], [1, -1]]
        ):
            [line] = flow_lines(mesh, constant(mesh, [*direction, 0]), middle, 3.5)
            assert line.ended == "time"
            assert_allclose(line.positions[-1], [*(4 + 3.5 * direction), 0], rtol=0, atol=1e-12)

    def test_rests_in_a_sink_and_leaves_a_source(self):
        mesh = square(10)
        inner = int(np.argmin(np.linalg.norm(mesh.vertices - [0.5, 0.5, 0], axis=1)))
        outward = mesh.vertices[mesh.faces].mean(axis=1) - mesh.vertices[inner]
        lines = flow_lines(mesh, -outward, random_start(mesh, 40), 100.0)
        assert {line.ended for line in lines} == {"stagnation"}
        assert_allclose(ends(lines), np.tile(mesh.vertices[inner], (40, 1)), rtol=0, atol=1e-9)
        [line] = flow_lines(
            mesh, outward, project_onto_surface(mesh, mesh.vertices[[inner]]), 100.0
        )
        assert line.ended == "boundary"

    def test_whirls_around_a_vertex_end(self):
        """Around each vertex of a tetrahedron, inwards: infinitely many edges in finite time."""
        mesh = tetrahedron()
        centres = mesh.vertices[mesh.faces].mean(axis=1)
        towards = mesh.vertices[0] - centres
        velocity = tangent(mesh, np.cross(mesh.vertices[0], centres) + 0.3 * towards)
        for line in flow_lines(mesh, velocity, random_start(mesh, 30), 1e6):
            assert line.ended in ("stagnation", "step limit")


class TestEndings:
    def test_boundary(self):
        mesh = hemisphere(6)
        lines = flow_lines(
            mesh, tangent(mesh, constant(mesh, [0, 0, -1])), random_start(mesh, 30), 100.0
        )
        assert {line.ended for line in lines} == {"boundary"}
        assert_allclose(ends(lines)[:, 2], 0, rtol=0, atol=1e-13)

    def test_zero_field_stays(self):
        mesh = icosphere(1)
        for line in flow_lines(mesh, np.zeros((len(mesh.faces), 3)), random_start(mesh, 5), 1.0):
            assert line.ended == "stagnation"
            assert_array_equal(line.times, [0])
            assert_allclose(line.at(0.5), line.positions[0], rtol=0, atol=0)

    def test_step_limit(self, monkeypatch):
        monkeypatch.setattr(MODULE, "STEP_LIMIT", 1000)
        mesh = icosphere(2)
        [line] = flow_lines(mesh, rotation_field(mesh, AXIS), centre(mesh, 0), 1e300)
        assert line.ended == "step limit"
        assert len(line.times) == 1001

    @settings(deadline=None, max_examples=80, derandomize=True)
    @given(
        velocity=arrays(
            float,
            (80, 3),
            elements=st.floats(-1, 1) | st.sampled_from([0.0, 1.0, -1.0, 1e-300, 1e-12]),
        ),
        duration=st.floats(-1e6, 1e6),
    )
    def test_random_fields_never_hang(self, velocity, duration):
        for mesh in (icosphere(1), open_cylinder(8, 5)):
            corners = SurfacePoints(mesh, np.arange(3), np.eye(3))
            for start in (random_start(mesh, 4), corners):
                with pytest.MonkeyPatch.context() as monkeypatch:
                    monkeypatch.setattr(MODULE, "STEP_LIMIT", 2000)
                    lines = flow_lines(mesh, velocity, start, duration)
                for line in lines:
                    assert np.isfinite(line.positions).all()
                    assert np.isfinite(line.times).all()
                    assert abs(line.times[-1]) <= abs(duration)

    @settings(deadline=None, max_examples=40, derandomize=True)
    @given(scale=st.sampled_from([1e-300, 1e-30, 1.0, 1e30, 1e140]))
    def test_time_scales_with_speed(self, scale):
        mesh = icosphere(2)
        velocity, start = wavy_field(mesh, 3), random_start(mesh, 5)
        reference = flow_lines(mesh, velocity, start, 0.5)
        scaled = flow_lines(mesh, scale * velocity, start, 0.5 / scale)
        assert_allclose(ends(scaled), ends(reference), rtol=0, atol=1e-9)


class TestRefusals:
    mesh = icosphere(0)
    velocity = np.ones((20, 3))

    @pytest.mark.parametrize("bad", [np.nan, np.inf])
    def test_values_that_are_not_finite(self, bad):
        velocity = self.velocity.copy()
        velocity[3, 1] = bad
        with pytest.raises(ParameterError, match="not finite"):
            flow_lines(self.mesh, velocity, centre(self.mesh, 0), 1.0)
        with pytest.raises(ParameterError, match="duration"):
            flow_lines(self.mesh, self.velocity, centre(self.mesh, 0), bad)
        with pytest.raises(ParameterError, match="barycentric"):
            SurfacePoints(self.mesh, [0], [[bad, 0, 0]])

    def test_fields_too_fast_for_numbers(self):
        with pytest.raises(ParameterError, match="scale it down"):
            flow_lines(self.mesh, 1e200 * self.velocity, centre(self.mesh, 0), 1.0)

    def test_other_shapes(self):
        with pytest.raises(ParameterError, match=r"shape \(19, 3\)"):
            flow_lines(self.mesh, self.velocity[1:], centre(self.mesh, 0), 1.0)
        with pytest.raises(ParameterError, match=r"shape \(20,\)"):
            flow_lines(self.mesh, self.velocity[:, 0], centre(self.mesh, 0), 1.0)
        with pytest.raises(ParameterError, match="points have faces"):
            SurfacePoints(self.mesh, [0.5], [[1, 0, 0]])
        with pytest.raises(ParameterError, match="expected 0 to 19"):
            centre(self.mesh, 20)
        with pytest.raises(ParameterError, match="a mesh of 80 faces"):
            flow_lines(self.mesh, self.velocity, centre(icosphere(1), 0), 1.0)

    def test_times_out_of_range(self):
        with pytest.raises(ParameterError, match="tau is missing"):
            flow_lines(self.mesh, np.stack([self.velocity] * 2), centre(self.mesh, 0), 1.0)
        with pytest.raises(ParameterError, match="positive time"):
            flow_lines(self.mesh, self.velocity, centre(self.mesh, 0), 1.0, tau=-1.0)
