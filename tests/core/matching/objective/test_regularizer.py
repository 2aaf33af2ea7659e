"""The norm of fields: agreement with its matrix, positivity and exact inverse."""

import gc
import threading
from itertools import product

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import sparse
from scipy.sparse.linalg import spsolve

from abfm.calculus.operators import face_areas, hat_gradients, mollified_shapes, vector_norm_matrix
from abfm.calculus.vector_fields import to_frame
from abfm.matching import match
from abfm.matching.objective.regularizer import Regularizer, regularizer
from abfm.mesh import TriangleMesh
from abfm.numerics import cholesky
from abfm.numerics.cholesky import factor
from abfm.numerics.factoring_in_subprocess import factoring_in_subprocess
from abfm.parameters import Parameters
from tests.core.fields import rotation_field
from tests.core.surfaces import SURFACES
from tests.core.verification import observed_orders
from tests.processes import python
from tests.shapes import icosphere

ALPHAS = [0.0, 1e-4, 0.1, 1.0, 1e3]


@pytest.fixture(params=SURFACES)
def mesh(request):
    return SURFACES[request.param].normalized()


def random_field(mesh, seed=0):
    return np.random.default_rng(seed).normal(size=(len(mesh.faces), 2))


def test_apply_is_the_norm_matrix(mesh):
    """The norm of order 1 is the matrix R, that of order 2 is ``R M^-1 R``."""
    v = random_field(mesh)
    for alpha in ALPHAS:
        R, norms = vector_norm_matrix(mesh, alpha), [Regularizer(mesh, alpha, k) for k in (1, 2)]
        momentum = R @ v.ravel()
        by_mass = momentum / norms[1].mass
        for norm, expected in zip(norms, (momentum, R @ by_mass), strict=True):
            found = norm.apply(v)
            assert_array_equal(v, random_field(mesh))  # unchanged
            assert found.shape == v.shape
            assert_allclose(found.ravel(), expected, rtol=0, atol=1e-12 * abs(expected).max())
        assert (v * found).sum() == pytest.approx(momentum @ by_mass, rel=1e-11)


@pytest.mark.parametrize("order", [1, 2])
def test_inverse_is_exact(mesh, order):
    """Rounding errors are those of a condition number of about ``(1 + alpha / h^2)^order``."""
    m, norm = random_field(mesh), np.linalg.norm
    for alpha, divergence in product(ALPHAS, (0.1, 1.0, 10.0)):
        R, factor_max = Regularizer(mesh, alpha, order, divergence), max(1.0, divergence) * alpha
        condition = 1 + factor_max * abs(vector_norm_matrix(mesh, 1.0)).max() / R.mass.min()
        found = R.inverse(m)
        assert found.shape == m.shape
        assert norm(R.apply(found) - m) < 1e-13 * condition**order * norm(m)
        assert norm(R.inverse(R.apply(m)) - m) < 1e-12 * condition**order * norm(m)


@pytest.mark.parametrize("order", [1, 2])
def test_norm_and_inverse_are_symmetric_and_positive(mesh, order):
    """The norm of each order is at least that of the order below; order 0 is the mass."""
    v, u, norm = random_field(mesh, 1), random_field(mesh, 2), np.linalg.norm
    for alpha, divergence in product(ALPHAS[:-1], (1.0, 10.0)):
        R = Regularizer(mesh, alpha, order, divergence)
        for operator in (R.apply, R.inverse):
            of_v, of_u = operator(v), operator(u)
            rounding = 1e-12 * (norm(u) * norm(of_v) + norm(v) * norm(of_u))
            assert (u * of_v).sum() == pytest.approx((v * of_u).sum(), rel=0, abs=rounding)
            assert (v * of_v).sum() > 0
        below = (R.mass * v.ravel() ** 2).sum()
        if order == 2:
            below = (v * Regularizer(mesh, alpha, 1, divergence).apply(v)).sum()
        assert (v * R.apply(v)).sum() >= (1 - 1e-12) * below


def test_inverse_agrees_with_scipy(mesh, monkeypatch):
    m = random_field(mesh)
    for alpha in (0.1, 1e3):
        expected = spsolve(sparse.csc_array(vector_norm_matrix(mesh, alpha)), m.ravel())
        found = Regularizer(mesh, alpha).inverse(m)
        assert_allclose(found.ravel(), expected, rtol=0, atol=1e-9 * abs(expected).max())
    R = Regularizer(mesh, 0.0)
    assert_array_equal(R.apply(m).ravel(), R.mass * m.ravel())
    assert_array_equal(R.inverse(m).ravel(), m.ravel() / R.mass)
    assert_array_equal(m, random_field(mesh))  # unchanged
    expected = Regularizer(mesh, 0.1).inverse(m)
    # SuperLU, used where cholespy has no wheel
    monkeypatch.setattr(cholesky, "CholeskySolverD", None)
    found = Regularizer(mesh, 0.1).inverse(m)
    assert_allclose(found, expected, rtol=0, atol=1e-11 * abs(expected).max())


@pytest.mark.parametrize("divergence", [0.1, 1.0, 10.0])
def test_divergence_affects_only_gradients(divergence):
    """For divergence d, the norm scales grad z by 1 + 2 alpha d, and J grad z by 1 + 2 alpha."""
    errors = []
    for subdivisions in (3, 4, 5):
        sphere = icosphere(subdivisions)
        turned = to_frame(sphere, rotation_field(sphere, [0.0, 0.0, 1.0]))
        gradient = np.stack([turned[:, 1], -turned[:, 0]], axis=1)
        mass = np.repeat(face_areas(sphere), 2).reshape(turned.shape)
        R = Regularizer(sphere, 0.7, 1, divergence)
        of_fields = []
        for v, weight in ((turned, 1.0), (gradient, divergence)):
            u = (1 + 2 * 0.7 * weight) * R.inverse(mass * v) - v
            of_fields.append(np.sqrt((mass * u**2).sum() / (mass * v**2).sum()))
        errors.append(of_fields)
    assert np.max(errors[-1]) < 0.02
    assert (np.array(errors[-1]) < 0.6 * np.array(errors[0])).all()


def test_inverse_of_rotation_field_is_known():
    """A rotation of the sphere is an eigenfield of ``Delta_H``, so its inverse is a multiple."""
    errors = []
    for subdivisions in (3, 4, 5):
        sphere = icosphere(subdivisions)
        v = to_frame(sphere, rotation_field(sphere, [0.3, -0.5, 0.8]))
        mass = np.repeat(face_areas(sphere), 2).reshape(v.shape)
        inverses = [Regularizer(sphere, 0.7, order).inverse(mass * v) for order in (1, 2)]
        found = [2.4 * inverses[0] - v, 2.4**2 * inverses[1] - v]
        errors.append([np.sqrt((mass * u**2).sum() / (mass * v**2).sum()) for u in found])
    assert min(observed_orders([4, 2, 1], [error for _, error in errors])) > 0.9
    assert max(errors[-1]) < 0.002


def test_orders_share_factorisations():
    mesh, plain = icosphere(2), Regularizer(icosphere(2), 0.1)
    m, second, first = random_field(mesh), regularizer(mesh, 0.1, 2), regularizer(mesh, 0.1)
    assert (first.order, second.order) == (1, 2)
    assert_array_equal(first.inverse(m), plain.inverse(m))
    assert_array_equal(first.apply(m), plain.apply(m))
    assert regularizer(mesh, 0.1, 2) is second
    second.inverse(m)
    assert second.of_order(1)._solvers is second._solvers
    assert_array_equal(second.of_order(1).inverse(m), plain.inverse(m))


_OUTLIVES = """
import ctypes
from scipy import sparse
from abfm.numerics.factoring_in_subprocess import factoring_in_subprocess
from abfm.parameters import Parameters
from abfm.numerics.cholesky import factor
ctypes.pythonapi.Py_IncRef(ctypes.py_object(factor(sparse.csr_array(sparse.eye_array(3)))))
"""


def test_factorisation_at_exit_reports_no_leak():
    assert python(_OUTLIVES, check=True).stderr == ""


def test_factoring_in_subprocesses_is_bitwise_equal():
    mesh = icosphere(3)
    m, in_subprocess = random_field(mesh), Regularizer(mesh, 0.1)
    expected = Regularizer(mesh, 0.1).inverse(m)
    with factoring_in_subprocess(1000):  # only the system of the edges is large enough
        for _ in range(2):
            assert_array_equal(in_subprocess.inverse(m), expected)
    kinds = [isinstance(solve, cholesky._SubprocessFactor) for solve in in_subprocess._solvers]
    assert sorted(kinds) == [False, True]


def test_ended_factoring_process_raises_memory_error():
    with factoring_in_subprocess(1):
        solve = factor(sparse.csr_array(2 * sparse.eye_array(3)))
    assert_allclose(solve(np.array([2.0, 4.0, 6.0])), [1, 2, 3], rtol=1e-12)
    solve._worker.close()
    for _ in range(2):
        with pytest.raises(MemoryError, match="has ended"):
            solve(np.ones(3))
    with factoring_in_subprocess(1):
        solve = factor(sparse.csr_array(sparse.eye_array(3)))
    solve(np.ones(3))
    process = solve._worker._connection.process._process
    assert process.poll() is None
    del solve
    gc.collect()
    assert process.poll() is not None


def test_factoring_in_subprocess_is_local():
    matrix = sparse.csr_array(sparse.eye_array(3))
    found = []
    with factoring_in_subprocess(1):
        with factoring_in_subprocess(4):
            found.append(factor(matrix))
        other = threading.Thread(target=lambda: found.append(factor(matrix)))
        other.start()
        other.join()
    found.append(factor(matrix))
    assert not any(isinstance(solve, cholesky._SubprocessFactor) for solve in found)


def sliver(height):
    """Return a face with a sliver next to it, whose tip is on the boundary."""
    corners = [[0, 0, 0], [1, 0, 0], [0.5, 1, 0], [0.5, -height, 0]]
    return TriangleMesh(np.array(corners), [[0, 1, 2], [1, 0, 3]])


@pytest.mark.parametrize("height", [1e-5, 1e-7, 1e-9, 1e-11])
@pytest.mark.parametrize("order", [1, 2])
def test_norm_is_definite_on_slivers(height, order):
    mesh = sliver(height).normalized()
    m = face_areas(mesh)[:, None] * random_field(mesh)
    for alpha in (1e-4, 0.01, 1.0):
        R = Regularizer(mesh, alpha, order)
        v = R.inverse(m)
        dual = (m * v).sum()
        assert dual > 0
        assert (v * R.apply(v)).sum() == pytest.approx(dual, rel=1e-4)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("height", [1e-7, 1e-9, 1e-11])
def test_match_on_a_sliver_has_a_verdict(height):
    mesh = sliver(height)
    found = match(mesh, *mesh.vertices.T[:2], Parameters.of(iterations=30, refine=1))
    assert np.isfinite(found.velocity).all()
    assert np.isfinite(found.residual)


def test_only_slivers_are_made_thicker():
    mesh = sliver(1e-9)
    found = mollified_shapes(mesh)
    assert found.areas[0] == face_areas(mesh)[0]
    assert found.areas[1] == pytest.approx(0.5 * 1e-5)
    assert np.sqrt((found.gradients[1] ** 2).sum(axis=1).max()) == pytest.approx(1e5)
    assert_array_equal(found.gradients[0], hat_gradients(mesh)[0])
    # otherwise gradients and rotated gradients would not be orthogonal
    x, y = found.gradients[1, 0], found.gradients[1, 1]
    assert found.areas[1] * (x[0] * y[1] - x[1] * y[0]) == pytest.approx(0.5)
    wide = sliver(1e-4)
    assert_array_equal(mollified_shapes(wide).gradients, hat_gradients(wide))
