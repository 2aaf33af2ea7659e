"""The energy takes whatever norms it is given: others than those there are, with exact gradients."""

from __future__ import annotations

import numpy as np
import pytest

import abfm
from abfm.calculus.operators import face_areas, vertex_areas
from abfm.matching.energy import energy as module
from abfm.matching.energy.far_mismatch import FarMismatch
from abfm.matching.energy.l2_mismatch import L2Mismatch
from abfm.matching.energy.problem import Problem
from abfm.matching.energy.regularizer import Regularizer
from abfm.matching.energy.terms import DataTerm, RegularityTerm, data_term, regularity_term
from abfm.mesh import TriangleMesh
from abfm.parameters import Parameters
from abfm.types import FloatArray
from tests.core.fields import bump, wavy_field
from tests.core.verification import taylor_order
from tests.shapes import icosphere

MESH = icosphere(2).normalized()
F, G = bump(MESH, MESH.vertices[0], 0.2), bump(MESH, MESH.vertices[17], 0.2)
P = Parameters(alpha=0.05, sigma=0.1, sigma_unit="absolute")
FIELD = 0.2 * wavy_field(MESH, 1)[None]


class PseudoHuber:
    """``int sqrt(1 + d^2) - 1``, which is not quadratic."""

    def __init__(self, mesh: TriangleMesh) -> None:
        self.areas = vertex_areas(mesh)

    def value_and_residual(self, advected: FloatArray, target: FloatArray, weight: float) -> tuple[float, FloatArray]:
        root = np.sqrt(1 + (advected - target) ** 2)
        return weight * float(self.areas @ (root - 1)), weight * self.areas * (advected - target) / root


class PlainNorm:
    """That of L2."""

    def __init__(self, mesh: TriangleMesh) -> None:
        self.areas = face_areas(mesh)[:, None]

    def apply(self, v: FloatArray) -> FloatArray:
        return self.areas * v

    def inverse(self, momentum: FloatArray) -> FloatArray:
        return momentum / self.areas


def test_the_norms_are_chosen_by_parameters_reach_and_alpha() -> None:
    problem = Problem(MESH, F, G)
    near, far = data_term(problem, P, 0.0), data_term(problem, P, 0.5)
    assert isinstance(near, L2Mismatch)
    assert isinstance(far, FarMismatch)
    usual, other = (regularity_term(MESH, P, alpha) for alpha in (P.alpha, 0.3))
    assert isinstance(usual, Regularizer)
    assert isinstance(other, Regularizer)
    assert (usual.alpha, usual.order, other.alpha) == (P.alpha, P.order, 0.3)
    assert regularity_term(MESH, P, P.alpha) is usual  # the mesh keeps its factors for the next match


@pytest.mark.parametrize("weight", [1.0, 2.5])
def test_a_residual_is_the_derivative_of_the_value(weight: float) -> None:
    problem = Problem(MESH, F, G)
    terms: list[DataTerm] = [data_term(problem, P, 0.0), data_term(problem, P, 0.5), PseudoHuber(MESH)]
    step = 1e-5 * np.random.default_rng(0).normal(size=len(F))
    for term in terms:
        ahead, back = (term.value_and_residual(F + sign * step, G, weight)[0] for sign in (1, -1))
        value, residual = term.value_and_residual(F, G, weight)
        assert ahead - back == pytest.approx(2 * residual @ step, rel=1e-6)
        assert value == pytest.approx(weight * term.value_and_residual(F, G, 1.0)[0], rel=1e-12)


def test_a_data_term_that_is_not_quadratic_has_an_exact_gradient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "data_term", lambda problem, parameters, reach: PseudoHuber(problem.mesh))
    energy = abfm.MatchingEnergy(MESH, F, G, P)
    assert taylor_order(energy, FIELD, 0.02 * wavy_field(MESH, 2)[None], 1.0) >= 1.9
    at_rest = energy(np.zeros_like(FIELD))[0]
    assert at_rest == pytest.approx(PseudoHuber(MESH).value_and_residual(F, G, 1 / P.sigma**2)[0], rel=1e-12)
    found = abfm.match(MESH, F, G, Parameters(iterations=30, sigma=0.05))
    assert found.mismatch < 0.2


def test_another_norm_of_fields_has_an_exact_gradient_and_preconditions(monkeypatch: pytest.MonkeyPatch) -> None:
    norms: list[RegularityTerm] = []

    def plain(mesh: TriangleMesh, parameters: Parameters, alpha: float) -> RegularityTerm:
        norms.append(PlainNorm(mesh))
        return norms[-1]

    monkeypatch.setattr(module, "regularity_term", plain)
    energy = abfm.MatchingEnergy(MESH, F, G, P)
    assert taylor_order(energy, FIELD, 0.02 * wavy_field(MESH, 2)[None], 1.0) >= 1.9
    assert energy.regularizer() is norms[0]
    found = abfm.match(MESH, F, G, Parameters(iterations=5))
    assert len(norms) > 1
    assert found.energy_history[-1, 0] < found.energy_history[0, 0]
