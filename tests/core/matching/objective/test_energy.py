"""The energy and its gradient, as the paper and as the stages of a match have them."""

import gc
import weakref

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.sparse.linalg import expm_multiply

from abfm import MatchingEnergy, Parameters
from abfm.calculus.operators import function_norm_matrix, vector_norm_matrix
from abfm.calculus.vector_fields import directional_derivative, to_frame
from abfm.parameters import PAPER
from tests.core.fields import bump, wavy_field
from tests.core.verification import taylor_order
from tests.shapes import hemisphere, icosphere, open_cylinder

MESHES = {"closed": icosphere(2, radius=3.0), "boundary": hemisphere(7)}
CLOSED, OPEN = MESHES.values()
FINE = {"closed": icosphere(3, radius=3.0), "boundary": hemisphere(12)}
USUAL = Parameters(alpha=0.05, beta=0.01, sigma=0.1, tau=1.3)
PLAIN = Parameters.of(**PAPER, alpha=0.1, beta=0.01, sigma=0.1, tau=1.3)
FAR = [0.0, 0.4]


def problem(mesh, channels=1):
    """Bumps (V, C) and others elsewhere, each channel ten times as large as the one before."""
    sizes, starts = 10.0 ** np.arange(channels), range(0, 30 * channels, 30)
    f = np.stack([bump(mesh, mesh.vertices[i], 0.2) for i in starts], axis=1)
    g = np.stack([bump(mesh, mesh.vertices[i + 17], 0.15) for i in starts], axis=1)
    return sizes * f, sizes * g


def fields(mesh, count):
    """Smooth ones (N, F, 3) in units of the mesh scaled to unit area."""
    return 0.2 * np.stack([wavy_field(mesh, seed) for seed in range(count)]) / mesh.length_scale


def frames(mesh, count):
    return to_frame(mesh, fields(mesh, count))


def energy(mesh, channels=1, p=USUAL, **changes):
    """With a mask and weights where there are several channels."""
    mask = 0.1 + np.random.default_rng(0).random(len(mesh.vertices)) if channels > 1 else None
    weights = [1.0, 0.0, 2.5][:channels] if channels > 1 else None
    return MatchingEnergy(
        mesh, *problem(mesh, channels), p.with_values(**changes), mask=mask, weights=weights
    )


def order_at(E, v, size=0.02, **of_stage):
    """Smallest order of the remainder of a Taylor expansion in a random direction."""

    def evaluate(x):
        found = E.objective(0.2, **of_stage).evaluate(x)
        return found.energy, found.gradient

    return taylor_order(evaluate, v, size * np.random.default_rng(1).normal(size=v.shape))


@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES.keys())
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("reach", FAR)
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize(
    "kind",
    [{"segments": 1}, {"segments": 3}, {"method": "linearised", "segments": 4}],
    ids=["one field", "three fields", "linearised"],
)
def test_gradient_is_exact_as_stages_have_it(mesh, order, reach, channels, kind):
    E = energy(mesh, channels, order=order, sigma_unit="relative", **kind)
    v = frames(mesh, E.parameters.solver.segments)
    assert order_at(E, v, reach=reach) >= 1.9
    assert order_at(energy(mesh, order=order), np.zeros((1, *v.shape[1:])), reach=reach) >= 1.9


@pytest.mark.parametrize("tolerance", [1e-2, 1e-6, 1e-10])
@pytest.mark.parametrize("reach", FAR)
def test_gradient_is_that_of_the_truncated_sum(tolerance, reach):
    """Small steps, so that the number of terms stays."""
    E = energy(CLOSED, 3, order=2)
    assert order_at(E, frames(CLOSED, 1), 1e-3, reach=reach, tolerance=tolerance) >= 1.9


@pytest.mark.parametrize("reach", FAR)
def test_gradient_is_exact_where_a_shift_is_taken_off_what_is_carried(reach):
    E = energy(CLOSED, 3, order=2)
    shift = np.random.default_rng(3).normal(size=E.functions.source.shape)
    assert order_at(E, frames(CLOSED, 1), reach=reach, shift=shift) >= 1.9


@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES.keys())
def test_a_shift_taken_off_is_one_put_on_the_target(mesh):
    (f, g), v = problem(mesh, 3), frames(mesh, 1)
    p = USUAL.with_values(sigma_unit="absolute", divergence=1.0)
    shift = np.random.default_rng(3).normal(size=g.shape)
    shifted, other = MatchingEnergy(mesh, f, g, p), MatchingEnergy(mesh, f, g + shift, p)
    found = shifted.objective(0.1, shift=shift.T).evaluate(v)
    wanted = other.objective(0.1).evaluate(v)
    assert found.energy == pytest.approx(wanted.energy, rel=1e-12)
    assert_allclose(found.gradient, wanted.gradient, rtol=1e-9, atol=1e-9)
    assert_array_equal(found.advected, wanted.advected)  # what was carried is as it was


def test_looser_sums_are_shorter_and_close():
    E, v = energy(CLOSED), 5 * frames(CLOSED, 1)
    exact = E.objective(0.2).evaluate(v).energy
    found = [E.objective(0.2, tolerance=t).evaluate(v).energy for t in (1e-2, 1e-4, 1e-7)]
    errors = [abs(one / exact - 1) for one in found]
    assert errors == sorted(errors, reverse=True)
    assert errors[0] > 1e-6 > errors[-1]


@pytest.mark.parametrize("extras", [{}, {"gradient": "bracket"}, {"method": "linearised"}])
def test_gradient_may_be_asked_for_late(extras):
    """Later evaluations use the same memory."""
    mesh = FINE["closed"]
    E = MatchingEnergy(mesh, *problem(mesh, 2), PLAIN.with_values(segments=0, **extras))
    v, w = (to_frame(E.mesh, wavy_field(mesh, seed))[None] / 10 for seed in (1, 2))
    early = E.objective(0.1).evaluate(v).gradient
    late = E.objective(0.1).evaluate(v)
    assert np.abs(E.objective(0.1).evaluate(w).gradient).max() > 0
    assert_array_equal(late.gradient, early)


def test_value_is_the_formula():
    """Eq. 6 with SciPy's exponential and explicit matrices, on the mesh scaled to unit area."""
    mesh, p = FINE["boundary"], PLAIN.with_values(segments=3)
    (f, g), unit, v = problem(mesh, 2), mesh.normalized(), fields(mesh, 3)
    mask, weights = np.linspace(0.01, 1, len(mesh.vertices)), [0.5, 2.0]
    R, C = vector_norm_matrix(unit, p.alpha), function_norm_matrix(unit, p.beta, mask)
    advected, regularity = f, 0.0
    for field in to_frame(unit, v):
        regularity += 0.5 * p.tau / 3 * field.ravel() @ (R @ field.ravel())
        advected = expm_multiply(-p.tau / 3 * directional_derivative(unit, field), advected)
    misfit = sum(w * r @ (C @ r) for w, r in zip(weights, (advected - g).T, strict=True))
    value, _ = MatchingEnergy(mesh, f, g, p, mask=mask, weights=weights)(v)
    assert value == pytest.approx(regularity + 0.5 / p.sigma**2 * misfit, rel=1e-9)


def test_bracket_gradient_approaches_the_exact_one_with_more_substeps():
    mesh = FINE["closed"]
    v = 0.15 * wavy_field(mesh, 4)[None] / mesh.length_scale

    def gradient(**changes):
        found = MatchingEnergy(mesh, *problem(mesh), PLAIN.with_values(alpha=0.0, **changes))(v)[1]
        return found / np.linalg.norm(found)

    exact = gradient()
    cosines = [float((exact * gradient(gradient="bracket", substeps=n)).sum()) for n in (2, 8, 32)]
    assert cosines == sorted(cosines)
    assert cosines[-1] > 0.9


def test_linearised_bracket_is_the_exact_gradient():
    """Eq. 8 needs no bracket."""
    mesh, p = FINE["closed"], PLAIN.with_values(method="linearised", segments=3)
    exact, bracket = (
        MatchingEnergy(mesh, *problem(mesh), p.with_values(gradient=kind))(fields(mesh, 3))[1]
        for kind in ("adjoint", "bracket")
    )
    assert_array_equal(exact, bracket)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("segments", [1, 3])
def test_bracket_gradient_at_rest_is_exact_with_reach_and_either_order(order, segments):
    """At v = 0 there is nothing to approximate, whatever measures the mismatch."""
    exact, bracket = (
        energy(OPEN, 3, order=order, segments=segments, gradient=kind)
        for kind in ("adjoint", "bracket")
    )
    for reach in FAR:
        found = bracket.objective(0.2, reach).evaluate(np.zeros(bracket.shape)).gradient
        expected = exact.objective(0.2, reach).evaluate(np.zeros(exact.shape)).gradient
        assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("alpha", [0.0, 0.002, 0.7])
def test_another_alpha_is_that_of_other_parameters(order, alpha):
    """To the last bit, also for the inverse, and what the parameters have stays."""
    E, other, v = energy(OPEN, order=order), energy(OPEN, order=order, alpha=alpha), frames(OPEN, 1)
    before = E.objective(0.2).evaluate(v)
    found = E.objective(0.2, alpha=alpha).evaluate(v)
    expected = other.objective(0.2).evaluate(v)
    assert found.energy == expected.energy != before.energy
    assert_array_equal(found.gradient, expected.gradient)
    assert_array_equal(E.regularizer(alpha).inverse(v[0]), other.regularizer().inverse(v[0]))
    assert E.objective(0.2).evaluate(v).energy == before.energy
    assert E.regularizer() is E.regularizer(0.05)
    assert E.regularizer(alpha) is E.regularizer(alpha)
    assert order_at(E, v, alpha=alpha) >= 1.9


def test_of_other_alphas_only_the_latest_is_kept():
    """Factors are large, and closing stages have many alphas."""
    E = energy(OPEN)
    usual, known = E.regularizer(), [weakref.ref(E.regularizer(alpha)) for alpha in (0.3, 0.2, 0.1)]
    gc.collect()
    assert [one() is not None for one in known] == [False, False, True]
    assert E.regularizer() is usual
    assert E.clustered().regularizer() is energy(OPEN).regularizer() is usual


@pytest.mark.parametrize("order", [1, 2])
def test_order_changes_the_regularity_alone(order):
    """``dtau / 2 sum_j <v_j, R_order v_j>``, and the mismatch is that of the other order."""
    E, other = (energy(OPEN, order=k, segments=3) for k in (order, 3 - order))
    v = frames(OPEN, 3)
    found = E.objective(0.2).evaluate(v)
    expected = sum(float((one * E.regularizer().apply(one)).sum()) for one in v) * 1.3 / 3 / 2
    assert found.regularity == pytest.approx(expected, rel=1e-12)
    assert found.mismatch == other.objective(0.2).evaluate(v).mismatch
    assert found.energy == pytest.approx(found.regularity + found.mismatch, rel=1e-15)
    assert E.regularizer().order == order


def test_function_size_is_the_larger_deviation_and_never_zero():
    """Of the sphere's height, ``||z||^2 = area R^2 / 3``; the mean of z^4 is R^4 / 5."""
    mesh = icosphere(4, radius=2.0)
    z, flat = mesh.vertices[:, 2], np.full(len(mesh.vertices), 5.0)

    def size(f, g, **given):
        return MatchingEnergy(mesh, f, g, **given).functions.function_size

    assert size(z, flat) == pytest.approx(2 / np.sqrt(3), rel=1e-3)
    assert size(7 + z, -3 * z) == pytest.approx(6 / np.sqrt(3), rel=1e-3)
    both = np.stack([z, z], axis=1), np.stack([flat, flat], axis=1)
    assert size(*both, weights=[1.0, 8.0]) == pytest.approx(6 / np.sqrt(3), rel=1e-3)
    assert size(z, flat, mask=z**2) == pytest.approx(4 / np.sqrt(5), rel=1e-3)
    assert size(flat, 2 * flat) == 1.0


def test_absolute_sigma_is_left_alone():
    relative, absolute = (
        MatchingEnergy(CLOSED, *problem(CLOSED), Parameters.of(sigma_unit=unit))
        for unit in ("relative", "absolute")
    )
    v, size = frames(CLOSED, 1), relative.functions.function_size
    expected = absolute.objective(0.3 * size).evaluate(v).energy
    assert relative.objective(0.3).evaluate(v).energy == pytest.approx(expected, rel=1e-12)


def test_exponent_is_a_bound_of_the_spectrum_times_time():
    """Homogeneous in the fields, the same in other units, the sum over fields in a row."""
    mesh = open_cylinder(16, 6)
    v, E = frames(mesh, 2), energy(mesh, segments=2)
    whole = E.flow(v).exponent
    assert E.flow(2 * v).exponent == pytest.approx(2 * whole, rel=1e-12)  # octaves of the bounds
    parts = [E.flow(np.stack([one, one])).exponent / 2 for one in v]
    assert whole == pytest.approx(sum(parts), rel=1e-12)
    eigenvalues = [np.linalg.eigvals(directional_derivative(E.mesh, one).toarray()) for one in v]
    assert whole >= 1.3 / 2 * sum(abs(of_one).max() for of_one in eigenvalues)
    assert energy(mesh, method="linearised", segments=2).flow(v).exponent == 0


def test_the_source_carried_is_that_of_the_evaluation_and_at_overflow_the_energy_is_infinite():
    E, v = energy(OPEN, 3, segments=2), frames(OPEN, 2)
    assert_array_equal(E.advected(v), E.objective(0.2).evaluate(v).advected)
    assert np.isnan(E.advected(1e9 * v)).all()
    mesh = FINE["closed"]
    assert MatchingEnergy(mesh, *problem(mesh), PLAIN)(1e6 * wavy_field(mesh, 0)[None])[0] == np.inf
