from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import abfm
from abfm.calculus.operators import face_areas, l2_norm, vertex_areas
from abfm.calculus.vector_fields import to_ambient, to_frame
from abfm.matching.objective.matching_energy import MatchingEnergy
from abfm.matching.terms.data_term import DataTerms
from abfm.matching.terms.functions import FunctionTerm, SmoothedNorm
from abfm.mesh import TriangleMesh
from abfm.parameters import Parameters
from tests.core.fields import bump, rotation_field, wavy_field
from tests.core.surfaces import SURFACES, moved, random_function
from tests.core.verification import observed_orders, taylor_order
from tests.shapes import icosphere

MESH = icosphere(2).normalized()
F, G = bump(MESH, MESH.vertices[0], 0.2), bump(MESH, MESH.vertices[17], 0.2)
P = Parameters.of(alpha=0.05, sigma=0.1, sigma_unit="absolute")
FIELD = 0.2 * wavy_field(MESH, 1)[None]


class Places:
    """The term ``|x o phi^-1 - p|^2 / 2`` for the origins of the values at some vertices."""

    name = "places"

    def __init__(self, mesh, vertices, places):
        self.mesh, self.vertices, self.places = mesh, vertices, places
        self.sources = np.ascontiguousarray(mesh.vertices.T)

    def measure(self, parameters, reach):
        return self

    def value_and_derivative(self, advected, sigma):
        derivative = np.zeros_like(advected)
        misfit = advected[:, self.vertices] - self.places.T
        derivative[:, self.vertices] = misfit / sigma**2
        return float((misfit**2).sum()) / (2 * sigma**2), derivative

    def residual(self, advected):
        misfit = advected[:, self.vertices] - self.places.T
        before = self.sources[:, self.vertices] - self.places.T
        return float(np.linalg.norm(misfit) / np.linalg.norm(before))

    def restricted(self, restriction):
        return None

    def arrays(self):
        return {"places": self.places}


class PlainNorm:
    def __init__(self, mesh):
        self.areas = face_areas(mesh)[:, None]

    def apply(self, v):
        return self.areas * v

    def inverse(self, momentum):
        return momentum / self.areas


def problem_with_origin(**parameters):
    """Return a problem with functions and a term that moves the value of vertex 0 to 17."""
    term = Places(MESH, [17], MESH.vertices[[0]])
    return abfm.Problem(MESH, F, G, Parameters.of(**parameters), terms=(term,))


@pytest.mark.parametrize("sigma", [0.1, 0.3])
@pytest.mark.parametrize("reach", [0.0, 0.5])
def test_derivative_is_exact(sigma, reach):
    channels = np.stack([F, 2 * G], axis=1)
    terms = (
        FunctionTerm(MESH, channels, channels[:, ::-1], 1 + MESH.vertices[:, 2], [1.0, 2.5]),
        problem_with_origin().terms[1],
    )
    for term in terms:
        measure, rng = term.measure(P, reach), np.random.default_rng(0)
        step = 1e-5 * rng.normal(size=term.sources.shape)
        value_and_derivative = partial(measure.value_and_derivative, sigma=sigma)
        after, before = (value_and_derivative(term.sources + s * step)[0] for s in (1, -1))
        _, derivative = value_and_derivative(term.sources)
        assert after - before == pytest.approx(2 * float((derivative * step).sum()), rel=1e-6)


def test_terms_are_summed_and_advected_together():
    problem = problem_with_origin()
    first, second = problem.terms
    terms, functions = DataTerms(problem.terms), np.concatenate([G[None], MESH.vertices.T])
    energies, derivative = terms.measure(P, 0.0).energies_and_derivative(functions, 0.1)
    assert second.residual(functions[1:]) == 1
    distance = np.linalg.norm(MESH.vertices[17] - MESH.vertices[0])
    assert energies == (0, pytest.approx(distance**2 * 50))
    separate = [
        term.measure(P, 0.0).value_and_derivative(part, 0.1)
        for term, part in ((first, functions[:1]), (second, functions[1:]))
    ]
    energies, derivative = terms.measure(P, 0.0).energies_and_derivative(functions, 0.1)
    assert energies == tuple(value for value, _ in separate)
    assert np.array_equal(derivative, np.concatenate([of_term for _, of_term in separate]))
    assert terms.residual(functions) == 1
    at_rest = np.hypot(first.residual(F[None]), 1)
    assert terms.residual(terms.sources) == pytest.approx(at_rest)


def test_second_term_has_exact_gradient_and_matches():
    energy = MatchingEnergy(problem_with_origin(alpha=0.05, sigma=0.1))
    assert taylor_order(energy, FIELD, 0.02 * wavy_field(MESH, 2)[None]) >= 1.9
    changes, iterations = {"iterations": 60, "levels": 1, "sigma": 0.3}, []
    found = abfm.match(problem_with_origin(**changes), on_iteration=iterations.append)
    alone = abfm.match(MESH, F, G, Parameters.of(**changes))
    assert all(list(now.term_energies) == ["closeness", "places"] for now in iterations)
    assert all(sum(now.term_energies.values()) == now.mismatch_energy for now in iterations)
    assert found.advected.shape == (len(F), 1)
    distance, without = (
        np.linalg.norm(match.push(MESH.vertices, 1.0)[17] - MESH.vertices[0])
        for match in (found, alone)
    )
    assert distance < min(0.02, without)
    assert found.residual < 0.1


def test_other_norm_of_fields_has_exact_gradient():
    energy = MatchingEnergy(MESH, F, G, P)
    plain = replace(energy.objective(P.sigma), regularity=PlainNorm(MESH))

    def evaluate(velocity):
        found = plain.evaluate(to_frame(MESH, velocity))
        return found.energy, to_ambient(MESH, found.gradient)

    assert taylor_order(evaluate, FIELD, 0.02 * wavy_field(MESH, 2)[None]) >= 1.9


REACHES = [0.05, 0.5, 2.0]
WEIGHT = np.ones(1)


@pytest.fixture(params=SURFACES)
def mesh(request):
    return SURFACES[request.param].normalized()


def metric(mesh, reach, areas=None):
    """Return a smoothed norm that is scaled for a random mismatch."""
    areas = vertex_areas(mesh) if areas is None else areas
    return SmoothedNorm(mesh, areas, reach, random_function(mesh, 0)[None], WEIGHT)


@pytest.mark.parametrize("reach", REACHES)
def test_smoothed_norm_is_symmetric_and_positive(mesh, reach):
    smoothed = metric(mesh, reach)
    matrix = np.stack([smoothed(row) for row in np.eye(len(mesh.vertices))])
    assert_allclose(matrix, matrix.T, rtol=0, atol=1e-13 * np.abs(matrix).max())
    eigenvalues = np.linalg.eigvalsh(matrix + matrix.T)
    assert eigenvalues.min() > 1e-12 * eigenvalues.max()
    assert not smoothed(np.zeros(len(mesh.vertices))).any()
    residuals = np.stack([size * random_function(mesh, size) for size in (1, 10, 3)])
    weights = np.array([1.0, 0.3, 0.0])
    areas = vertex_areas(mesh) * np.abs(random_function(mesh, 4))
    smoothed = SmoothedNorm(mesh, areas, reach, residuals, weights)
    found = sum(w * float(r @ smoothed(r)) for w, r in zip(weights, residuals, strict=True))
    assert found == pytest.approx(float(weights @ (residuals**2 @ areas)), rel=1e-12)


def test_constants_have_the_energy_of_l2(mesh):
    """Without a mask, a constant mismatch has its L2 energy for any reach, since ``L 1 = 0``."""
    flat, areas = np.ones(len(mesh.vertices)), vertex_areas(mesh)
    smoothed = SmoothedNorm(mesh, areas, 0.7, 3 * flat[None], WEIGHT)
    assert_allclose(smoothed(flat), areas, rtol=1e-10)


def test_small_reach_converges_to_l2():
    r, areas, errors = bump(MESH, MESH.vertices[0], 0.3), vertex_areas(MESH), []
    for reach in (0.04, 0.02, 0.01):
        smoothed = metric(MESH, reach)(r)
        smoothed *= (areas * r).sum() / smoothed.sum()
        errors.append(np.abs(smoothed - areas * r).max() / areas.max())
    assert observed_orders([4, 2, 1], errors).min() > 1.7  # s = reach^2


def test_spherical_harmonics_are_damped_by_their_eigenvalues():
    """On the unit sphere, the factor of degree l is ``1 / (1 + s l (l + 1))``."""
    reach, errors = 0.8, []
    for subdivisions in (2, 3, 4):
        mesh = icosphere(subdivisions)
        (x, y, z), areas = mesh.vertices.T, vertex_areas(mesh)
        smoothed = SmoothedNorm(mesh, areas, reach, z[None], WEIGHT)
        damped = [h @ smoothed(h) / (h @ (areas * h)) for h in (x * y, x * y * z)]
        expected = [(1 + 2 * reach**2) / (1 + k * (k + 1) * reach**2) for k in (2, 3)]
        errors.append(np.abs(np.array(damped) / expected - 1).max())
    assert observed_orders([4, 2, 1], errors).min() > 1.8
    assert errors[-1] < 0.01


def test_masked_values_have_no_energy():
    mesh = icosphere(3).normalized()
    seen = mesh.vertices[:, 2] > 0
    smoothed = metric(mesh, 0.5, vertex_areas(mesh) * seen)
    assert not smoothed(np.where(seen, 0.0, 7.0)).any()
    assert not smoothed(random_function(mesh, 5))[~seen].any()


@pytest.mark.parametrize("scale", [1e-6, 64.0, 1e9])
def test_energy_is_invariant_to_motion_and_unit(scale):
    mesh = icosphere(2)
    f, g = bump(mesh, [0, 0, 1], 0.15), bump(mesh, [0, 1, 0], 0.15)
    rotation = Rotation.from_rotvec([0.3, 1.0, -0.4]).as_matrix()
    elsewhere = TriangleMesh(scale * moved(mesh, rotation).vertices, mesh.faces)
    here, there = (MatchingEnergy(each, f, g) for each in (mesh, elsewhere))
    x = 0.3 * np.random.default_rng(0).normal(size=here.shape)
    one, other = here.objective(0.1, 0.7).evaluate(x), there.objective(0.1, 0.7).evaluate(x)
    assert other.energy == pytest.approx(one.energy, rel=1e-9)
    assert_allclose(other.gradient, one.gradient, rtol=0, atol=1e-7 * np.abs(one.gradient).max())


def test_initial_energy_is_that_of_l2():
    mesh = SURFACES["hemisphere"]
    f = np.stack([bump(mesh, mesh.vertices[i], 0.2) for i in (0, 40)], axis=1)
    g = np.stack([bump(mesh, mesh.vertices[i], 0.3) for i in (20, 60)], axis=1)
    mask = 0.2 + np.abs(random_function(mesh, 1))
    E = MatchingEnergy(mesh, f, g, mask=mask, weights=[0.4, 2.0])
    expected = E.objective(0.1).evaluate(np.zeros(E.shape)).energy
    for reach in REACHES:
        found = E.objective(0.1, reach).evaluate(np.zeros(E.shape))
        assert found.energy == pytest.approx(expected, rel=1e-9)
        assert E.measure(reach) is E.measure(reach)


@pytest.mark.parametrize("degrees", [60, 100, 140])
def test_derivative_leads_to_a_disjoint_target(degrees):
    mesh, angle, slopes = icosphere(4), np.deg2rad(degrees), {}
    f, g = (bump(mesh, [0, np.sin(a), np.cos(a)], 0.05) for a in (0, angle))
    E = MatchingEnergy(mesh, f, g)
    assert l2_norm(mesh, f * g) < 1e-3 * l2_norm(mesh, f)
    turn = to_frame(mesh, rotation_field(mesh, [-angle, 0, 0]))[None] / mesh.length_scale
    for reach in (0.0, 0.3, 1.0):
        found = E.objective(0.1, reach).evaluate(np.zeros(E.shape))
        slopes[reach] = -float((found.gradient * turn).sum()) / found.energy
    assert abs(slopes[0.0]) < 0.005
    assert slopes[1.0] > slopes[0.3] > 0.1
