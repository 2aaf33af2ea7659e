"""The decomposition of fields: exact, orthogonal, harmonic where there are loops; examples."""

import numpy as np
import pytest

from abfm.calculus import operators as op
from abfm.calculus.vector_fields import helmholtz_hodge, to_frame
from abfm.errors import ParameterError
from abfm.mesh import TriangleMesh
from tests.core import torus_calculus as exact
from tests.core.fields import rotation_field, tangent
from tests.core.surfaces import LOOPS, SURFACES, last_order, norm, relative_error
from tests.shapes import disc, icosphere, square


def random_field(mesh, seed=0):
    return tangent(mesh, np.random.default_rng(seed).normal(size=(len(mesh.faces), 3)))


def inner(mesh, v, u):
    return op.face_areas(mesh) @ (v * u).sum(axis=1)


def test_parts_sum_to_the_field_and_are_orthogonal(mesh):
    v = random_field(mesh)
    parts = helmholtz_hodge(mesh, v)
    np.testing.assert_allclose(sum(parts), v, rtol=0, atol=1e-14)
    for i in range(3):
        assert abs(inner(mesh, parts[i], parts[i - 1])) < 1e-13 * inner(mesh, v, v)


def test_parts_have_no_curl_and_no_divergence(mesh):
    a, b = op.hodge_gradients(mesh)
    v = random_field(mesh)
    curl_free, divergence_free, harmonic = (
        op.field_mass(mesh) @ to_frame(mesh, p).ravel() for p in helmholtz_hodge(mesh, v)
    )
    for basis, momentum in ((b, curl_free), (a, divergence_free), (a, harmonic), (b, harmonic)):
        assert abs(basis.T @ momentum).max(initial=0) < 1e-12 * norm(mesh, v)


def test_parts_stay_themselves(mesh):
    """Each projection applied twice."""
    for i, part in enumerate(helmholtz_hodge(mesh, random_field(mesh))):
        for j, again in enumerate(helmholtz_hodge(mesh, part)):
            np.testing.assert_allclose(again, part if i == j else 0, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", SURFACES)
def test_harmonic_parts_span_as_many_dimensions_as_there_are_loops(name):
    mesh = SURFACES[name]
    parts = np.array(
        [helmholtz_hodge(mesh, random_field(mesh, seed))[2].ravel() for seed in range(6)]
    )
    sizes = np.linalg.svd(parts, compute_uv=False)
    assert (sizes > 1e-9 * np.sqrt(len(mesh.faces))).sum() == LOOPS.get(name, 0)


def test_gradients_and_rotations_of_the_sphere():
    """A linear function's gradient and a rotation, told apart with order 1: fields that jump."""
    errors = []
    for level in (2, 3, 4):
        mesh = icosphere(level)
        slope = tangent(mesh, np.broadcast_to([1.0, 2, 3], (len(mesh.faces), 3)))
        spin = rotation_field(mesh, [3, 1, 2])
        curl_free, divergence_free, harmonic = helmholtz_hodge(mesh, slope + spin)
        assert norm(mesh, harmonic) < 1e-13 * norm(mesh, spin)
        errors.append(
            [relative_error(mesh, curl_free, slope), relative_error(mesh, divergence_free, spin)]
        )
    assert errors[-1][0] < 3e-3
    assert (last_order(errors) > 0.9).all()


def test_harmonic_fields_of_the_torus():
    """``ring^-2 d/du`` and ``ring^-1 d/dv`` have neither divergence nor curl."""
    errors = []
    for mesh in exact.refined(3):
        harmonic = exact.face_field(
            mesh, lambda u, v: exact.ring(v) ** -2, lambda u, v: 2 / exact.ring(v)
        )
        errors.append(relative_error(mesh, helmholtz_hodge(mesh, harmonic)[2], harmonic))
    assert last_order(errors) > 0.9


def test_gradient_takes_the_flux_through_the_boundary():
    """On a disc a constant field is a gradient, and a rotation is tangent to the boundary."""
    mesh = disc(8)
    constant = np.broadcast_to([1.0, 0.5, 0], (len(mesh.faces), 3))
    np.testing.assert_allclose(helmholtz_hodge(mesh, constant)[0], constant, atol=1e-12)
    errors = []
    for n in (8, 16, 32):
        spin = rotation_field(disc(n), [0, 0, 1])
        errors.append(relative_error(disc(n), helmholtz_hodge(disc(n), spin)[1], spin))
    assert last_order(errors) > 0.9


def test_normal_parts_are_dropped_and_zero_stays_zero(mesh):
    v = random_field(mesh)
    lifted = helmholtz_hodge(mesh, v + 3 * op.face_normals(mesh))
    np.testing.assert_allclose(lifted, helmholtz_hodge(mesh, v), atol=1e-12)
    assert not np.any(helmholtz_hodge(mesh, np.zeros_like(v)))


def test_pinched_surfaces_are_decomposed():
    """Two ellipsoids that share a vertex: edge functions have a constant to spare on each."""
    one = SURFACES["ellipsoid"]
    count, tip = len(one.vertices), int(np.argmax(one.vertices[:, 0]))
    vertices = np.concatenate([one.vertices, 2 * one.vertices[tip] - one.vertices])
    mirrored = np.where(one.faces == tip, tip, one.faces + count)[:, ::-1]
    mesh = TriangleMesh(vertices, np.concatenate([one.faces, mirrored]))
    assert any("pinched" in message for message in mesh.messages)
    v = random_field(mesh)
    parts = helmholtz_hodge(mesh, v)
    np.testing.assert_allclose(sum(parts), v, rtol=0, atol=1e-14)
    assert norm(mesh, parts[2]) < 1e-13 * norm(mesh, v)


def test_bad_fields_are_refused():
    with pytest.raises(ParameterError, match="a vector per face"):
        helmholtz_hodge(square(2), np.zeros((3, 3)))
