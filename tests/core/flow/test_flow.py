"""The public flow: turns of a sphere, group property, way back, partial linearised steps."""

import tracemalloc

import numpy as np
import pytest

from abfm import AdvectionError, Flow, FunctionError, ParameterError, advect
from abfm.calculus.operators import l2_norm
from abfm.calculus.vector_fields import directional_derivative, to_frame
from tests.core.fields import bump, rotation_field, wavy_field
from tests.core.verification import observed_orders
from tests.shapes import icosphere, square

BALL = icosphere(3, radius=2.0)
BUMP = bump(BALL, BALL.vertices[5], 0.2)


def test_a_turning_sphere_carries_functions_and_points_along_with_order_two():
    """A quarter turn about z takes the bump at x to y, and points came from one before."""
    sizes, functions, points = [], [], []
    for level in (3, 4, 5):
        mesh = icosphere(level)
        flow = Flow(mesh, rotation_field(mesh, [0, 0, 1]), np.pi / 2)
        turned = bump(mesh, [0, 1, 0], 0.15)
        functions.append(
            l2_norm(mesh, flow.push(bump(mesh, [1, 0, 0], 0.15)) - turned) / l2_norm(mesh, turned)
        )
        x, y, z = mesh.vertices.T
        points.append(l2_norm(mesh, flow.point_map().positions - np.stack([y, -x, z], axis=1)))
        sizes.append(1 / 2**level)
    assert observed_orders(sizes, functions)[-1] > 1.8
    assert observed_orders(sizes, points)[-1] > 1.8


def test_one_field_is_carried_as_by_advect():
    v = wavy_field(BALL, 1)
    np.testing.assert_array_equal(Flow(BALL, v).push(BUMP, 0.7), advect(BALL, v, BUMP, 0.7))


def test_times_add_up_and_a_negative_time_goes_back():
    flow = Flow(BALL, wavy_field(BALL, 3), 0.8)
    there = flow.push(BUMP, 0.8)
    np.testing.assert_allclose(flow.push(flow.push(BUMP, 0.5), 0.3), there, atol=1e-8)
    np.testing.assert_allclose(flow.push(there, -0.8), BUMP, atol=1e-7)


def test_several_fields_in_a_row_share_the_time_and_the_last_one_goes_on():
    first, last = fields = np.stack([wavy_field(BALL, 1), wavy_field(BALL, 2)])
    flow = Flow(BALL, fields, 0.6)
    halfway = advect(BALL, first, BUMP, 0.3)
    np.testing.assert_allclose(flow.push(BUMP, 0.3), halfway, atol=1e-9)
    np.testing.assert_allclose(flow.push(BUMP, 1.0), advect(BALL, last, halfway, 0.7), atol=1e-8)
    np.testing.assert_allclose(flow.push(flow.push(BUMP), -0.6), BUMP, atol=1e-7)


def test_a_span_has_the_same_values_in_any_order_of_times():
    flow = Flow(BALL, wavy_field(BALL, 4))
    h = np.stack([BUMP, BUMP**2], axis=1)
    times = [0.4, 0.0, -0.3, 1.0]
    values = flow.push(h, times)
    assert values.shape == (4, *h.shape)
    np.testing.assert_array_equal(values[1], h)
    for t, value in zip(times, values, strict=True):
        np.testing.assert_allclose(flow.push(h, t), value, atol=1e-9)


def test_linearised_steps_are_the_first_two_terms_and_may_be_partial():
    mesh = square(12)
    fields = 0.2 * np.stack([wavy_field(mesh, seed) for seed in (1, 2)])
    one, other = (directional_derivative(mesh, to_frame(mesh, v)) for v in fields)
    flow = Flow(mesh, fields, 1.0, "linearised")
    f = bump(mesh, mesh.vertices[60], 0.2)
    step = f - 0.5 * (one @ f)
    np.testing.assert_allclose(flow.push(f, 0.2), f - 0.2 * (one @ f), atol=1e-12)
    np.testing.assert_allclose(flow.push(f, 0.7), step - 0.2 * (other @ step), atol=1e-12)
    np.testing.assert_allclose(flow.push(f), step - 0.5 * (other @ step), atol=1e-12)
    back = f + 0.2 * (other @ f)
    np.testing.assert_allclose(flow.push(f, -0.7), back + 0.5 * (one @ back), atol=1e-12)


def test_two_flows_on_a_mesh_do_not_disturb_each_other():
    one = Flow(BALL, wavy_field(BALL, 1))
    other = Flow(BALL, wavy_field(BALL, 2), method="linearised")
    before = one.push(BUMP, 0.5)
    other.push(BUMP, 0.5)
    np.testing.assert_array_equal(one.push(BUMP, 0.5), before)


@pytest.mark.parametrize(
    ("velocity", "options", "words"),
    [
        (np.zeros((3, 3)), {}, "velocity has shape"),
        (np.zeros((0, 1280, 3)), {}, "velocity has shape"),
        (np.full((1280, 3), np.nan), {}, "not finite"),
        (np.zeros((1280, 3)), {"tau": 0.0}, "tau is 0.0; expected a positive time"),
        (
            np.zeros((1280, 3)),
            {"method": "exact"},
            "method is 'exact'; expected 'nonlinear' or 'linearised'",
        ),
    ],
)
def test_what_is_no_flow_is_refused_in_words(velocity, options, words):
    with pytest.raises(ParameterError, match=words):
        Flow(BALL, velocity, **options)


def test_what_cannot_be_carried_is_refused_in_words():
    flow = Flow(BALL, np.zeros((1280, 3)))
    with pytest.raises(FunctionError):
        flow.push(np.zeros(5), 1.0)
    for t in (np.inf, [[0.0]], [0.0, np.nan]):
        with pytest.raises(ParameterError, match="expected a finite time or a list of them"):
            flow.push(BUMP, t)
    with pytest.raises(AdvectionError, match="shorten the time"):
        Flow(BALL, np.full((1280, 3), 1e9)).push(BUMP, 1.0)


def test_of_a_function_at_many_times_nothing_large_stays_with_the_mesh():
    times, field = [0.2, 0.4, 0.8], wavy_field(BALL, 3)
    Flow(BALL, field).push(BUMP, times)  # all is compiled
    mesh = icosphere(3, radius=2.0)
    tracemalloc.start()
    try:
        flow = Flow(mesh, field)
        values = flow.push(BUMP, times)
        stays, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert values.shape == (3, len(mesh.vertices))
    assert stays < 300 * BUMP.nbytes
