"""The algorithm of the paper, compared with its printed formulas and with the solver.

The formulas are computed by dense exponentials. The bracket gradient of the solver agrees.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import expm

from abfm.calculus.operators import function_norm_matrix, vector_norm_matrix
from abfm.calculus.vector_fields import (
    directional_derivative,
    dual_directional_derivative,
    lie_bracket,
    to_frame,
)
from abfm.matching.objective.matching_energy import MatchingEnergy
from abfm.parameters import PAPER, Parameters
from benchmarks.paper_algorithm import PaperEnergy, exponential_span, minimise
from tests.shapes import icosphere

PARAMETERS = Parameters.of(
    **PAPER,
    tau=1.5,
    alpha=0.3,
    beta=0.01,
    sigma=0.1,
    gradient="bracket",
    substeps=4,
    quadrature=3,
    preconditioner="none",
)
SPHERE = icosphere(2, radius=1.7).normalized()


def bumps(mesh):
    points = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1)[:, None]
    return np.exp(3 * (points[:, 0] - 1)), np.exp(4 * (points @ [0.6, 0.8, 0.0] - 1))


def some_field(mesh):
    """Return a rotation with a source and small noise, in frame coefficients (F, 2)."""
    centres = mesh.vertices[mesh.faces].mean(axis=1)
    field = np.cross([0.2, -0.1, 0.8], centres) + np.array([0.3, 0.0, 0.1])
    noise = 0.02 * np.random.default_rng(3).standard_normal((len(mesh.faces), 2))
    return to_frame(mesh, field) + noise


F, G = bumps(SPHERE)
V = some_field(SPHERE)


@pytest.mark.parametrize(("f", "g"), [(F, G), (G, F)], ids=["there", "back"])
@pytest.mark.parametrize("substeps", [1, 4])
def test_energy_and_gradient_agree_with_the_solver(f, g, substeps):
    p = PARAMETERS.with_values(substeps=substeps)
    expected = MatchingEnergy(SPHERE, f, g, p).objective(p.sigma).evaluate(V[None])
    energy, gradient = PaperEnergy(SPHERE, f, g, p)(V.ravel())
    assert_allclose(energy, expected.energy, rtol=1e-8)
    most = np.abs(expected.gradient).max()
    assert_allclose(gradient, expected.gradient.ravel(), atol=1e-6 * most)


@pytest.mark.parametrize("substeps", [1, 3])
@pytest.mark.parametrize("as_printed", [False, True])
def test_gradient_is_the_printed_formula(substeps, as_printed):
    mesh = icosphere(1).normalized()
    f, g = bumps(mesh)
    v = some_field(mesh)
    p = PARAMETERS.with_values(substeps=substeps)
    dt, k = p.tau / substeps, p.paper.quadrature
    derivative, bracket = directional_derivative(mesh, v).toarray(), lie_bracket(mesh, v).toarray()
    average = sum(expm(s * dt / k * bracket) for s in range(k + 1)) / (k + 1)
    jacobian = np.zeros((len(mesh.vertices), v.size))
    for r in range(1, substeps + 1):
        # Eq. 9 has exp(-tau D_v)
        remaining = substeps - r if as_printed and substeps > 1 else substeps - r + 1
        state = expm(-(r - 1) * dt * derivative) @ f
        dual = dual_directional_derivative(mesh, state).toarray()
        jacobian -= dt * expm(-remaining * dt * derivative) @ dual @ average
    difference = expm(-p.tau * derivative) @ f - g
    momentum = p.tau * (vector_norm_matrix(mesh, p.alpha) @ v.ravel())
    mu = function_norm_matrix(mesh, p.beta) @ difference / p.sigma**2
    expected = momentum + jacobian.T @ mu
    _, gradient = PaperEnergy(mesh, f, g, p, as_printed)(v.ravel())
    assert_allclose(gradient, expected, atol=1e-10 * np.abs(expected).max())


def test_omitted_factor_improves_the_gradient():
    energy = MatchingEnergy(SPHERE, F, G, PARAMETERS.with_values(gradient="adjoint"))
    exact = energy.objective(PARAMETERS.sigma).evaluate(V[None]).gradient.ravel()
    printed, completed = (
        PaperEnergy(SPHERE, F, G, PARAMETERS, as_printed)(V.ravel())[1]
        for as_printed in (True, False)
    )
    assert np.linalg.norm(completed - exact) < 0.5 * np.linalg.norm(printed - exact)


def test_exponential_span_equals_dense_exponentials():
    matrix = directional_derivative(SPHERE, V)
    expected = [expm(t * matrix.toarray()) @ F for t in (0.0, 0.4, 0.8, 1.2)]
    assert_allclose(exponential_span(matrix, F, 1.2, 3), expected, rtol=1e-10, atol=1e-12)
    assert PaperEnergy(SPHERE, F, G, PARAMETERS)(1e6 * V.ravel())[0] == np.inf


def test_minimisation_lowers_the_energy():
    mesh = icosphere(2, radius=3.0)
    f, g = bumps(mesh)
    result = minimise(mesh, f, g, PARAMETERS, seconds=1.0)
    assert (np.diff(result.history, axis=0) * [1, -1] > 0).all()
    assert result.energy == result.history[-1, 1] < result.history[0, 1]
    assert result.evaluations >= len(result.history)
    energy, _ = MatchingEnergy(mesh, f, g, PARAMETERS)(result.velocity / mesh.length_scale)
    assert_allclose(energy, result.energy, rtol=1e-8)


def test_minimisation_stops_at_limit_or_exact_match():
    result = minimise(SPHERE, F, G, PARAMETERS, seconds=0.0)
    assert result.stop_reason == "time limit"
    assert result.evaluations == len(result.history) == 1
    assert_array_equal(result.velocity, np.zeros((len(SPHERE.faces), 3)))
    result = minimise(SPHERE, F, F, PARAMETERS)
    assert result.stop_reason != "time limit"
    assert result.energy == 0.0
