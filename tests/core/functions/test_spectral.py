"""Eigenfunctions and the signatures made of them, against spectra that are known."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from abfm.calculus.eigenbasis import eigenbasis
from abfm.calculus.operators import cotangent_laplacian, vertex_areas
from abfm.errors import FunctionError
from abfm.functions import function
from abfm.mesh import TriangleMesh
from tests.shapes import hemisphere, icosphere, square, tetrahedron, torus

MODES = np.arange(12)  # of the interval [0, 1]: cos(pi n x)


def test_eigenvalues_of_the_sphere_converge_to_l_l_plus_1_with_order_2():
    exact = np.repeat([0, 2, 6, 12], [1, 3, 5, 7])
    errors = [np.abs(eigenbasis(icosphere(s, radius=2.0), 16)[0] * 4 - exact).max() for s in (3, 4)]
    assert errors[1] < 0.1
    assert np.log2(errors[0] / errors[1]) > 1.9


@pytest.mark.parametrize(
    "mesh", [icosphere(3), torus(30, 15), hemisphere(8), tetrahedron()], ids=str
)
def test_eigenbasis_solves_the_generalised_problem(mesh):
    k = min(40, len(mesh.vertices))
    values, functions = eigenbasis(mesh, k)
    mass = vertex_areas(mesh)
    assert values.shape == (k,)
    assert (np.diff(values) >= 0).all()
    assert_allclose(functions.T @ (mass[:, None] * functions), np.eye(k), atol=1e-10)
    residual = cotangent_laplacian(mesh) @ functions - mass[:, None] * functions * values
    assert np.abs(residual).max() < 1e-9 * values[-1]


def test_eigenfunctions_are_scaled_signed_and_start_with_the_constant():
    mesh = TriangleMesh(square(20).vertices * [1.5, 1, 1], square(20).faces)
    assert_array_equal(function(mesh, "eigenfunction:0"), 1)
    f = function(mesh, "eigenfunction:1")
    assert np.abs(f).max() == 1
    exact = np.cos(np.pi * mesh.vertices[:, 0] / 1.5)
    assert_allclose(f * np.sign(f @ exact), exact, atol=0.02)
    for index in range(1, 12):
        assert vertex_areas(mesh) @ function(mesh, f"eigenfunction:{index}") ** 3 > -1e-6


def test_the_sign_of_an_odd_eigenfunction_makes_the_first_large_vertex_positive():
    x, y = np.meshgrid(np.linspace(-1, 1, 15), np.linspace(-0.4, 0.4, 7), indexing="ij")
    corner = (np.arange(14)[:, None] * 7 + np.arange(6)).reshape(-1, 1)
    faces = np.concatenate([corner + np.array(steps) for steps in ([0, 7, 8], [0, 8, 1])])
    mesh = TriangleMesh(np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3), faces)
    assert_allclose(
        function(mesh, "eigenfunction:1"), -np.sin(np.pi * mesh.vertices[:, 0] / 2), atol=0.05
    )


def test_results_do_not_depend_on_what_was_computed_before():
    fresh, used = torus(24, 12), torus(24, 12)
    eigenbasis(used.normalized(), 60)
    eigenbasis(used.normalized(), 3)
    for spec in ("eigenfunction:7", "hks", "wks"):
        assert_array_equal(function(fresh, spec), function(used, spec))
    assert_array_equal(
        eigenbasis(used.normalized(), 3)[1], eigenbasis(used.normalized(), 32)[1][:, :3]
    )


def test_eigenbasis_is_read_only_and_bounded():
    mesh = icosphere(1)
    with pytest.raises(ValueError, match="read-only"):
        eigenbasis(mesh, 3)[1][0] = 0
    for k in (0, 43):
        with pytest.raises(FunctionError, match="on a mesh of 42 vertices it can be 1 to 42"):
            eigenbasis(mesh, k)
    with pytest.raises(FunctionError, match="it can be 1 to 1024"):
        function(icosphere(4), "eigenfunction:1024")


@pytest.mark.parametrize("spec", ["hks:time=0.05", "hks", "wks:energy=3", "wks:energy=4"])
def test_signatures_are_one_on_the_sphere(spec):
    assert_allclose(function(icosphere(4, radius=5.0), spec), 1, atol=0.02)


@pytest.mark.parametrize("spec", ["hks", "wks", "wks:energy=-50", "wks:energy=50,width=0.01"])
def test_signatures_integrate_to_one_over_the_unit_area_surface(spec):
    mesh = torus(30, 15, R=10.0, r=4.0)
    assert_allclose(vertex_areas(mesh.normalized()) @ function(mesh, spec), 1, rtol=1e-9)


def squared_modes(x):
    """Squares of the orthonormal eigenfunctions of [0, 1] with zero slope at the ends, (12, n)."""
    return np.where(MODES > 0, 2, 1)[:, None] * np.cos(np.pi * MODES[:, None] * x) ** 2


def test_heat_kernel_signature_of_the_square():
    mesh = square(40)
    weights = np.exp(-(np.pi**2) * MODES**2 * 0.02)
    x, y, _ = mesh.vertices.T
    exact = (weights @ squared_modes(x)) * (weights @ squared_modes(y)) / weights.sum() ** 2
    assert_allclose(function(mesh, "hks:time=0.02"), exact, rtol=0.02)


def test_wave_kernel_signature_of_the_square():
    mesh = square(40)
    eigenvalues = np.pi**2 * (MODES[:, None] ** 2 + MODES**2)
    eigenvalues[0, 0] = np.nan
    weights = np.nan_to_num(np.exp(-((4.0 - np.log(eigenvalues)) ** 2) / (2 * 0.3**2)))
    x, y, _ = mesh.vertices.T
    exact = np.einsum("ab,an,bn->n", weights, squared_modes(x), squared_modes(y)) / weights.sum()
    assert_allclose(function(mesh, "wks:energy=4,width=0.3"), exact, rtol=0.05)


def test_signatures_use_at_most_the_pairs_there_are():
    for spec in ("hks:eigenpairs=1000", "wks:eigenpairs=1000"):
        assert_allclose(function(tetrahedron(), spec), 1, atol=1e-9)
