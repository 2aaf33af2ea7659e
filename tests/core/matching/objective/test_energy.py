"""The paper's energy: its value against its formula and its gradient by Taylor tests."""

import numpy as np
import pytest
from scipy.sparse.linalg import expm_multiply

import abfm
from abfm.calculus.operators import function_norm_matrix, vector_norm_matrix
from abfm.calculus.vector_fields import directional_derivative, to_frame
from abfm.parameters import PAPER
from tests.core.fields import bump, tangent, wavy_field
from tests.core.verification import taylor_order
from tests.shapes import hemisphere, icosphere

MESHES = {"closed": icosphere(3, radius=3.0), "boundary": hemisphere(12)}
PLAIN = {**PAPER, "alpha": 0.1, "beta": 0.01, "sigma": 0.1, "tau": 1.3}


def problem(mesh, channels=1):
    f = np.stack([bump(mesh, mesh.vertices[i], 0.2) for i in range(0, 40 * channels, 40)], axis=1)
    g = np.stack(
        [bump(mesh, mesh.vertices[i + 17], 0.15) for i in range(0, 40 * channels, 40)], axis=1
    )
    return f, g


def fields(mesh, count):
    return 0.2 * np.stack([wavy_field(mesh, seed) for seed in range(count)]) / mesh.length_scale


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("method", ["nonlinear", "linearised"])
@pytest.mark.parametrize("segments", [1, 10])
@pytest.mark.parametrize("extras", ["plain", "mask, weights and channels"])
def test_adjoint_gradient_is_exact(name, method, segments, extras):
    mesh = MESHES[name]
    many = extras != "plain"
    f, g = problem(mesh, 3 if many else 1)
    mask = 0.1 + np.random.default_rng(0).random(len(mesh.vertices)) if many else None
    weights = [1.0, 0.0, 2.5] if many else None
    p = abfm.Parameters(**PLAIN, method=method, segments=segments)
    energy = abfm.MatchingEnergy(mesh, f, g, p, mask=mask, weights=weights)
    rng = np.random.default_rng(1)
    direction = np.stack(
        [tangent(mesh, rng.normal(size=(len(mesh.faces), 3))) for _ in range(segments)]
    )
    assert taylor_order(energy, fields(mesh, segments), 0.02 * direction) >= 1.9


@pytest.mark.parametrize("extras", [{}, {"gradient": "bracket"}, {"method": "linearised"}])
def test_gradient_may_be_asked_for_late(extras):
    """Later evaluations use the same memory."""
    mesh = MESHES["closed"]
    energy = abfm.MatchingEnergy(mesh, *problem(mesh, 2), abfm.Parameters(**PLAIN, **extras))
    v, w = (to_frame(energy.mesh, wavy_field(mesh, seed))[None] / 10 for seed in (1, 2))
    early = energy.objective(0.1).evaluate(v).gradient
    late = energy.objective(0.1).evaluate(v)
    assert np.abs(energy.objective(0.1).evaluate(w).gradient).max() > 0
    assert np.array_equal(late.gradient, early)


def test_value_is_the_formula():
    """Eq. 6 with SciPy's exponential and explicit matrices, on the mesh scaled to unit area."""
    mesh = MESHES["boundary"]
    f, g = problem(mesh, 2)
    mask, weights = np.linspace(0, 1, len(mesh.vertices)), [0.5, 2.0]
    p = abfm.Parameters(**PLAIN, segments=3)
    v = fields(mesh, 3)
    unit = mesh.normalized()
    R, C = vector_norm_matrix(unit, p.alpha), function_norm_matrix(unit, p.beta, mask)
    advected, regularity = f, 0.0
    for field in to_frame(unit, v):
        regularity += 0.5 * p.tau / 3 * field.ravel() @ (R @ field.ravel())
        advected = expm_multiply(-p.tau / 3 * directional_derivative(unit, field), advected)
    residual = advected - g
    mismatch = (
        0.5 / p.sigma**2 * sum(w * r @ (C @ r) for w, r in zip(weights, residual.T, strict=True))
    )
    value, _ = abfm.MatchingEnergy(mesh, f, g, p, mask=mask, weights=weights)(v)
    assert value == pytest.approx(regularity + mismatch, rel=1e-9)


def cosine(a, b):
    return float((a * b).sum() / np.linalg.norm(a) / np.linalg.norm(b))


def test_bracket_gradient_approaches_the_exact_one_with_more_substeps():
    mesh = MESHES["closed"]
    f, g = problem(mesh)
    v = 0.15 * wavy_field(mesh, 4)[None] / mesh.length_scale
    exact = abfm.MatchingEnergy(mesh, f, g, _with(alpha=0.0))(v)[1]
    cosines = [
        cosine(
            exact,
            abfm.MatchingEnergy(mesh, f, g, _with(alpha=0.0, gradient="bracket", substeps=n))(v)[1],
        )
        for n in (2, 8, 32)
    ]
    assert cosines == sorted(cosines)
    assert cosines[-1] > 0.9


def _with(**changes):
    return abfm.Parameters(**{**PLAIN, **changes})


def test_linearised_bracket_is_the_exact_gradient():
    """Eq. 8 needs no bracket."""
    mesh = MESHES["closed"]
    f, g = problem(mesh)
    exact, bracket = (
        abfm.MatchingEnergy(mesh, f, g, _with(method="linearised", segments=3, gradient=kind))(
            fields(mesh, 3)
        )[1]
        for kind in ("adjoint", "bracket")
    )
    assert np.array_equal(exact, bracket)


def test_overflow_gives_an_infinite_energy():
    mesh = MESHES["closed"]
    f, g = problem(mesh)
    v = 1e6 * wavy_field(mesh, 0)[None]
    value, _ = abfm.MatchingEnergy(mesh, f, g, _with())(v)
    assert value == np.inf


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"f": np.zeros(3)}, "3 values"),
        ({"f": np.zeros((642, 2))}, "2 and target 1 channels"),
        ({"f": np.full(642, np.nan)}, "not finite at 642 of 642 vertices"),
        ({"f": np.array(["a"] * 642)}, "real numbers"),
        ({"f": np.zeros((642, 0))}, "shape"),
        ({"mask": np.zeros(642)}, "zero everywhere"),
        ({"mask": -np.ones(642)}, "not negative"),
        ({"mask": np.ones(5)}, "mask has shape"),
        ({"weights": np.ones(2)}, "weights has shape"),
    ],
)
def test_bad_input_is_refused_in_words(arguments, words):
    mesh = icosphere(3)
    f, g = problem(mesh)
    given = {"f": f[:, 0], "g": g[:, 0], **arguments}
    with pytest.raises(abfm.AbfmError, match=words):
        abfm.MatchingEnergy(mesh, given.pop("f"), given.pop("g"), abfm.Parameters(), **given)
