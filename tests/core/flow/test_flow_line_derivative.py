"""End points of flow lines, and their exact derivative by the field."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from abfm.calculus.operators import face_frames
from abfm.calculus.vector_fields import to_ambient, to_frame
from abfm.errors import AdvectionError
from abfm.flow.continuous_flow import ContinuousFlow
from abfm.flow.corner_fit import as_complex, corner_vectors, fitted, fitted_adjoint
from abfm.flow.flow_line_derivative import FlowLineDerivative
from abfm.maps.surface_points import vertex_points
from tests.core.fields import rotation_field, wavy_field
from tests.core.surfaces import SURFACES, random_points
from tests.core.verification import near, observed_orders, taylor_order
from tests.messages import raises
from tests.shapes import ellipsoid, hemisphere, icosphere

SLIVERS = ellipsoid(3, 1.0, 1.0, 0.01)


def fields(mesh, count, seed, speed=0.3):
    found = [speed * wavy_field(mesh, seed + number) for number in range(count)]
    return to_frame(mesh, np.stack(found))


def outwards(mesh, count):
    away = mesh.vertices[mesh.faces].mean(axis=1)
    away = to_frame(mesh, np.broadcast_to(0.6 * (away - [0, 0, 1]), (count, *away.shape)))
    return away + fields(mesh, count, 3, 0.1)


@pytest.mark.parametrize("name", SURFACES)
def test_fit_equals_the_continuous_field_and_has_an_adjoint(name):
    mesh = SURFACES[name].normalized()
    field = to_frame(mesh, wavy_field(mesh, 2))
    expected = corner_vectors(mesh, to_ambient(mesh, field))
    near(fitted(mesh, as_complex(field)), expected, 1e-13 * np.abs(expected).max())
    rng = np.random.default_rng(0)
    faces, corners = (as_complex(rng.normal(size=(*x.shape, 2))) for x in (field[:, 0], expected))
    there = np.vdot(corners, fitted(mesh, faces))
    assert there == pytest.approx(np.vdot(fitted_adjoint(mesh, corners), faces))


@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize("name", ["ellipsoid", "torus", "genus two", "hemisphere", "cylinder"])
def test_end_points_agree_with_continuous_flow(name, count):
    mesh = SURFACES[name].normalized()
    x = fields(mesh, count, 1)
    for points in (random_points(mesh, 9, 0), vertex_points(mesh, np.arange(9))):
        expected = ContinuousFlow(mesh, to_ambient(mesh, x), 1.3).destinations(points)
        found = FlowLineDerivative(points, 1.3).walk(x).points
        near(found.positions, expected.positions, 0.1 / np.sqrt(len(mesh.faces)))


def test_rotation_of_a_sphere_has_order_two():
    errors = []
    for subdivisions in (2, 3, 4):
        mesh = icosphere(subdivisions).normalized()
        start = random_points(mesh, 30, 1)
        x = to_frame(mesh, rotation_field(mesh, [0, 0, 1.0]))[None]
        ends = FlowLineDerivative(start, 1.0).walk(x).points.positions
        turned = start.positions @ np.array(
            [[np.cos(1), np.sin(1), 0], [-np.sin(1), np.cos(1), 0], [0, 0, 1]]
        )
        errors.append(np.linalg.norm(ends - turned, axis=1).mean())
    assert observed_orders([4, 2, 1], errors).min() > 1.7
    assert errors[-1] < 3e-4


def product_of_ends(points, aims):
    """Return the sum of products of ends with vectors (L, 3), and its derivative."""
    lines = FlowLineDerivative(points, 1.0)

    def evaluate(x):
        walk = lines.walk(x)
        frames = face_frames(points.mesh)[walk.points.faces]
        slopes = np.einsum("lkx,lx->lk", frames, aims)
        return float((walk.points.positions * aims).sum()), lines.gradient(walk, slopes)

    return evaluate


@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize("at_vertices", [False, True])
@pytest.mark.parametrize("name", ["ellipsoid", "torus", "genus two", "square", "slivers"])
def test_derivative_is_exact(name, at_vertices, count):
    mesh = (SURFACES | {"slivers": SLIVERS})[name].normalized()
    points = vertex_points(mesh, np.arange(20, 24)) if at_vertices else random_points(mesh, 4, 2)
    aims = np.random.default_rng(4).normal(size=(4, 3))
    step = 1e-5 * fields(mesh, count, 20)
    assert taylor_order(product_of_ends(points, aims), fields(mesh, count, 5), step) > 1.9


@pytest.mark.parametrize("count", [1, 2])
def test_derivative_is_exact_along_a_boundary(count):
    mesh = hemisphere(8).normalized()
    at_the_boundary = mesh.vertices[:, 2].min() + 1e-9
    points, x = random_points(mesh, 8, 3), outwards(mesh, count)
    ends = FlowLineDerivative(points, 1.0).walk(x).points.positions
    assert np.count_nonzero(ends[:, 2] < at_the_boundary) >= 3
    aims = np.random.default_rng(5).normal(size=(8, 3))
    step = 1e-5 * fields(mesh, count, 30)
    assert taylor_order(product_of_ends(points, aims), x, step) > 1.9


def test_derivative_at_the_zero_field_is_the_field():
    mesh = SURFACES["ellipsoid"].normalized()
    points = random_points(mesh, 5, 6)
    lines, rest, field = FlowLineDerivative(points, 2.0), np.zeros((1, 80, 2)), fields(mesh, 1, 7)
    walk = lines.walk(rest)
    near(walk.points.positions, points.positions, 1e-9)
    vectors = corner_vectors(mesh, to_ambient(mesh, field)[0])[points.faces]
    here = (vectors * points.barycentric).sum(axis=1)
    moved = (lines.jacobian(walk) @ field.ravel()).reshape(-1, 2)
    near(moved, 2.0 * np.stack([here.real, here.imag], axis=1), 1e-8)


def test_jacobian_and_gradient_are_adjoint():
    mesh = SURFACES["torus"].normalized()
    lines, x = FlowLineDerivative(random_points(mesh, 5, 8), 1.0), fields(mesh, 2, 8)
    walk, rng = lines.walk(x), np.random.default_rng(9)
    slopes, step = rng.normal(size=(5, 2)), rng.normal(size=x.shape)
    one = float((lines.gradient(walk, slopes) * step).sum())
    other = float(((lines.jacobian(walk) @ step.ravel()).reshape(-1, 2) * slopes).sum())
    assert one == pytest.approx(other, rel=1e-12)
    assert_allclose(lines.gradient(walk, 0 * slopes), 0)


def test_steps_grow_with_speed_up_to_a_limit():
    mesh = SURFACES["ellipsoid"].normalized()
    lines, field = FlowLineDerivative(random_points(mesh, 2, 0), 1.0), fields(mesh, 1, 0)[0]
    assert lines.steps(0 * field, 1) == 8
    assert lines.steps(16 * field, 1) == 2 * lines.steps(8 * field, 1)
    assert lines.steps(16 * field, 4) == lines.steps(4 * field, 1)
    for speed in (1e5, 1e200):
        with raises(AdvectionError):
            lines.walk(speed * field[None])
