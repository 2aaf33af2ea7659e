"""Flow lines, compared with exact motions and advection, and fields that trap them."""

from importlib import import_module

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_array_equal

from abfm import advect
from abfm.calculus.operators import l2_norm
from abfm.errors import ParameterError
from abfm.flow.flow_lines import flow_lines
from abfm.maps.surface_points import SurfacePoints, project_onto_surface, vertex_points
from abfm.mesh import TriangleMesh
from tests.core.fields import rotation_field, tangent, wavy_field
from tests.core.surfaces import random_points
from tests.core.verification import near
from tests.messages import raises
from tests.shapes import hemisphere, icosphere, open_cylinder, square, tetrahedron, torus

AXIS = np.array([1.0, 2.0, -2.0]) / 3
MODULE = import_module("abfm.flow.flow_lines")  # the package exports a function of this name


def centre(mesh, face):
    return SurfacePoints(mesh, np.array([face]), np.full((1, 3), 1 / 3))


def constant(mesh, *vectors):
    return np.stack([np.tile(np.array(v, dtype=float), (len(mesh.faces), 1)) for v in vectors])


def starts(lines):
    return np.array([line.positions[0] for line in lines])


def ends(lines):
    return np.array([line.positions[-1] for line in lines])


def endings(lines):
    return {line.ending for line in lines}


def strip(left, right):
    """Return two triangles that share the edge from (0, 0) to (0, 1), and a vector in each."""
    mesh = TriangleMesh([[0, 0, 0], [0, 1, 0], [-1, 0.5, 0], [1, 0.5, 0]], [[0, 1, 2], [1, 0, 3]])
    return mesh, np.array([left, right], dtype=float)


def test_constant_field_moves_points_along_straight_lines():
    mesh, velocity = square(8), np.array([0.7, -0.4, 0])
    lines = flow_lines(mesh, constant(mesh, velocity), random_points(mesh, 50), 0.3)
    for line in lines:
        near(line.positions, line.positions[0] + line.times[:, None] * velocity, 1e-14)
        for t in (0, 0.1 * line.times[-1], line.times[-1]):
            near(line.at(t), line.positions[0] + t * velocity, 1e-14)
    inside = ((starts(lines) + 0.3 * velocity)[:, :2] > 0).all(axis=1)
    inside &= starts(lines)[:, 0] + 0.21 < 1
    assert_array_equal([line.ending == "time" for line in lines], inside)
    assert endings(lines) == {"time", "boundary"}


def test_places_lie_in_their_faces():
    mesh = torus(12, 9)
    for line in flow_lines(mesh, wavy_field(mesh, 1), random_points(mesh, 20), 1.5):
        corners = mesh.vertices[mesh.faces[line.faces]]
        near(np.einsum("kc,kcx->kx", line.barycentric, corners), line.positions, 1e-15)
        assert line.barycentric.min() >= 0
        assert (np.diff(line.times) >= 0).all()


def test_rotation_of_a_sphere_converges():
    """The order is above 1.2, although a face has the vector of its centre (first order)."""
    errors = []
    for level in (3, 4, 5, 6):
        mesh = icosphere(level)
        lines = flow_lines(mesh, rotation_field(mesh, AXIS), random_points(mesh, 200), 2.0)
        before = starts(lines)
        along = np.outer(before @ AXIS, AXIS)
        expected = along + np.cos(2) * (before - along) + np.sin(2) * np.cross(AXIS, before)
        errors.append(np.sqrt(((ends(lines) - expected) ** 2).sum(axis=1).mean()))
    assert errors[-1] < 1e-3
    assert np.log2(errors[0] / errors[-1]) / 3 > 1.2


def test_backward_lines_agree_with_advection():
    errors = []
    for level in (3, 4, 5):
        mesh = icosphere(level)
        velocity, at_vertices = wavy_field(mesh, 2), project_onto_surface(mesh, mesh.vertices)
        origins = advect(mesh, velocity, mesh.vertices, 0.15)
        lines = flow_lines(mesh, velocity, at_vertices, -0.15)
        assert endings(lines) <= {"time", "stagnation"}
        missed = ends(lines) - project_onto_surface(mesh, origins).positions
        errors.append(l2_norm(mesh, missed) / l2_norm(mesh, mesh.vertices))
    assert errors[2] < 0.02
    assert np.log2(errors[0] / errors[2]) / 2 > 0.8


def test_reversed_field_leads_back():
    mesh = icosphere(4)
    velocity = rotation_field(mesh, AXIS)
    there = flow_lines(mesh, velocity, random_points(mesh, 50), 1.0)
    faces, weights = zip(*((line.faces[-1], line.barycentric[-1]) for line in there), strict=True)
    turned = SurfacePoints(mesh, np.array(faces), np.array(weights))
    for sign in (1, -1):
        back = flow_lines(mesh, -sign * velocity, turned, sign * 1.0)
        distances = np.linalg.norm(ends(back) - starts(there), axis=1)
        assert np.median(distances) < 1e-13
        # lines that merge along an edge cannot be separated on their return
        assert distances.max() < 0.05


def test_negative_times_run_backwards():
    mesh = square(6)
    [line] = flow_lines(mesh, constant(mesh, [0.1, 0, 0]), centre(mesh, 30), -2.0)
    assert line.times[-1] == -2
    for t in (0.0, -0.7, -2.0):
        near(line.at(t), line.positions[0] + [0.1 * t, 0, 0], 1e-15)
    near(line.at(-9), line.positions[-1], 0)
    mesh = icosphere(2)
    field, points = rotation_field(mesh, AXIS), project_onto_surface(mesh, mesh.vertices[:7])
    lines = flow_lines(mesh, field, points, 0.0)
    near(starts(lines), points.positions, 1e-15)
    assert [line.ending for line in lines] == ["time"] * 7
    assert flow_lines(mesh, field, vertex_points(mesh, np.zeros(0, int)), 1.0) == []


def test_fields_share_the_time_and_the_last_continues():
    """N fields share the time equally and the last one continues; equal fields act as one."""
    mesh = square(6)
    fields = constant(mesh, [0.1, 0, 0], [0, 0, 0], [0, 0.15, 0])
    [line] = flow_lines(mesh, fields, centre(mesh, 30), 4.0, tau=3.0)
    path = {0.5: (0.05, 0), 1: (0.1, 0), 1.7: (0.1, 0), 2: (0.1, 0), 3: (0.1, 0.15), 4: (0.1, 0.3)}
    for t, place in path.items():
        near(line.at(t) - line.positions[0], [*place, 0], 1e-14)
    assert line.ending == "time"
    [back] = flow_lines(mesh, fields, centre(mesh, 30), -0.5, tau=3.0)
    near(back.positions[-1] - back.positions[0], [-0.05, 0, 0], 1e-15)
    mesh = torus(12, 9)
    velocity, start = wavy_field(mesh, 4), random_points(mesh, 10)
    one = flow_lines(mesh, velocity, start, 1.2)
    near(ends(flow_lines(mesh, np.stack([velocity] * 4), start, 1.2, tau=1.0)), ends(one), 1e-10)


def test_lines_slide_along_edges_between_opposing_faces():
    """Filippov: between (1, 0.4) and (-3, 0.8) a line follows the edge with velocity (0, 0.5)."""
    mesh, velocity = strip([1, 0.4, 0], [-3, 0.8, 0])
    start = SurfacePoints(mesh, np.array([0]), np.array([[0.6, 0.3, 0.1]]))
    [line], [longer] = (flow_lines(mesh, velocity, start, t) for t in (0.5, 50.0))
    assert (line.ending, longer.ending) == ("time", "boundary")
    meets = -line.positions[0, 0]
    near(line.at(meets), line.positions[0] + meets * np.array([1, 0.4, 0]), 1e-15)
    near(line.at(0.5) - line.at(meets), [0, 0.5 * (0.5 - meets), 0], 1e-15)
    near(longer.positions[-1], [0, 1, 0], 1e-15)
    mesh, velocity = strip([1, 0, 0], [-2, 0, 0])
    [line] = flow_lines(mesh, velocity, centre(mesh, 0), 5.0)
    assert line.ending == "stagnation"
    near(line.at(5), [0, 0.5, 0], 1e-15)


def test_lines_pass_through_vertices():
    x, y = np.meshgrid(np.arange(9.0), np.arange(9.0), indexing="ij")
    cells = (np.arange(8)[:, None] * 9 + np.arange(8)).ravel()
    faces = np.concatenate([cells[:, None] + [0, 9, 10], cells[:, None] + [0, 10, 1]])
    mesh = TriangleMesh(np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3), faces)
    middle = project_onto_surface(mesh, [[4.0, 4.0, 0.0]])
    for direction in (np.array([i, j, 0]) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j):
        [line] = flow_lines(mesh, constant(mesh, direction), middle, 3.5)
        assert line.ending == "time"
        near(line.positions[-1], [4, 4, 0] + 3.5 * direction, 1e-12)


def test_lines_rest_in_sinks_and_leave_sources():
    mesh = square(10)
    inner = int(np.argmin(np.linalg.norm(mesh.vertices - [0.5, 0.5, 0], axis=1)))
    outward = mesh.vertices[mesh.faces].mean(axis=1) - mesh.vertices[inner]
    lines = flow_lines(mesh, -outward, random_points(mesh, 40), 100.0)
    assert endings(lines) == {"stagnation"}
    near(ends(lines), np.tile(mesh.vertices[inner], (40, 1)), 1e-9)
    source = project_onto_surface(mesh, mesh.vertices[[inner]])
    assert endings(flow_lines(mesh, outward, source, 100.0)) == {"boundary"}


def test_lines_spiralling_into_a_vertex_end():
    """A line that spirals into a vertex ends, although it crosses infinitely many edges."""
    mesh = tetrahedron()
    centres = mesh.vertices[mesh.faces].mean(axis=1)
    towards = mesh.vertices[0] - centres
    velocity = tangent(mesh, np.cross(mesh.vertices[0], centres) + 0.3 * towards)
    lines = flow_lines(mesh, velocity, random_points(mesh, 30), 1e6)
    assert endings(lines) <= {"stagnation", "step limit"}


def test_lines_end_at_the_boundary():
    mesh = hemisphere(6)
    field = tangent(mesh, constant(mesh, [0, 0, -1])[0])
    lines = flow_lines(mesh, field, random_points(mesh, 30), 100.0)
    assert endings(lines) == {"boundary"}
    near(ends(lines)[:, 2], 0, 1e-13)


def test_zero_fields_and_very_long_lines_end(monkeypatch):
    mesh = icosphere(1)
    for line in flow_lines(mesh, np.zeros((len(mesh.faces), 3)), random_points(mesh, 5), 1.0):
        assert line.ending == "stagnation"
        assert_array_equal(line.times, [0])
        near(line.at(0.5), line.positions[0], 0)
    monkeypatch.setattr(MODULE, "STEP_LIMIT", 1000)
    mesh = icosphere(2)
    [line] = flow_lines(mesh, rotation_field(mesh, AXIS), centre(mesh, 0), 1e300)
    assert line.ending == "step limit"
    assert len(line.times) == 1001


NUMBERS = st.floats(-1, 1) | st.sampled_from([0.0, 1.0, -1.0, 1e-300, 1e-12])


@settings(max_examples=80, derandomize=True)
@given(velocity=arrays(float, (80, 3), elements=NUMBERS), duration=st.floats(-1e6, 1e6))
def test_random_fields_never_hang(velocity, duration):
    for mesh in (icosphere(1), open_cylinder(8, 5)):
        corners = SurfacePoints(mesh, np.arange(3), np.eye(3))
        for start in (random_points(mesh, 4), corners):
            with pytest.MonkeyPatch.context() as monkeypatch:
                monkeypatch.setattr(MODULE, "STEP_LIMIT", 2000)
                lines = flow_lines(mesh, velocity, start, duration)
            for line in lines:
                assert np.isfinite(line.positions).all()
                assert np.isfinite(line.times).all()
                assert abs(line.times[-1]) <= abs(duration)


@pytest.mark.parametrize("scale", [1e-300, 1e-30, 1.0, 1e30, 1e140])
def test_time_scales_with_speed(scale):
    mesh = icosphere(2)
    velocity, start = wavy_field(mesh, 3), random_points(mesh, 5)
    scaled = flow_lines(mesh, scale * velocity, start, 0.5 / scale)
    near(ends(scaled), ends(flow_lines(mesh, velocity, start, 0.5)), 1e-9)


BALL, FIELD = icosphere(0), np.ones((20, 3))
INVALID = np.where(np.arange(60).reshape(20, 3) == 10, np.nan, FIELD)


@pytest.mark.parametrize(
    ("named", "field", "start", "times"),
    [
        ("", INVALID, BALL, [1.0]),
        ("", np.nan_to_num(INVALID, nan=np.inf), BALL, [1.0]),
        ("", FIELD, BALL, [np.nan]),
        ("", FIELD, BALL, [np.inf]),
        ("", 1e200 * FIELD, BALL, [1.0]),
        ("(19, 3)", FIELD[1:], BALL, [1.0]),
        ("(20,)", FIELD[:, 0], BALL, [1.0]),
        (80, FIELD, icosphere(1), [1.0]),
        ("tau", np.stack([FIELD] * 2), BALL, [1.0]),
        ("", FIELD, BALL, [1.0, -1.0]),
    ],
)
def test_invalid_input_is_refused(named, field, start, times):
    with raises(ParameterError, named):
        flow_lines(BALL, field, centre(start, 0), *times)
