"""Linear blend and optimal transport: kernel, marginals, mass and midpoints."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from abfm import AbfmError
from abfm.baselines import HeatKernel, linear_blend, optimal_transport
from abfm.calculus.operators import vertex_areas
from tests.core.surfaces import SURFACES
from tests.messages import raises
from tests.shapes import icosphere, open_cylinder


def test_linear_blend_interpolates_in_time():
    f, g = np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([[5.0, 2.0], [0.0, -4.0]])
    assert_array_equal(linear_blend(f, g, 0.0, 2.0), f)
    assert_array_equal(linear_blend(f, g, 2.0, 2.0), g)
    assert_array_equal(linear_blend(f, g, 0.5, 2.0), 0.75 * f + 0.25 * g)


SPHERE = icosphere(3)
P, Q = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
MIDDLE = (P + Q) / np.sqrt(2)


def angle(x):
    """Return the angle in radians between each vertex of the sphere and a point."""
    return np.arccos(np.clip(SPHERE.vertices @ x, -1, 1))


def bump(x, width=0.35):
    """Return a Gaussian on the sphere with a width in radians."""
    return np.exp(-0.5 * (angle(x) / width) ** 2)


def strip(n, length=4.0):
    """Return a thin open cylinder, in effect a flat strip, and the heights of its vertices."""
    mesh = open_cylinder(8, n, radius=0.1, height=length)
    return mesh, mesh.vertices[:, 2]


@pytest.mark.parametrize("mesh", SURFACES.values(), ids=SURFACES.keys())
@pytest.mark.parametrize("steps", [1, 3])
def test_kernel_is_positive_symmetric_and_conservative(mesh, steps):
    heat = HeatKernel(mesh, 0.3, steps)
    matrix = np.stack([heat(column) for column in np.eye(len(mesh.vertices))], axis=1)
    assert (matrix > 0).all()
    density = matrix / heat.areas
    assert_allclose(density, density.T, rtol=1e-9)
    assert_allclose(matrix.sum(axis=1), 1, rtol=1e-10)
    assert_allclose(heat.areas @ matrix, heat.areas, rtol=1e-10)
    root = np.sqrt(heat.areas)
    assert np.linalg.eigvalsh(root[:, None] * density * root).min() > 0


def test_more_steps_approximate_the_flat_heat_kernel():
    mesh, z = strip(400)
    start, total = np.exp(-0.5 * ((z - 2) / 0.3) ** 2), np.hypot(0.3, 0.2 * mesh.length_scale)
    exact = 0.3 / total * np.exp(-0.5 * ((z - 2) / total) ** 2)  # variances add up
    errors = [abs(HeatKernel(mesh, 0.2, steps)(start) - exact).max() for steps in (2, 4, 8)]
    assert_allclose(np.log2(np.array(errors[:-1]) / errors[1:]), 1, atol=0.25)


def test_ends_are_blurred_source_and_target():
    f, g = bump(P), bump(Q) + 0.5 * bump(-P)
    heat = HeatKernel(SPHERE, 0.1, 16)
    ends = optimal_transport(SPHERE, f, g, [0, 1])
    assert_allclose(ends, [heat(f), heat(g)], rtol=1e-6)
    ends = (optimal_transport(SPHERE, f, g, 0.0, blur=blur) for blur in (0.04, 0.02))
    errors = [abs(end - f).max() for end in ends]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.3)


def test_mass_is_linear_in_time():
    f, g = bump(P), 3 * bump(Q, 0.5)
    areas, times = vertex_areas(SPHERE), np.array([0, 0.2, 0.7, 1])
    for sharpen in (False, True):
        found = optimal_transport(SPHERE, f, g, times, sharpen=sharpen)
        assert (found >= 0).all()
        assert_allclose(found @ areas, (1 - times) * (areas @ f) + times * (areas @ g), rtol=1e-10)


def test_scaling_and_reversal_commute_with_transport():
    f, g, times = bump(P), 2 * bump(Q, 0.5), [0.25, 0.6]
    forward = optimal_transport(SPHERE, f, g, times)
    assert_allclose(optimal_transport(SPHERE, g, f, [0.75, 0.4]), forward, rtol=1e-10)
    assert_allclose(optimal_transport(SPHERE, 1e6 * f, 1e6 * g, times), 1e6 * forward, rtol=1e-9)
    one = optimal_transport(SPHERE, f, g, 0.25)
    assert one.shape == f.shape
    assert_allclose(one, forward[0])


@pytest.mark.parametrize("sharpen", [False, True])
def test_midpoint_on_a_sphere_is_on_the_geodesic(sharpen):
    areas = vertex_areas(SPHERE)
    middle = optimal_transport(SPHERE, bump(P), bump(Q), 0.5, sharpen=sharpen)
    centre = (areas * middle) @ SPHERE.vertices
    assert_allclose(centre / np.linalg.norm(centre), MIDDLE, atol=1e-3)
    assert angle(MIDDLE)[middle.argmax()] < 0.1
    if sharpen:
        assert areas @ abs(middle - bump(MIDDLE)) < 0.15 * (areas @ bump(MIDDLE))


def test_mean_on_a_strip_moves_evenly():
    """The mean moves at constant speed, more exactly with more steps; the width grows below 40%."""
    mesh, z = strip(160)
    f, g = (np.exp(-0.5 * ((z - centre) / 0.3) ** 2) for centre in (1.2, 2.8))
    areas, times, errors = vertex_areas(mesh), np.linspace(0, 1, 5), []
    for steps in (1, 4, 16, 64):
        found = optimal_transport(mesh, f, g, times, blur=0.2, steps=steps)
        masses = found * areas / (found @ areas)[:, None]
        means = masses @ z
        errors.append(abs(means[1] - 1.6))
    assert errors == sorted(errors, reverse=True)
    assert_allclose(means, 1.2 + 1.6 * times, atol=0.04)
    deviations = np.sqrt((masses * (z - means[:, None]) ** 2).sum(axis=1))
    blurred = np.hypot(0.3, 0.2 * mesh.length_scale)
    assert_allclose(deviations[[0, -1]], blurred, rtol=0.01)
    assert (deviations >= 0.99 * blurred).all()
    assert deviations.max() < 1.4 * blurred


def test_sharpening_limits_the_entropy():
    areas = vertex_areas(SPHERE)

    def entropy(function):
        density = function / (areas @ function)
        return -float(areas @ (density * np.log(np.maximum(density, 1e-300))))

    f, g = bump(P), bump(Q, 0.3)
    plain, sharp = (optimal_transport(SPHERE, f, g, 0.5, sharpen=s) for s in (False, True))
    assert entropy(plain) > entropy(f) + 0.1
    assert entropy(sharp) <= entropy(f) + 1e-4


def test_small_negative_values_count_as_0():
    dips = np.where(bump(P) < 1e-3, -1e-3, bump(P))
    found, expected = (
        optimal_transport(SPHERE, f, bump(Q), 0.5) for f in (dips, np.maximum(dips, 0))
    )
    assert_allclose(found, expected)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"f": bump(P) - 0.5}, ("f", 642, "-0.5")),
        ({"g": 0 * bump(P)}, ()),
        ({"g": np.full(642, np.nan)}, ()),
        ({"f": np.ones((642, 2))}, ("f", 2)),
        ({"f": np.ones(5)}, (5,)),
        ({"times": 1.5}, ("times", "1.5", 0, 1)),
        ({"times": [0.5, np.nan]}, (0, 1)),
        ({"blur": 0.0}, ("blur", "0.0")),
        ({"steps": 0}, ("steps", 0)),
        ({"f": 1.0 * (angle(P) < 0.3), "blur": 1e-5}, ()),
    ],
)
def test_invalid_arguments_are_refused(change, named):
    with raises(AbfmError, *named):
        optimal_transport(SPHERE, **{"f": bump(P), "g": bump(Q), "times": 0.5} | change)
