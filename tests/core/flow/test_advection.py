"""Flows, compared with SciPy's exponential, exact rotations and their adjoint."""

import tracemalloc

import numpy as np
import pytest
from scipy.sparse.linalg import expm_multiply
from scipy.special import jv

import abfm
from abfm import AdvectionError, Flow, advect
from abfm.calculus.operators import l2_norm
from abfm.calculus.vector_fields import directional_derivative, to_frame
from abfm.errors import AbfmError
from abfm.flow.advection import Discretisation
from abfm.flow.derivative import derivative_pattern
from abfm.flow.exponential import bessel_coefficients
from tests.core.fields import bump, rotation_field, wavy_field
from tests.core.verification import near, observed_orders
from tests.messages import raises
from tests.shapes import icosphere, square, torus, with_loose_vertex

BALL = icosphere(3, radius=2.0)
MESHES = {"closed": BALL, "boundary": square(16), "genus 1": torus(40, 16)}
UNIT = BALL.normalized()
BUMP = bump(BALL, BALL.vertices[5], 0.2)


def oracle(mesh, v, f, t):
    return expm_multiply(-t * directional_derivative(mesh, to_frame(mesh, v)), f)


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("t", [0.0, 0.3, -0.3, 2.0])
def test_advection_equals_exponential_of_scipy(name, t):
    mesh = MESHES[name]
    v, f = wavy_field(mesh, 1), bump(mesh, mesh.vertices[5], 0.2)
    expected = oracle(mesh, v, f, t)
    near(advect(mesh, v, f, t), expected, 1e-8 * np.abs(expected).max())


def test_channels_are_advected_separately():
    v = wavy_field(BALL, 2)
    f = np.stack([bump(BALL, BALL.vertices[i], 0.2) for i in (0, 7, 99)], axis=1)
    together = advect(BALL, v, f, 0.7)
    one_by_one = [advect(BALL, v, f[:, c], 0.7) for c in range(3)]
    np.testing.assert_array_equal(together, np.stack(one_by_one, axis=1))


def test_long_times_and_growing_flows_are_split():
    mesh = icosphere(3)
    v, f, t = rotation_field(mesh, [0, 0, 1]), bump(mesh, [1, 0, 0], 0.2), 400.0
    expected = f
    for _ in range(8):
        expected = oracle(mesh, v, expected, t / 8)
    near(advect(mesh, v, f, t), expected, 1e-6)
    mesh, rng = icosphere(1), np.random.default_rng(5)
    v, f = 3 * rng.normal(size=(len(mesh.faces), 3)), rng.normal(size=len(mesh.vertices))
    expected = oracle(mesh, v, f, 6.0)
    assert np.abs(expected).max() > 1e6
    near(advect(mesh, v, f, 6.0), expected, 1e-6 * np.abs(expected).max())


def test_rotation_advects_with_order_two():
    sizes, functions, points = [], [], []
    for level in (3, 4, 5):
        mesh = icosphere(level)
        flow = Flow(mesh, rotation_field(mesh, [0, 0, 1]), np.pi / 2)
        turned = bump(mesh, [0, 1, 0], 0.15)
        error = l2_norm(mesh, flow.push(bump(mesh, [1, 0, 0], 0.15)) - turned)
        functions.append(error / l2_norm(mesh, turned))
        x, y, z = mesh.vertices.T
        points.append(l2_norm(mesh, flow.point_map().positions - np.stack([y, -x, z], axis=1)))
        sizes.append(1 / 2**level)
    assert observed_orders(sizes, functions)[-1] > 1.8
    assert observed_orders(sizes, points)[-1] > 1.8
    assert functions[-1] < 0.02


def test_times_add_up_and_negative_times_undo_the_flow():
    for mesh in (MESHES["genus 1"], BALL):
        v, f = wavy_field(mesh, 3), bump(mesh, mesh.vertices[50], 0.2)
        flow = Flow(mesh, v, 0.8)
        near(flow.push(np.ones(len(f)), 1.0), 1, 1e-9)
        near(flow.push(flow.push(f, 0.4), 0.6), advect(mesh, v, f, 1.0), 1e-8)
        near(flow.push(flow.push(f, 0.5), -0.5), f, 1e-7)
        np.testing.assert_array_equal(flow.push(f, 0.7), advect(mesh, v, f, 0.7))


@pytest.mark.parametrize("method", ["nonlinear", "linearised"])
@pytest.mark.parametrize("count", [1, 3])
def test_backward_is_the_adjoint_of_forward_in_f(method, count):
    """``<mu, forward(f)> = <backward(mu), f>``, since forward is linear in f."""
    mesh = MESHES["boundary"].normalized()
    fields = np.stack([to_frame(mesh, wavy_field(mesh, seed)) for seed in range(count)])
    f, mu = np.random.default_rng(1).normal(size=(2, len(mesh.vertices)))
    flow = Discretisation(mesh, method).flow(fields, 0.2)
    trajectories = flow.forward(f, keep=True)
    expected = mu @ trajectories[-1].end
    for j in reversed(range(count)):
        mu = flow.parts[j].backward(trajectories[j], mu, np.zeros_like(fields[j]))
    assert mu @ f == pytest.approx(expected, rel=1e-10)


def test_stored_and_recomputed_terms_give_equal_derivatives():
    fields = to_frame(UNIT, wavy_field(UNIT, 1))[None]
    f, mu = np.random.default_rng(2).normal(size=(2, len(UNIT.vertices)))
    flow = Discretisation(UNIT).flow(fields, 1.5)
    gradients = np.zeros((2, *fields.shape))
    for keep, gradient in zip((True, False), gradients, strict=True):
        flow.backward(flow.forward(f, keep), mu, gradient)
    assert np.array_equal(gradients[0], gradients[1])
    assert np.abs(gradients).max() > 0


def reference_state(mesh, fields, f, tau, method, t):
    """Return the function at a time, computed step by step with SciPy's exponential."""
    step, sign, remaining = tau / len(fields), np.sign(t), abs(t)
    steps = []
    while remaining > 1e-14:
        steps.append((min(len(steps), len(fields) - 1), min(step, remaining)))
        remaining -= step
    for j, length in steps if sign > 0 else reversed(steps):
        D = -sign * length * directional_derivative(mesh, fields[j])
        f = f + D @ f if method == "linearised" else expm_multiply(D, f)
    return f


@pytest.mark.parametrize(("method", "within"), [("nonlinear", 1e-8), ("linearised", 1e-12)])
@pytest.mark.parametrize("count", [1, 2, 4])
def test_times_may_be_before_or_after_the_fields(method, within, count):
    """N fields share the time tau equally; outside of it the first or last one continues."""
    fields = 0.2 * np.stack([wavy_field(UNIT, seed) for seed in range(count)])
    frames, f = to_frame(UNIT, fields), bump(UNIT, UNIT.vertices[0], 0.2)[:, None] ** [1, 2]
    times = np.array([0.0, 0.13, -0.2, 0.5, 1.0, 1.7, -1.0, 0.25, -1.3])
    states = Flow(UNIT, fields, 1.0, method).push(f, times)
    np.testing.assert_array_equal(states[0], f)
    for t, state in zip(times, states, strict=True):
        near(state, reference_state(UNIT, frames, f, 1.0, method, t), within)
    near(Flow(UNIT, fields, 1.0, method).push(f, times[5]), states[5], 1e-9)


@pytest.mark.parametrize("size", [1e-150, 1.0, 1e150])
def test_negligible_values_count_as_zero(size):
    v, large = wavy_field(BALL, 2), np.where(BUMP > 0.1, size * BUMP, 0.0)
    traces = np.where(BUMP > 0.1, 0.0, 1e-130 * size)
    expected = advect(BALL, v, large, 0.7)
    assert np.abs(expected).max() > 0.1 * size
    np.testing.assert_array_equal(advect(BALL, v, large + traces, 0.7), expected)


def test_flows_on_one_mesh_are_independent():
    one, other = Flow(BALL, wavy_field(BALL, 1)), Flow(BALL, wavy_field(BALL, 2), 1.0, "linearised")
    before = one.push(BUMP, 0.5)
    other.push(BUMP, 0.5)
    np.testing.assert_array_equal(one.push(BUMP, 0.5), before)


ZERO, ZEROS = np.zeros((1280, 3)), np.zeros(642)


@pytest.mark.parametrize(
    ("velocity", "f", "t", "named", "options"),
    [
        (np.zeros((3, 3)), ZEROS, 1.0, ("velocity",), {}),
        (np.zeros((0, 1280, 3)), ZEROS, 1.0, ("velocity",), {}),
        (ZERO, np.zeros(5), 1.0, (5,), {}),
        (ZERO + np.nan, ZEROS, 1.0, (), {}),
        (ZERO, ZEROS, np.inf, (), {}),
        (ZERO, ZEROS, [0.0, np.nan], (), {}),
        (ZERO, ZEROS, [[0, 1]], (), {}),
        (ZERO, ZEROS, "1", (), {}),
        (ZERO + 1e9, np.ones(642), 1.0, (), {}),
        (ZERO, ZEROS, 1.0, ("tau", "0.0"), {"tau": 0.0}),
        (ZERO, ZEROS, 1.0, ("exact", "nonlinear"), {"method": "exact"}),
    ],
)
def test_invalid_input_is_refused(velocity, f, t, named, options):
    with raises(AbfmError, *named):
        Flow(BALL, velocity, **options).push(f, t)
    if not options:
        with raises(AbfmError, *named):
            advect(BALL, velocity, f, t)


def test_functions_may_have_the_vertices_of_the_file():
    sphere = icosphere(2)
    mesh, f = with_loose_vertex(sphere), np.arange(len(sphere.vertices) + 1.0)
    v = wavy_field(mesh, 0)
    np.testing.assert_array_equal(advect(mesh, v, f, 0.1), advect(mesh, v, np.delete(f, 5), 0.1))


def test_overflow_raises_an_error():
    mesh = icosphere(1)
    v = 10 * np.random.default_rng(0).normal(size=(len(mesh.faces), 3))
    with raises(AdvectionError):
        advect(mesh, v, np.random.default_rng(1).normal(size=len(mesh.vertices)), 1000.0)


@pytest.mark.parametrize("x", [0.0, 1e-100, 1e-5, 3.0, 80.0, 1000.0])
def test_bessel_coefficients_equal_those_of_scipy(x):
    coefficients = bessel_coefficients(x, int(x + 14 * np.cbrt(x)) + 40)
    expected = 2 * jv(np.arange(len(coefficients)), x)
    expected[0] /= 2
    near(coefficients, expected, 1e-13)


@pytest.mark.parametrize("tolerance", [1e-4, 1e-8])
def test_tolerance_bounds_the_truncation(tolerance):
    v, f = to_frame(UNIT, wavy_field(UNIT, 1))[None], bump(UNIT, UNIT.vertices[5], 0.2)
    flows = (Discretisation(UNIT).flow(v, 1.0, each) for each in (1e-14, tolerance))
    exact, rough = (flow.forward(f)[-1] for flow in flows)
    assert rough.segments[0].count < exact.segments[0].count
    near(rough.end, exact.end, tolerance * np.abs(f).max())


def differentiated(mesh, v, tau, tolerance, f):
    """Return the trajectory of a flow, and a derivative by its field (1, F, 2)."""
    flow, gradient = Discretisation(mesh).flow(v, tau, tolerance), np.zeros_like(v)
    trajectories = flow.forward(f, keep=True)
    mu = np.random.default_rng(0).normal(size=len(f))
    flow.backward(trajectories, mu, gradient)
    return trajectories[0], gradient


def test_sweeps_of_several_terms_change_nothing(monkeypatch):
    """Large meshes are swept in blocks of rows; the result equals that of one block."""
    mesh, results = torus(60, 30), []
    v, f = to_frame(mesh, wavy_field(mesh, 1))[None], bump(mesh, mesh.vertices[5], 0.2)
    for least in (10**9, 0):
        monkeypatch.setattr("abfm.flow.derivative._BLOCKED_VERTICES_MIN", least)
        fresh = abfm.TriangleMesh(mesh.vertices, mesh.faces)
        results.append(differentiated(fresh, v, 0.7, 1e-13, f))
    (one, expected), (blocks, gradient) = results
    assert len(derivative_pattern(fresh).bounds) > 4
    assert 0 <= blocks.segments[0].count - one.segments[0].count < 4
    near(blocks.end, one.end, 1e-12)
    near(gradient, expected, 1e-9 * np.abs(expected).max())


def test_scarce_memory_does_not_change_the_result(monkeypatch):
    """With little memory, terms are recomputed in short segments, with the same result."""
    v, f = to_frame(UNIT, wavy_field(UNIT, 1))[None], np.random.default_rng(2).normal(size=642)
    results = []
    for memory in (70_000_000, 70 * len(f)):
        monkeypatch.setattr("abfm.flow.exponential._MEMORY", memory)
        results.append(differentiated(UNIT, v, 4.0, 1e-10, f))
    (ample, expected), (scarce, gradient) = results
    assert ample.segments[0].terms is not None
    assert len(scarce.segments) > len(ample.segments)
    assert all(segment.terms is None for segment in scarce.segments)
    near(gradient, expected, 1e-7 * np.abs(expected).max())


def test_many_times_leave_no_large_cache_on_the_mesh():
    times, field = [0.2, 0.4, 0.8], wavy_field(BALL, 3)
    Flow(BALL, field).push(BUMP, times)  # compiles the kernels, so that only the flow is measured
    mesh = icosphere(3, radius=2.0)
    tracemalloc.start()
    try:
        flow = Flow(mesh, field)
        values = flow.push(BUMP, times)
        size, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert values.shape == (3, len(mesh.vertices))
    assert size < 300 * BUMP.nbytes
