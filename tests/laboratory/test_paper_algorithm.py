"""The paper's algorithm, against its printed formulas by dense exponentials and against the solver,
for whose bracket gradient it is a witness.
"""

from __future__ import annotations

from dataclasses import replace

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
from abfm.mesh import TriangleMesh
from abfm.parameters import PAPER, Parameters
from abfm.types import FloatArray
from laboratory.paper_algorithm import PaperEnergy, exponential_span, minimise
from tests.shapes import icosphere

PARAMETERS = Parameters(
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


def bumps(mesh: TriangleMesh) -> tuple[FloatArray, FloatArray]:
    points = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1)[:, None]
    return np.exp(3 * (points[:, 0] - 1)), np.exp(4 * (points @ [0.6, 0.8, 0.0] - 1))


def some_field(mesh: TriangleMesh) -> FloatArray:
    """A rotation with a source and a little noise, in frame coefficients (F, 2)."""
    centres = mesh.vertices[mesh.faces].mean(axis=1)
    field = np.cross([0.2, -0.1, 0.8], centres) + np.array([0.3, 0.0, 0.1])
    noise = 0.02 * np.random.default_rng(3).standard_normal((len(mesh.faces), 2))
    return to_frame(mesh, field) + noise


@pytest.fixture(scope="module")
def sphere() -> TriangleMesh:
    return icosphere(2, radius=1.7).normalized()


@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize("substeps", [1, 4])
def test_energy_and_gradient_are_those_of_the_bracket_option(
    sphere: TriangleMesh, swapped: bool, substeps: int
) -> None:
    f, g = reversed(bumps(sphere)) if swapped else bumps(sphere)
    v = some_field(sphere)
    p = replace(PARAMETERS, substeps=substeps)
    expected = MatchingEnergy(sphere, f, g, p).objective(p.sigma).evaluate(v[None])
    energy, gradient = PaperEnergy(sphere, f, g, p)(v.ravel())
    assert_allclose(energy, expected.energy, rtol=1e-8)
    assert_allclose(
        gradient, expected.gradient.ravel(), atol=1e-6 * np.abs(expected.gradient).max()
    )


@pytest.mark.parametrize("substeps", [1, 3])
@pytest.mark.parametrize("as_printed", [False, True])
def test_gradient_is_the_printed_formula(substeps: int, as_printed: bool) -> None:
    mesh = icosphere(1).normalized()
    f, g = bumps(mesh)
    v = some_field(mesh)
    p = replace(PARAMETERS, substeps=substeps)
    dt = p.tau / substeps
    derivative, bracket = directional_derivative(mesh, v).toarray(), lie_bracket(mesh, v).toarray()
    average = sum(expm(s * dt / p.quadrature * bracket) for s in range(p.quadrature + 1)) / (
        p.quadrature + 1
    )
    jacobian = np.zeros((len(mesh.vertices), v.size))
    for r in range(1, substeps + 1):
        # Eq. 9 has exp(-tau D_v)
        left = substeps - r if as_printed and substeps > 1 else substeps - r + 1
        state = expm(-(r - 1) * dt * derivative) @ f
        jacobian -= (
            dt
            * expm(-left * dt * derivative)
            @ dual_directional_derivative(mesh, state).toarray()
            @ average
        )
    difference = expm(-p.tau * derivative) @ f - g
    momentum = p.tau * (vector_norm_matrix(mesh, p.alpha) @ v.ravel())
    expected = (
        momentum + jacobian.T @ (function_norm_matrix(mesh, p.beta) @ difference) / p.sigma**2
    )
    _, gradient = PaperEnergy(mesh, f, g, p, as_printed)(v.ravel())
    assert_allclose(gradient, expected, atol=1e-10 * np.abs(expected).max())


def test_the_dropped_factor_brings_the_gradient_closer_to_the_exact_one(
    sphere: TriangleMesh,
) -> None:
    f, g = bumps(sphere)
    v = some_field(sphere)
    energy = MatchingEnergy(sphere, f, g, replace(PARAMETERS, gradient="adjoint"))
    exact = energy.objective(PARAMETERS.sigma).evaluate(v[None])
    errors = [
        np.linalg.norm(
            PaperEnergy(sphere, f, g, PARAMETERS, as_printed)(v.ravel())[1] - exact.gradient.ravel()
        )
        for as_printed in (True, False)
    ]
    assert errors[1] < 0.5 * errors[0]


def test_span_holds_the_exponential_at_even_times(sphere: TriangleMesh) -> None:
    matrix = directional_derivative(sphere, some_field(sphere))
    f, _ = bumps(sphere)
    expected = [expm(t * matrix.toarray()) @ f for t in (0.0, 0.4, 0.8, 1.2)]
    assert_allclose(exponential_span(matrix, f, 1.2, 3), expected, rtol=1e-10, atol=1e-12)


def test_a_field_too_fast_to_follow_has_infinite_energy(sphere: TriangleMesh) -> None:
    f, g = bumps(sphere)
    energy, _ = PaperEnergy(sphere, f, g, PARAMETERS)(1e6 * some_field(sphere).ravel())
    assert energy == np.inf


def test_minimise_goes_down_and_returns_the_lowest() -> None:
    mesh = icosphere(2, radius=3.0)
    f, g = bumps(mesh)
    result = minimise(mesh, f, g, PARAMETERS, seconds=1.0)
    assert (np.diff(result.history, axis=0) * [1, -1] > 0).all()
    assert result.energy == result.history[-1, 1] < result.history[0, 1]
    assert result.evaluations >= len(result.history)
    energy, _ = MatchingEnergy(mesh, f, g, PARAMETERS)(result.velocity / mesh.length_scale)
    assert_allclose(energy, result.energy, rtol=1e-8)


def test_minimise_without_time_reports_the_start(sphere: TriangleMesh) -> None:
    f, g = bumps(sphere)
    result = minimise(sphere, f, g, PARAMETERS, seconds=0.0)
    assert result.stop_reason == "time limit"
    assert result.evaluations == len(result.history) == 1
    assert_array_equal(result.velocity, np.zeros((len(sphere.faces), 3)))


def test_minimise_stops_by_itself_where_nothing_is_left_to_gain(sphere: TriangleMesh) -> None:
    f, _ = bumps(sphere)
    result = minimise(sphere, f, f, PARAMETERS)
    assert result.stop_reason != "time limit"
    assert result.energy == 0.0
