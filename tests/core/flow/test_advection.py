"""Advection against SciPy's exponential, exact rotations and its own adjoint."""

import numpy as np
import pytest
from scipy.sparse.linalg import expm_multiply
from scipy.special import jv

import abfm
from abfm.calculus.operators import l2_norm, vertex_areas
from abfm.calculus.vector_fields import directional_derivative, to_frame
from abfm.errors import AbfmError, AdvectionError
from abfm.flow.advection import Discretisation
from abfm.flow.derivative import derivative_pattern
from abfm.flow.exponential import bessel_coefficients
from abfm.flow.flow import advect
from tests.core.fields import bump, rotation_field, wavy_field
from tests.core.verification import observed_orders
from tests.shapes import icosphere, square, torus, with_loose_vertex

MESHES = {"closed": icosphere(3, radius=2.0), "boundary": square(16), "genus 1": torus(40, 16)}


def oracle(mesh, v, f, t):
    return expm_multiply(-t * directional_derivative(mesh, to_frame(mesh, v)), f)


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("t", [0.0, 0.3, -0.3, 2.0])
def test_equals_the_exponential_of_scipy(name, t):
    mesh = MESHES[name]
    v, f = wavy_field(mesh, 1), bump(mesh, mesh.vertices[5], 0.2)
    expected = oracle(mesh, v, f, t)
    assert np.abs(advect(mesh, v, f, t) - expected).max() <= 1e-8 * np.abs(expected).max()


def test_channels_are_carried_one_by_one():
    mesh = MESHES["closed"]
    v = wavy_field(mesh, 2)
    f = np.stack([bump(mesh, mesh.vertices[i], 0.2) for i in (0, 7, 99)], axis=1)
    carried = advect(mesh, v, f, 0.7)
    assert carried.shape == f.shape
    for c in range(3):
        assert np.array_equal(carried[:, c], advect(mesh, v, f[:, c], 0.7))


def test_a_very_long_time_is_split_into_segments_and_stays_accurate():
    mesh = icosphere(3)
    v, f = rotation_field(mesh, [0, 0, 1]), bump(mesh, [1, 0, 0], 0.2)
    t = 400.0
    expected = f
    for _ in range(8):
        expected = oracle(mesh, v, expected, t / 8)
    assert np.abs(advect(mesh, v, f, t) - expected).max() < 1e-6


def test_growing_flows_are_split_until_accurate():
    """A field on a coarse mesh whose D_v has eigenvalues far off the imaginary axis."""
    mesh = icosphere(1)
    rng = np.random.default_rng(5)
    v, f = 3 * rng.normal(size=(len(mesh.faces), 3)), rng.normal(size=len(mesh.vertices))
    expected = oracle(mesh, v, f, 6.0)
    assert np.abs(expected).max() > 1e6
    assert np.abs(advect(mesh, v, f, 6.0) - expected).max() <= 1e-6 * np.abs(expected).max()


def test_rotation_of_the_sphere_converges_with_order_two():
    """A smooth function after a turn by 90 degrees about z, against the turned function."""
    sizes, errors = [], []
    for level in (3, 4, 5):
        mesh = icosphere(level)
        f = bump(mesh, [1, 0, 0], 0.15)
        turned = bump(mesh, [0, 1, 0], 0.15)
        carried = advect(mesh, rotation_field(mesh, [0, 0, 1]), f, np.pi / 2)
        sizes.append(1 / 2**level)
        errors.append(l2_norm(mesh, carried - turned) / l2_norm(mesh, turned))
    orders = observed_orders(sizes, errors)
    assert orders[-1] > 1.8
    assert errors[-1] < 0.02


def test_constants_stay_and_time_composes():
    mesh = MESHES["genus 1"]
    v, f = wavy_field(mesh, 3), bump(mesh, mesh.vertices[50], 0.2)
    assert advect(mesh, v, np.ones(len(mesh.vertices)), 1.0) == pytest.approx(1.0, abs=1e-9)
    assert advect(mesh, v, advect(mesh, v, f, 0.4), 0.6) == pytest.approx(
        advect(mesh, v, f, 1.0), abs=1e-8
    )
    assert advect(mesh, v, advect(mesh, v, f, 0.5), -0.5) == pytest.approx(f, abs=1e-7)


@pytest.mark.parametrize("method", ["nonlinear", "linearised"])
@pytest.mark.parametrize("count", [1, 3])
def test_backward_is_the_adjoint_of_forward_in_f(method, count):
    """<mu, forward(f)> = <backward(mu), f> for every mu and f: forward is linear in f."""
    mesh = MESHES["boundary"].normalized()
    fields = np.stack([to_frame(mesh, wavy_field(mesh, seed)) for seed in range(count)])
    rng = np.random.default_rng(1)
    f, mu = rng.normal(size=(2, len(mesh.vertices)))
    flow = Discretisation(mesh, method).flow(fields, 0.2)
    trajectories = flow.forward(f, keep=True)
    left = mu @ trajectories[-1].end
    for j in reversed(range(count)):
        mu = flow.parts[j].backward(trajectories[j], mu, np.zeros_like(fields[j]))
    assert mu @ f == pytest.approx(left, rel=1e-10)


def test_kept_and_recomputed_terms_give_the_same_derivative():
    mesh = MESHES["closed"].normalized()
    fields = to_frame(mesh, wavy_field(mesh, 1))[None]
    f, mu = np.random.default_rng(2).normal(size=(2, len(mesh.vertices)))
    flow = Discretisation(mesh).flow(fields, 1.5)
    gradients = np.zeros((2, *fields.shape))
    for keep, gradient in zip((True, False), gradients, strict=True):
        flow.backward(flow.forward(f, keep), mu, gradient)
    assert np.array_equal(gradients[0], gradients[1])
    assert np.abs(gradients).max() > 0


def reference_states(mesh, fields, f, tau, method, t):
    """Dense-free reference: step by step with SciPy."""
    step = tau / len(fields)
    sign, left = np.sign(t), abs(t)
    steps = []
    j = 0
    while left > 1e-14:
        steps.append((min(j, len(fields) - 1), min(step, left)))
        left -= step
        j += 1
    for j, length in steps if sign > 0 else reversed(steps):
        D = directional_derivative(mesh, fields[j])
        f = (
            f - sign * length * (D @ f)
            if method == "linearised"
            else expm_multiply(-sign * length * D, f)
        )
    return f


@pytest.mark.parametrize("method", ["nonlinear", "linearised"])
@pytest.mark.parametrize("count", [1, 4])
def test_times_inside_beyond_and_before(method, count):
    mesh = MESHES["closed"].normalized()
    fields = 0.2 * np.stack([to_frame(mesh, wavy_field(mesh, seed)) for seed in range(count)])
    f = bump(mesh, mesh.vertices[0], 0.2)
    times = np.array([0.0, 0.13, -0.2, 0.5, 1.0, 1.7, -1.0, 0.25, -1.3])
    states = Discretisation(mesh, method).flow(fields, 1.0).at(f, times)
    for t, state in zip(times, states, strict=True):
        assert state == pytest.approx(reference_states(mesh, fields, f, 1.0, method, t), abs=1e-8)


def test_mass_changes_only_by_the_divergence():
    """d/dt of the integral of f is that of f div v; 0 for a rotation, in the limit."""
    mesh = icosphere(4)
    f = bump(mesh, [1, 0, 0], 0.15)
    carried = advect(mesh, rotation_field(mesh, [0, 0, 1]), f, 1.0)
    areas = vertex_areas(mesh)
    assert areas @ carried == pytest.approx(areas @ f, rel=2e-3)


@pytest.mark.parametrize(
    ("velocity", "f", "t", "words"),
    [
        (np.zeros((3, 3)), np.zeros(642), 1.0, "velocity has shape"),
        (np.zeros((1280, 3)), np.zeros(5), 1.0, "5 values were given"),
        (np.full((1280, 3), np.nan), np.zeros(642), 1.0, "finite"),
        (np.zeros((1280, 3)), np.zeros(642), np.inf, "finite"),
        (np.full((1280, 3), 1e9), np.ones(642), 1.0, "shorten the time"),
        (np.zeros((1280, 3)), np.zeros(642), [[0, 1]], "expected a finite time"),
        (np.zeros((1280, 3)), np.zeros(642), "1", "expected real numbers"),
    ],
)
def test_bad_input_is_refused_in_words(velocity, f, t, words):
    with pytest.raises(AbfmError, match=words):
        advect(icosphere(3), velocity, f, t)


def test_functions_may_come_with_the_vertices_of_the_file():
    sphere = icosphere(2)
    mesh = with_loose_vertex(sphere)
    f = np.arange(len(sphere.vertices) + 1.0)
    v = wavy_field(mesh, 0)
    np.testing.assert_array_equal(advect(mesh, v, f, 0.1), advect(mesh, v, np.delete(f, 5), 0.1))


def test_overflow_is_an_error_and_not_an_array():
    mesh = icosphere(1)
    v = 10 * np.random.default_rng(0).normal(size=(len(mesh.faces), 3))
    with pytest.raises(AdvectionError, match="overflow"):
        advect(mesh, v, np.random.default_rng(1).normal(size=len(mesh.vertices)), 1000.0)


@pytest.mark.parametrize("x", [0.0, 1e-100, 1e-5, 3.0, 80.0, 1000.0])
def test_bessel_coefficients_are_those_of_scipy(x):
    coefficients = bessel_coefficients(x, int(x + 14 * np.cbrt(x)) + 40)
    expected = 2 * jv(np.arange(len(coefficients)), x)
    expected[0] /= 2
    np.testing.assert_allclose(coefficients, expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize("tolerance", [1e-4, 1e-8])
def test_tolerance_bounds_the_truncation(tolerance):
    mesh = MESHES["closed"].normalized()
    v, f = to_frame(mesh, wavy_field(mesh, 1))[None], bump(mesh, mesh.vertices[5], 0.2)
    exact, rough = (
        Discretisation(mesh).flow(v, 1.0, each).forward(f)[-1] for each in (1e-14, tolerance)
    )
    assert rough.segments[0].count < exact.segments[0].count
    assert np.abs(rough.end - exact.end).max() <= tolerance * np.abs(f).max()


def test_several_terms_in_one_sweep_are_the_same_terms(monkeypatch):
    """Blocks of rows, as large meshes have them, against one block."""
    mesh = torus(60, 30)
    v, f = wavy_field(mesh, 1), bump(mesh, mesh.vertices[5], 0.2)
    mu = np.random.default_rng(0).normal(size=len(mesh.vertices))
    results = []
    for least in (10**9, 0):
        monkeypatch.setattr("abfm.flow.derivative._BLOCKED", least)
        fresh = abfm.TriangleMesh(mesh.vertices, mesh.faces)
        flow = Discretisation(fresh).flow(to_frame(fresh, v)[None], 0.7, 1e-13)
        gradient = np.zeros((1, len(mesh.faces), 2))
        trajectories = flow.forward(f, keep=True)
        flow.backward(trajectories, mu, gradient)
        results.append((trajectories[0].segments[0].count, trajectories[0].end, gradient))
    one, blocks = results
    assert len(derivative_pattern(fresh).bounds) > 4
    assert 0 <= blocks[0] - one[0] < 4
    np.testing.assert_allclose(blocks[1], one[1], rtol=0, atol=1e-12)
    np.testing.assert_allclose(blocks[2], one[2], rtol=0, atol=1e-9 * np.abs(one[2]).max())


def test_little_memory_changes_nothing_but_the_time(monkeypatch):
    """Short segments whose terms are computed again."""
    mesh = MESHES["closed"].normalized()
    fields = to_frame(mesh, wavy_field(mesh, 1))[None]
    f, mu = np.random.default_rng(2).normal(size=(2, len(mesh.vertices)))
    results = []
    for memory in (70_000_000, 70 * len(mesh.vertices)):
        monkeypatch.setattr("abfm.flow.exponential._MEMORY", memory)
        flow = Discretisation(mesh).flow(fields, 4.0)
        gradient = np.zeros_like(fields)
        [trajectory] = flow.forward(f, keep=True)
        flow.backward([trajectory], mu, gradient)
        results.append((trajectory, gradient))
    (ample, expected), (scarce, gradient) = results
    assert ample.segments[0].terms is not None
    assert len(scarce.segments) > len(ample.segments)
    assert all(segment.terms is None for segment in scarce.segments)
    np.testing.assert_allclose(gradient, expected, rtol=0, atol=1e-7 * np.abs(expected).max())
