"""The energy and its gradient, for the paper and for the stages of a match."""

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
FINE_MESHES = {"closed": icosphere(3, radius=3.0), "boundary": hemisphere(12)}
PARAMETERS = Parameters(alpha=0.05, beta=0.01, sigma=0.1, tau=1.3)
PAPER_PARAMETERS = Parameters.of(**PAPER, alpha=0.1, beta=0.01, sigma=0.1, tau=1.3)
REACHES = [0.0, 0.4]


def problem(mesh, channels=1):
    """Return bumps and other bumps, (V, C); each channel is ten times the previous one."""
    sizes, starts = 10.0 ** np.arange(channels), range(0, 30 * channels, 30)
    f = np.stack([bump(mesh, mesh.vertices[i], 0.2) for i in starts], axis=1)
    g = np.stack([bump(mesh, mesh.vertices[i + 17], 0.15) for i in starts], axis=1)
    return sizes * f, sizes * g


def fields(mesh, count):
    """Return smooth fields (N, F, 3), in the unit of the mesh scaled to unit area."""
    return 0.2 * np.stack([wavy_field(mesh, seed) for seed in range(count)]) / mesh.length_scale


def frames(mesh, count):
    return to_frame(mesh, fields(mesh, count))


def energy(mesh, channels=1, p=PARAMETERS, **changes):
    """Return the energy; several channels have a mask and weights."""
    mask = 0.1 + np.random.default_rng(0).random(len(mesh.vertices)) if channels > 1 else None
    weights = [1.0, 0.0, 2.5][:channels] if channels > 1 else None
    functions, p = problem(mesh, channels), p.with_values(**changes)
    return MatchingEnergy(mesh, *functions, p, mask=mask, weights=weights)


def order_at(E, v, size=0.02, **of_stage):
    """Return the smallest order of the Taylor remainder in a random direction."""

    def evaluate(x):
        found = E.objective(0.2, **of_stage).evaluate(x)
        return found.energy, found.gradient

    return taylor_order(evaluate, v, size * np.random.default_rng(1).normal(size=v.shape))


@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES.keys())
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("reach", REACHES)
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize(
    "kind",
    [{"segments": 1}, {"segments": 3}, {"method": "linearised", "segments": 4}],
    ids=["one field", "three fields", "linearised"],
)
def test_gradient_is_exact(mesh, order, reach, channels, kind):
    E = energy(mesh, channels, order=order, sigma_unit="relative", **kind)
    v = frames(mesh, E.parameters.solver.segments)
    assert order_at(E, v, reach=reach) >= 1.9
    assert order_at(energy(mesh, order=order), np.zeros((1, *v.shape[1:])), reach=reach) >= 1.9


@pytest.mark.parametrize("tolerance", [1e-2, 1e-6, 1e-10])
@pytest.mark.parametrize("reach", REACHES)
def test_gradient_is_exact_for_truncated_series(tolerance, reach):
    """The gradient of truncated series is exact: Taylor steps do not change the number of terms."""
    E = energy(CLOSED, 3, order=2)
    assert order_at(E, frames(CLOSED, 1), 1e-3, reach=reach, tolerance=tolerance) >= 1.9


@pytest.mark.parametrize("reach", REACHES)
def test_gradient_is_exact_with_a_shift(reach):
    E = energy(CLOSED, 3, order=2)
    shift = np.random.default_rng(3).normal(size=E.functions.source.shape)
    assert order_at(E, frames(CLOSED, 1), reach=reach, shift=shift) >= 1.9


@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES.keys())
def test_shift_is_equivalent_to_a_shifted_target(mesh):
    (f, g), v = problem(mesh, 3), frames(mesh, 1)
    p = PARAMETERS.with_values(sigma_unit="absolute", divergence=1.0)
    shift = np.random.default_rng(3).normal(size=g.shape)
    shifted, other = MatchingEnergy(mesh, f, g, p), MatchingEnergy(mesh, f, g + shift, p)
    found = shifted.objective(0.1, shift=shift.T).evaluate(v)
    expected = other.objective(0.1).evaluate(v)
    assert found.energy == pytest.approx(expected.energy, rel=1e-12)
    assert_allclose(found.gradient, expected.gradient, rtol=1e-9, atol=1e-9)
    assert_array_equal(found.advected, expected.advected)


def test_larger_tolerance_has_larger_error():
    E, v = energy(CLOSED), 5 * frames(CLOSED, 1)
    exact = E.objective(0.2).evaluate(v).energy
    found = [E.objective(0.2, tolerance=t).evaluate(v).energy for t in (1e-2, 1e-4, 1e-7)]
    errors = [abs(one / exact - 1) for one in found]
    assert errors == sorted(errors, reverse=True)
    assert errors[0] > 1e-6 > errors[-1]


@pytest.mark.parametrize("extras", [{}, {"gradient": "bracket"}, {"method": "linearised"}])
def test_gradient_can_be_computed_later(extras):
    """The gradient of an evaluation is exact after later evaluations, which share its memory."""
    mesh = FINE_MESHES["closed"]
    E = MatchingEnergy(mesh, *problem(mesh, 2), PAPER_PARAMETERS.with_values(segments=0, **extras))
    v, w = (to_frame(E.mesh, wavy_field(mesh, seed))[None] / 10 for seed in (1, 2))
    early = E.objective(0.1).evaluate(v).gradient
    late = E.objective(0.1).evaluate(v)
    assert np.abs(E.objective(0.1).evaluate(w).gradient).max() > 0
    assert_array_equal(late.gradient, early)


def test_value_agrees_with_the_formula():
    """The energy equals Eq. 6 by SciPy's exponential and explicit matrices, for unit area."""
    mesh, p = FINE_MESHES["boundary"], PAPER_PARAMETERS.with_values(segments=3)
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


def test_bracket_gradient_converges_with_substeps():
    mesh = FINE_MESHES["closed"]
    v = 0.15 * wavy_field(mesh, 4)[None] / mesh.length_scale

    def gradient(**changes):
        found = MatchingEnergy(
            mesh, *problem(mesh), PAPER_PARAMETERS.with_values(alpha=0.0, **changes)
        )(v)[1]
        return found / np.linalg.norm(found)

    exact = gradient()
    cosines = [float((exact * gradient(gradient="bracket", substeps=n)).sum()) for n in (2, 8, 32)]
    assert cosines == sorted(cosines)
    assert cosines[-1] > 0.9


def test_linearised_bracket_is_the_exact_gradient():
    """For linearised flows (Eq. 8) there is no bracket, so both gradients are equal."""
    mesh, p = FINE_MESHES["closed"], PAPER_PARAMETERS.with_values(method="linearised", segments=3)
    exact, bracket = (
        MatchingEnergy(mesh, *problem(mesh), p.with_values(gradient=kind))(fields(mesh, 3))[1]
        for kind in ("adjoint", "bracket")
    )
    assert_array_equal(exact, bracket)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("segments", [1, 3])
def test_bracket_gradient_without_motion_is_exact(order, segments):
    exact, bracket = (
        energy(OPEN, 3, order=order, segments=segments, gradient=kind)
        for kind in ("adjoint", "bracket")
    )
    for reach in REACHES:
        found = bracket.objective(0.2, reach).evaluate(np.zeros(bracket.shape)).gradient
        expected = exact.objective(0.2, reach).evaluate(np.zeros(exact.shape)).gradient
        assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("alpha", [0.0, 0.002, 0.7])
def test_other_alpha_is_equivalent_to_other_parameters(order, alpha):
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


def test_only_the_latest_other_alpha_is_cached():
    E = energy(OPEN)
    usual, known = E.regularizer(), [weakref.ref(E.regularizer(alpha)) for alpha in (0.3, 0.2, 0.1)]
    gc.collect()
    assert [one() is not None for one in known] == [False, False, True]
    assert E.regularizer() is usual
    assert E.clustered().regularizer() is energy(OPEN).regularizer() is usual


@pytest.mark.parametrize("order", [1, 2])
def test_order_changes_only_the_regularity(order):
    """The order changes only the regularity, ``dtau / 2 sum_j <v_j, R_order v_j>``."""
    E, other = (energy(OPEN, order=k, segments=3) for k in (order, 3 - order))
    v = frames(OPEN, 3)
    found = E.objective(0.2).evaluate(v)
    expected = sum(float((one * E.regularizer().apply(one)).sum()) for one in v) * 1.3 / 3 / 2
    assert found.regularity == pytest.approx(expected, rel=1e-12)
    assert found.mismatch == other.objective(0.2).evaluate(v).mismatch
    assert found.energy == pytest.approx(found.regularity + found.mismatch, rel=1e-15)
    assert E.regularizer().order == order


def test_function_size_is_the_larger_deviation():
    """The size is the larger standard deviation of f and g: ``R / sqrt(3)`` for z on a sphere."""
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


def test_relative_sigma_is_a_multiple_of_the_size():
    relative, absolute = (
        MatchingEnergy(CLOSED, *problem(CLOSED), Parameters.of(sigma_unit=unit))
        for unit in ("relative", "absolute")
    )
    v, size = frames(CLOSED, 1), relative.functions.function_size
    expected = absolute.objective(0.3 * size).evaluate(v).energy
    assert relative.objective(0.3).evaluate(v).energy == pytest.approx(expected, rel=1e-12)


def test_exponent_bounds_the_spectrum():
    """The exponent of a flow bounds the eigenvalues of its operators, and adds up over fields."""
    mesh = open_cylinder(16, 6)
    v, E = frames(mesh, 2), energy(mesh, segments=2)
    total = E.flow(v).exponent
    assert E.flow(2 * v).exponent == pytest.approx(2 * total, rel=1e-12)
    parts = [E.flow(np.stack([one, one])).exponent / 2 for one in v]
    assert total == pytest.approx(sum(parts), rel=1e-12)
    eigenvalues = [np.linalg.eigvals(directional_derivative(E.mesh, one).toarray()) for one in v]
    assert total >= 1.3 / 2 * sum(abs(of_one).max() for of_one in eigenvalues)
    assert energy(mesh, method="linearised", segments=2).flow(v).exponent == 0


def test_overflow_has_infinite_energy():
    E, v = energy(OPEN, 3, segments=2), frames(OPEN, 2)
    assert_array_equal(E.advected(v), E.objective(0.2).evaluate(v).advected)
    assert np.isnan(E.advected(1e9 * v)).all()
    mesh = FINE_MESHES["closed"]
    assert (
        MatchingEnergy(mesh, *problem(mesh), PAPER_PARAMETERS)(1e6 * wavy_field(mesh, 0)[None])[0]
        == np.inf
    )
