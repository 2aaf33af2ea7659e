"""The reduced basis, compared with full operators, Taylor series and rotations of the sphere."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from abfm.baselines.reduced_basis import ReducedEnergy, hodge_basis, reduced_match
from abfm.calculus.eigenbasis import eigenbasis
from abfm.calculus.operators import field_mass, hodge_laplacian, vertex_areas
from abfm.calculus.vector_fields import directional_derivative
from abfm.errors import AbfmError
from abfm.maps.functional_maps import functional_map
from abfm.maps.point_maps import PointMap
from abfm.parameters import Parameters
from tests.messages import raises
from tests.shapes import ellipsoid, hemisphere, icosphere, torus


@pytest.mark.parametrize("mesh", [ellipsoid(2, 1, 1.5, 2), torus(20, 12), hemisphere(8)])
def test_fields_are_orthonormal(mesh):
    _, fields = hodge_basis(mesh, 6)
    assert_allclose(fields.T @ field_mass(mesh) @ fields, np.eye(12), atol=1e-7)


@pytest.mark.parametrize(
    ("mesh", "fields"), [(icosphere(3), slice(None)), (hemisphere(16), slice(3, None))]
)
def test_fields_are_eigenfields_of_the_hodge_laplacian(mesh, fields):
    """On a boundary gradients have some flux, so only divergence-free fields are eigenfields."""
    values, basis = (part[..., fields] for part in hodge_basis(mesh, 3))
    assert_allclose(np.einsum("xm,xm->m", basis, hodge_laplacian(mesh) @ basis), values, rtol=0.03)


def test_first_fields_of_the_sphere_have_eigenvalue_2():
    assert_allclose(hodge_basis(icosphere(3), 3)[0], 2, rtol=0.01)


def problem():
    generator = np.random.default_rng(0)
    start, target = (np.eye(8) + 0.2 * generator.normal(size=(8, 8)) for _ in range(2))
    parameters = Parameters(tau=0.7, alpha=0.3, sigma=0.2)
    energy = ReducedEnergy(ellipsoid(2, 1, 1.5, 2), start, target, parameters, fields=4)
    return energy, generator.normal(size=(2, 8))


def test_operators_are_projections_of_full_ones():
    energy, (a, _) = problem()
    mesh = energy.mesh
    basis = eigenbasis(mesh, 8)[1]
    full = directional_derivative(mesh, (energy.basis @ a).reshape(-1, 2))
    expected = basis.T @ (vertex_areas(mesh)[:, None] * (full @ basis))
    assert_allclose(np.tensordot(a, energy.operators, 1), expected, atol=1e-12)


def test_energy_and_gradient_agree_with_definition():
    energy, (a, direction) = problem()
    difference = expm(-0.7 * np.tensordot(a, energy.operators, 1)) @ energy.start - energy.target
    laplacian = hodge_basis(energy.mesh, 4)[0]
    expected = 0.5 * (a @ ((1 + 0.3 * laplacian) * a) + (difference**2).sum() / 0.2**2)
    assert_allclose(energy(a)[0], expected, rtol=1e-12)
    value, slope = energy(1e6 * a)
    assert value == np.inf
    assert not slope.any()
    value, slope = energy(a)
    steps = 0.1 * 0.5 ** np.arange(4, 10)
    remainders = [abs(energy(a + h * direction)[0] - value - h * slope @ direction) for h in steps]
    assert_allclose(np.log2(np.divide(remainders[:-1], remainders[1:])), 2, atol=0.1)


def test_rotation_of_the_sphere_is_found():
    sphere, axis, p = icosphere(3), np.array([0.0, 0.18, 0.24]), Parameters(alpha=1e-3, sigma=1e-2)
    back = sphere.vertices @ Rotation.from_rotvec(axis).as_matrix()
    target = functional_map(PointMap.project(sphere, sphere, back), 16)
    found = reduced_match(ReducedEnergy(sphere, np.eye(16), target, p, fields=8))
    expected = np.cross(axis, sphere.vertices[sphere.faces].mean(axis=1))
    assert found.mismatch < 0.05 * found.start_mismatch
    assert np.linalg.norm(found.velocity - expected) < 0.05 * np.linalg.norm(expected)
    egg, same = ellipsoid(2, 1, 1.5, 2), np.eye(6)
    found = reduced_match(ReducedEnergy(egg, same, same, Parameters(), 3))
    assert found.mismatch == 0
    assert not found.velocity.any()


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"target": np.eye(5)}, ()),
        ({"start": np.full((6, 6), np.nan)}, ()),
        ({"fields": 0}, ("fields", 0)),
        ({"fields": 10_000}, (10001,)),
    ],
)
def test_invalid_arguments_are_refused(change, named):
    given = {"start": np.eye(6), "target": np.eye(6), "fields": 3}
    with raises(AbfmError, *named):
        ReducedEnergy(icosphere(1), parameters=Parameters(), **(given | change))


def test_too_many_fields_on_a_disc_are_refused():
    with raises(AbfmError):
        hodge_basis(hemisphere(4), 40)
