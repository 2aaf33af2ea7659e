"""The objective takes whatever terms and norms it is given, with exact gradients."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import abfm
from abfm.calculus.operators import face_areas
from abfm.calculus.vector_fields import to_ambient, to_frame
from abfm.matching.objective.matching_energy import MatchingEnergy
from abfm.matching.objective.regularizer import Regularizer
from abfm.matching.terms.data_term import DataTerms, Measure, Restriction
from abfm.matching.terms.functions import FunctionTerm
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


class Places:
    """Where vertices come from: ``|x o phi^-1 - p|^2 / 2`` at some of them."""

    def __init__(self, mesh: TriangleMesh, vertices: list[int], places: FloatArray) -> None:
        self.mesh, self.vertices, self.places = mesh, vertices, places
        self.carried: FloatArray = np.ascontiguousarray(mesh.vertices.T)

    def measure(self, parameters: Parameters, reach: float) -> Measure:
        return self

    def value_and_residual(
        self, carried: FloatArray, sigma: float, offset: FloatArray | None = None
    ) -> tuple[float, FloatArray]:
        residual = np.zeros_like(carried)
        missed = carried[:, self.vertices] - self.places.T
        if offset is not None:
            missed = missed - offset[:, self.vertices]
        residual[:, self.vertices] = missed / sigma**2
        return float((missed**2).sum()) / (2 * sigma**2), residual

    def value(self, carried: FloatArray, sigma: float) -> float:
        return self.value_and_residual(carried, sigma)[0]

    def relative_mismatch(self, carried: FloatArray) -> float:
        missed = carried[:, self.vertices] - self.places.T
        return self.relative_size(missed)

    def relative_size(self, difference: FloatArray) -> float:
        if difference.shape[1] == len(self.mesh.vertices):
            difference = difference[:, self.vertices]
        before = self.carried[:, self.vertices] - self.places.T
        return float(np.linalg.norm(difference) / np.linalg.norm(before))

    def restricted(self, restriction: Restriction) -> Places | None:
        return None

    def arrays(self) -> Mapping[str, FloatArray]:
        return {"places": self.places}


class PlainNorm:
    """That of L2."""

    def __init__(self, mesh: TriangleMesh) -> None:
        self.areas = face_areas(mesh)[:, None]

    def apply(self, v: FloatArray) -> FloatArray:
        return self.areas * v

    def inverse(self, momentum: FloatArray) -> FloatArray:
        return momentum / self.areas


def both(**parameters: object) -> abfm.Problem:
    """Functions, and a vertex whose value shall come from the place of another one."""
    term = Places(MESH, [17], MESH.vertices[[0]])
    return abfm.Problem(MESH, F, G, Parameters(**parameters), terms=(term,))  # type: ignore[arg-type]


@pytest.mark.parametrize("sigma", [0.1, 0.3])
@pytest.mark.parametrize("reach", [0.0, 0.5])
def test_a_residual_is_the_derivative_of_the_value(sigma: float, reach: float) -> None:
    channels = np.stack([F, 2 * G], axis=1)
    terms = (
        FunctionTerm(MESH, channels, channels[:, ::-1], 1 + MESH.vertices[:, 2], [1.0, 2.5]),
        both().terms[1],
    )
    for term in (*terms, DataTerms(terms)):
        measure, rng = term.measure(P, reach), np.random.default_rng(0)
        step = 1e-5 * rng.normal(size=term.carried.shape)
        for offset in (None, rng.normal(size=step.shape)):
            value_and_residual = partial(measure.value_and_residual, sigma=sigma, offset=offset)
            ahead, back = (value_and_residual(term.carried + s * step)[0] for s in (1, -1))
            value, residual = value_and_residual(term.carried)
            assert ahead - back == pytest.approx(2 * float((residual * step).sum()), rel=1e-6)
            if offset is None:
                assert value == pytest.approx(measure.value(term.carried, sigma), rel=1e-12)
            else:
                assert value != pytest.approx(measure.value(term.carried, sigma), rel=1e-3)


def test_terms_add_up_and_are_carried_together() -> None:
    problem = both()
    first, second = problem.terms
    assert isinstance(first, FunctionTerm)
    terms, functions = DataTerms(problem.terms), np.concatenate([[G], MESH.vertices.T])
    value, _ = terms.measure(P, 0.0).value_and_residual(functions, 0.1)
    parts = first.measure(P, 0.0).value(functions[:1], 0.1), second.relative_mismatch(functions[1:])
    assert parts == (0, 1)
    assert value == pytest.approx(np.linalg.norm(MESH.vertices[17] - MESH.vertices[0]) ** 2 * 50)
    assert terms.relative_mismatch(functions) == 1
    assert terms.relative_mismatch(terms.carried) == pytest.approx(
        np.hypot(first.relative_mismatch(F[None]), 1)
    )


def test_a_second_term_has_an_exact_gradient_and_is_matched() -> None:
    energy = MatchingEnergy(both(alpha=0.05, sigma=0.1))
    assert taylor_order(energy, FIELD, 0.02 * wavy_field(MESH, 2)[None]) >= 1.9
    found = abfm.match(both(iterations=60, levels=1))
    alone = abfm.match(MESH, F, G, Parameters(iterations=60, levels=1))
    assert found.advected.shape == (len(F), 1)
    came_from = found.push(MESH.vertices, 1.0)[17]
    without = alone.push(MESH.vertices, 1.0)[17]
    assert np.linalg.norm(came_from - MESH.vertices[0]) < 0.02
    assert np.linalg.norm(came_from - MESH.vertices[0]) < np.linalg.norm(without - MESH.vertices[0])
    assert found.mismatch < 0.1


def test_another_norm_of_fields_has_an_exact_gradient() -> None:
    energy = MatchingEnergy(MESH, F, G, P)
    plain = replace(energy.objective(P.sigma), regularity=PlainNorm(MESH))

    def evaluate(velocity: FloatArray) -> tuple[float, FloatArray]:
        found = plain.evaluate(to_frame(MESH, velocity))
        return found.energy, to_ambient(MESH, found.gradient)

    assert taylor_order(evaluate, FIELD, 0.02 * wavy_field(MESH, 2)[None]) >= 1.9


def test_norms_of_fields_are_made_once_for_an_alpha_and_kept_with_the_mesh() -> None:
    energy = MatchingEnergy(MESH, F, G, P)
    usual, other = energy.regularizer(), energy.regularizer(0.3)
    assert isinstance(usual, Regularizer)
    assert isinstance(other, Regularizer)
    assert (usual.alpha, usual.order, other.alpha) == (P.alpha, P.order, 0.3)
    assert MatchingEnergy(MESH, G, F, P).regularizer() is usual
