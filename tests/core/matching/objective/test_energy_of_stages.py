"""The energy as the stages of a match have it."""

import gc
import weakref

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import abfm
from abfm.calculus.operators import l2_norm
from abfm.calculus.vector_fields import directional_derivative, to_frame
from abfm.matching.objective.matching_energy import MatchingEnergy
from tests.core.fields import bump, wavy_field
from tests.core.verification import taylor_order
from tests.shapes import hemisphere, icosphere, open_cylinder

MESHES = {"closed": icosphere(2, radius=3.0), "boundary": hemisphere(7)}
PLAIN = {"alpha": 0.05, "beta": 0.01, "sigma": 0.1, "tau": 1.3}
FAR = [0.0, 0.4]


def problem(mesh, channels=1):
    """Bumps (V, C) and others elsewhere, of which each channel is ten times as large as the one
    before.
    """
    sizes = 10.0 ** np.arange(channels)
    starts = range(0, 30 * channels, 30)
    f = np.stack([bump(mesh, mesh.vertices[i], 0.2) for i in starts], axis=1)
    g = np.stack([bump(mesh, mesh.vertices[i + 17], 0.15) for i in starts], axis=1)
    return sizes * f, sizes * g


def fields(mesh, count):
    """Frame coefficients (N, F, 2) of smooth fields on the mesh scaled to unit area."""
    return (
        0.2
        * np.stack([to_frame(mesh, wavy_field(mesh, seed)) for seed in range(count)])
        / mesh.length_scale
    )


def energy(mesh, channels=1, **changes):
    """With a mask and weights where there are several channels."""
    mask = 0.1 + np.random.default_rng(0).random(len(mesh.vertices)) if channels > 1 else None
    weights = [1.0, 0.0, 2.5][:channels] if channels > 1 else None
    p = abfm.Parameters(**PLAIN | changes)
    return MatchingEnergy(mesh, *problem(mesh, channels), p, mask=mask, weights=weights)


def order_at(E, v, size=0.02, **of_stage):
    """Smallest order of the remainder of a Taylor expansion in a random direction."""

    def evaluate(x):
        found = E.objective(0.2, **of_stage).evaluate(x)
        return found.energy, found.gradient

    return taylor_order(evaluate, v, size * np.random.default_rng(1).normal(size=v.shape))


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("reach", FAR)
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize(
    "kind",
    [{}, {"segments": 3}, {"method": "linearised", "segments": 4}],
    ids=["one field", "three fields", "linearised"],
)
def test_gradient_is_exact(name, order, reach, channels, kind):
    """With the target itself, and with one that was moved."""
    mesh = MESHES[name]
    E = energy(mesh, channels, order=order, sigma_unit="relative", **kind)
    v = fields(mesh, E.parameters.segments)
    offset = 0.3 * E.functions.source
    assert order_at(E, v, reach=reach) >= 1.9
    assert order_at(E, v, reach=reach, offset=offset) >= 1.9


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("reach", FAR)
@pytest.mark.parametrize("name", MESHES)
def test_gradient_at_rest_is_exact(name, order, reach):
    E = energy(MESHES[name], order=order)
    assert order_at(E, np.zeros(E.shape), reach=reach) >= 1.9


@pytest.mark.parametrize("tolerance", [1e-2, 1e-6, 1e-10])
@pytest.mark.parametrize("reach", FAR)
def test_gradient_is_that_of_the_truncated_sum(tolerance, reach):
    """Small steps, so that the number of terms stays."""
    E = energy(MESHES["closed"], 3, order=2)
    v = fields(MESHES["closed"], 1)
    assert order_at(E, v, 1e-3, reach=reach, tolerance=tolerance) >= 1.9


def test_looser_sums_are_shorter_and_close():
    E = energy(MESHES["closed"])
    v = 5 * fields(MESHES["closed"], 1)
    exact = E.objective(0.2).evaluate(v).energy
    errors = [
        abs(E.objective(0.2, tolerance=tolerance).evaluate(v).energy / exact - 1)
        for tolerance in (1e-2, 1e-4, 1e-7)
    ]
    assert errors == sorted(errors, reverse=True)
    assert errors[0] > 1e-6
    assert errors[-1] < 1e-6


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("segments", [1, 3])
def test_bracket_gradient_at_rest_is_exact_with_reach_and_either_order(order, segments):
    """At v = 0 there is nothing to approximate, whatever measures the mismatch."""
    exact, bracket = (
        energy(MESHES["boundary"], 3, order=order, segments=segments, gradient=kind)
        for kind in ("adjoint", "bracket")
    )
    for reach in FAR:
        found = bracket.objective(0.2, reach).evaluate(np.zeros(bracket.shape)).gradient
        expected = exact.objective(0.2, reach).evaluate(np.zeros(exact.shape)).gradient
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("alpha", [0.0, 0.002, 0.7])
def test_another_alpha_is_that_of_other_parameters(order, alpha):
    """To the last bit, also for the inverse, and what the parameters have stays."""
    mesh = MESHES["boundary"]
    E, other = energy(mesh, order=order), energy(mesh, order=order, alpha=alpha)
    v = fields(mesh, 1)
    before, found, expected = (
        E.objective(0.2).evaluate(v),
        E.objective(0.2, alpha=alpha).evaluate(v),
        other.objective(0.2).evaluate(v),
    )
    assert found.energy == expected.energy != before.energy
    assert_array_equal(found.gradient, expected.gradient)
    assert_array_equal(E.regularizer(alpha).inverse(v[0]), other.regularizer().inverse(v[0]))
    assert E.objective(0.2).evaluate(v).energy == before.energy
    assert E.regularizer() is E.regularizer(0.05)
    assert E.regularizer(alpha) is E.regularizer(alpha)
    assert order_at(E, v, alpha=alpha) >= 1.9


def test_of_other_alphas_only_the_latest_is_kept():
    """Factors are large, and closing stages have many alphas."""
    E = energy(MESHES["boundary"])
    usual, known = E.regularizer(), [weakref.ref(E.regularizer(alpha)) for alpha in (0.3, 0.2, 0.1)]
    gc.collect()
    assert [one() is not None for one in known] == [False, False, True]
    assert E.regularizer() is usual
    assert E.clustered().regularizer() is usual


@pytest.mark.parametrize("order", [1, 2])
def test_order_changes_the_regularity_alone(order):
    """``dtau / 2 sum_j <v_j, R_order v_j>``, and the mismatch is that of the other order."""
    mesh = MESHES["boundary"]
    E, other = energy(mesh, order=order, segments=3), energy(mesh, order=3 - order, segments=3)
    v = fields(mesh, 3)
    found = E.objective(0.2).evaluate(v)
    expected = sum(float((one * E.regularizer().apply(one)).sum()) for one in v) * 1.3 / 3 / 2
    assert found.regularity == pytest.approx(expected, rel=1e-12)
    assert found.mismatch == other.objective(0.2).evaluate(v).mismatch
    assert found.energy == pytest.approx(found.regularity + found.mismatch, rel=1e-15)
    assert E.regularizer().order == order


def test_an_offset_moves_the_target():
    mesh = MESHES["closed"]
    f, g = problem(mesh)
    offset = bump(mesh, mesh.vertices[50], 0.3)[None]
    v = fields(mesh, 1)
    p = abfm.Parameters(**PLAIN | {"sigma_unit": "absolute"})
    moved = MatchingEnergy(mesh, f, g, p)
    given = MatchingEnergy(mesh, f, (moved.functions.target + offset).T, p)
    expected = given.objective(0.2).evaluate(v)
    found = moved.objective(0.2, offset=offset).evaluate(v)
    assert found.energy == expected.energy
    np.testing.assert_array_equal(found.gradient, expected.gradient)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e6])
def test_relative_sigma_makes_the_functions_unit_and_offset_meaningless(scale):
    """Without beta the mismatch has no unit left."""
    mesh = MESHES["boundary"]
    f, g = problem(mesh, 2)
    p = abfm.Parameters(sigma_unit="relative", tau=1.3)
    v = fields(mesh, 1)
    one, other = (
        MatchingEnergy(mesh, f, g, p),
        MatchingEnergy(mesh, scale * (f + 3), scale * (g + 3), p),
    )
    assert other.functions.function_size == pytest.approx(
        scale * one.functions.function_size, rel=1e-12
    )
    for reach in FAR:
        assert other.objective(0.1, reach).evaluate(v).energy == pytest.approx(
            one.objective(0.1, reach).evaluate(v).energy, rel=1e-8
        )


def test_function_size_is_the_larger_deviation_and_never_zero():
    """Of the sphere's height function, ``||z||^2 = area R^2 / 3``."""
    mesh = icosphere(4, radius=2.0)
    z, flat = mesh.vertices[:, 2], np.full(len(mesh.vertices), 5.0)
    p = abfm.Parameters()
    assert MatchingEnergy(mesh, z, flat, p).functions.function_size == pytest.approx(
        2 / np.sqrt(3), rel=1e-3
    )
    assert MatchingEnergy(mesh, 7 + z, -3 * z, p).functions.function_size == pytest.approx(
        6 / np.sqrt(3), rel=1e-3
    )
    both = MatchingEnergy(
        mesh, np.stack([z, z], axis=1), np.stack([flat, flat], axis=1), p, weights=[1.0, 8.0]
    )
    assert both.functions.function_size == pytest.approx(6 / np.sqrt(3), rel=1e-3)
    polar = MatchingEnergy(mesh, z, flat, p, mask=z**2)  # the mean of z^4 is R^4 / 5
    assert polar.functions.function_size == pytest.approx(4 / np.sqrt(5), rel=1e-3)
    assert MatchingEnergy(mesh, flat, 2 * flat, p).functions.function_size == 1.0


def test_absolute_sigma_is_left_alone():
    mesh = MESHES["closed"]
    f, g = problem(mesh)
    relative, absolute = (
        MatchingEnergy(mesh, f, g, abfm.Parameters(sigma_unit=unit))
        for unit in ("relative", "absolute")
    )
    v = fields(mesh, 1)
    size = relative.functions.function_size
    assert relative.objective(0.3).evaluate(v).energy == pytest.approx(
        absolute.objective(0.3 * size).evaluate(v).energy, rel=1e-12
    )


def test_exponent_is_a_bound_of_the_spectrum_times_time():
    """Homogeneous in the fields, the same in other units, the sum over fields in a row."""
    mesh = open_cylinder(16, 6)
    v = fields(mesh, 2)
    E = energy(mesh, segments=2)
    whole = E.flow(v).exponent
    # the grid of bounds is one of octaves
    assert E.flow(2 * v).exponent == pytest.approx(2 * whole, rel=1e-12)
    parts = [E.flow(np.stack([one, one])).exponent / 2 for one in v]
    assert whole == pytest.approx(sum(parts), rel=1e-12)
    eigenvalues = [np.linalg.eigvals(directional_derivative(E.mesh, one).toarray()) for one in v]
    assert whole >= 1.3 / 2 * sum(abs(of_one).max() for of_one in eigenvalues)
    assert energy(mesh, method="linearised", segments=2).flow(v).exponent == 0


def test_the_source_carried_is_that_of_the_evaluation():
    mesh = MESHES["boundary"]
    E = energy(mesh, 3, segments=2)
    v = fields(mesh, 2)
    np.testing.assert_array_equal(E.advected(v), E.objective(0.2).evaluate(v).advected)
    assert np.isnan(E.advected(1e9 * v)).all()


def test_norms_relative_to_the_target():
    mesh = MESHES["boundary"]
    E = energy(mesh, 3)
    assert E.relative_mismatch(2 * E.functions.target) == pytest.approx(1, rel=1e-12)
    assert E.functions.norm(E.functions.source - E.functions.target) / E.functions.norm(
        E.functions.target
    ) == pytest.approx(E.relative_mismatch(E.functions.source), rel=1e-9)
    root = np.sqrt(E.functions.weights)[:, None]
    by_hand = l2_norm(
        mesh, (root * (E.functions.source - E.functions.target)).T, E.functions.mask
    ) / l2_norm(mesh, (root * E.functions.target).T, E.functions.mask)
    assert E.relative_mismatch(E.functions.source) == pytest.approx(by_hand, rel=1e-12)
